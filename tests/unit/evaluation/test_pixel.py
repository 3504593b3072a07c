"""The pixel on the skin, and the law by which it moves limits of lengths: coarser loosens in proportion, finer never tightens."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.cameras import Rig
from headcap.evaluation.catalogue import CATALOGUE, REFERENCE_PIXEL_MM, limit_factor
from headcap.evaluation.pixel import pixel_on_skin_mm
from headcap.evaluation.session import SessionFolder, evaluate_session
from headcap.evaluation.settings import EvaluateSettings
from headcap.evaluation.truth import Truth

LENGTHS = sorted(name for name, kind in CATALOGUE.items() if kind.by_pixel and kind.limit is not None)


def test_a_pixel_is_as_wide_as_its_ray_at_the_face(still_world):
    # half a metre off with a focal length of 800 px; the four cameras beside are up to 0.54 m off
    assert pixel_on_skin_mm(Rig(still_world.rig.cameras[:1]), still_world.template()) == pytest.approx(500 / 800)
    assert 500 / 800 < pixel_on_skin_mm(still_world.rig, still_world.template()) < 545 / 800


def test_a_pixel_grows_as_resolution_falls(still_world):
    full = pixel_on_skin_mm(still_world.rig, still_world.template())
    halved = Rig(tuple(camera.scaled(0.5) for camera in still_world.rig))
    # the image's border falls on other vertices: a sheet of 5 mm steps shifts the median by a fraction of a percent
    assert pixel_on_skin_mm(halved, still_world.template()) == pytest.approx(2 * full, rel=5e-3)


def test_only_the_face_counts_and_only_cameras_that_see_it(still_world):
    near = still_world.motion(0.0)[:, 1] > 0
    template = still_world.template({"face": near})
    lifted = template.vertices + np.where(near, 0.0, 0.2)[:, None] * [0, 0, 1]  # the rest comes nearer
    front = still_world.rig.cameras[0]
    assert pixel_on_skin_mm(Rig((front,)), template.with_vertices(lifted)) == pytest.approx(500 / 800)
    behind = replace(front, name="behind", camera_from_world=front.camera_from_world @ np.diag([1.0, -1, -1, 1]))
    assert pixel_on_skin_mm(Rig((front, behind)), template) == pytest.approx(500 / 800)
    assert np.isnan(pixel_on_skin_mm(Rig((behind,)), template))


@pytest.mark.parametrize("pixel_mm", [0.1, 0.375, 0.42, REFERENCE_PIXEL_MM, None, float("nan")])
def test_up_to_the_reference_pixel_every_limit_stands_as_it_is(pixel_mm):
    settings = EvaluateSettings().at_pixel(pixel_mm)
    assert {name: settings.limit(name) for name in CATALOGUE} == {name: kind.limit for name, kind in CATALOGUE.items()}


@pytest.mark.parametrize("ratio", [1.25, 2.0, 7.0])
def test_beyond_it_lengths_in_photographs_grow_in_proportion_and_nothing_else(ratio):
    assert limit_factor(ratio * REFERENCE_PIXEL_MM) == pytest.approx(ratio)
    settings = EvaluateSettings().at_pixel(ratio * REFERENCE_PIXEL_MM)
    for name, kind in CATALOGUE.items():
        expected = kind.limit if kind.limit is None or not kind.by_pixel else ratio * kind.limit
        assert settings.limit(name) == (expected if expected is None else pytest.approx(expected))
    assert len(LENGTHS) >= 7
    assert all(CATALOGUE[name].unit == "mm" and not name.startswith("register.") for name in LENGTHS)


def test_limits_of_the_session_are_never_scaled():
    own = EvaluateSettings(limits={"track.drift_median_mm": 0.2, "track.drift_p95_mm": None}).at_pixel(2 * REFERENCE_PIXEL_MM)
    assert own.limit("track.drift_median_mm") == 0.2
    assert own.limit("track.drift_p95_mm") is None


def test_a_session_states_its_pixel_and_is_held_to_limits_by_it(still_world, tmp_path):
    session = SessionFolder(tmp_path / "study")
    still_world.template().save(session.start("take"))
    found = evaluate_session(session, ["take"], rig=still_world.rig, truth=Truth(still_world.folder), settings=EvaluateSettings())
    figures = {figure.name: figure for figure in found}
    pixel_mm = pixel_on_skin_mm(still_world.rig, still_world.template())
    assert figures["rig.pixel_mm"].value == pytest.approx(pixel_mm)
    assert figures["calibrate.centre_error_mm"].limit == pytest.approx(0.3 * pixel_mm / REFERENCE_PIXEL_MM)
    assert figures["calibrate.rotation_error_deg"].limit == 0.03
