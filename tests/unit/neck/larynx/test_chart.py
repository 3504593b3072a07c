"""The chart of the front neck is one disc, nearly isometric, upright, with the larynx at its origin."""

import dataclasses

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.meshes import topology
from headcap.neck import build_chart
from headcap.neck.larynx.chart import measure_distortion


def test_is_one_disc_that_holds_the_larynx_region(model, chart):
    assert topology.euler_characteristic(chart.triangles) == 1
    assert np.isin(np.flatnonzero(model.regions["larynx"]), chart.vertices).all()
    assert model.regions["front_neck"][chart.vertices].all()
    border = set(chart.vertices[chart.border()])
    assert not border & set(np.flatnonzero(model.regions["larynx"]))


def test_is_nearly_isometric_and_never_folds(chart):
    # the throat is curved both ways (a saddle with a bump): what is left is what its curvature asks for
    assert chart.distortion.flipped == 0
    assert chart.distortion.mean_stretch < 0.025
    assert chart.distortion.p99_stretch < 0.2
    assert chart.distortion.area_ratio == pytest.approx(1, abs=0.01)


def test_a_developable_patch_is_laid_out_exactly(model):
    """On a cylinder SLIM must find the isometry: only triangles' chords remain."""
    v = model.vertices.copy()
    radius = 0.06
    angle = np.arctan2(v[:, 0], v[:, 2] + 0.03)
    round_ = np.stack([radius * np.sin(angle), v[:, 1], radius * np.cos(angle) - 0.03], axis=1)
    bent = build_chart(model, round_, iterations=80)
    assert bent.distortion.mean_stretch < 2e-3
    expected = np.stack([radius * angle, v[:, 1] - v[model.landmarks["larynx"], 1]], axis=1)[bent.vertices]
    assert np.abs(bent.uv_m - expected).max() < 5e-4


def test_is_upright_about_the_larynx(model, chart):
    place = model.vertices[chart.vertices]
    origin = np.flatnonzero(chart.vertices == model.landmarks["larynx"])[0]
    assert np.allclose(chart.uv_m[origin], 0)
    middle = place[:, 0] == 0.0
    assert np.abs(chart.uv_m[middle, 0]).max() < 1e-3
    assert np.corrcoef(chart.uv_m[:, 0], place[:, 0])[0, 1] > 0.98
    assert np.corrcoef(chart.uv_m[middle, 1], place[middle, 1])[0, 1] > 0.98


def test_distortion_of_known_maps(rng):
    flat = rng.uniform(size=(30, 2))
    from scipy.spatial import Delaunay

    triangles = Delaunay(flat).simplices
    space = np.c_[flat, np.zeros(30)]
    exact = measure_distortion(space, flat, triangles)
    assert exact.mean_stretch == pytest.approx(0, abs=1e-9)
    doubled = measure_distortion(space, flat * [2.0, 1.0], triangles)
    assert doubled.mean_stretch == pytest.approx(0.5)
    assert doubled.max_stretch == pytest.approx(1.0)
    assert doubled.area_ratio == pytest.approx(2.0)
    assert measure_distortion(space, flat * [-1.0, 1.0], triangles).flipped == len(triangles)


def test_what_is_no_patch_is_refused(model):
    holed = model.regions["front_neck"].copy()
    holed[model.landmarks["larynx"]] = False
    with pytest.raises(InputError, match="no disc"):
        build_chart(dataclasses.replace(model, regions=model.regions | {"front_neck": holed}))
    with pytest.raises(InputError, match="names no front_neck region"):
        build_chart(dataclasses.replace(model, regions={}))
    with pytest.raises(InputError, match="names no larynx landmark"):
        build_chart(dataclasses.replace(model, landmarks={}))
