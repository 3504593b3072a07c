"""What the reference frame hides is served by the first later frame that shows it, once, and rendered from there."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.cameras import Camera, Rig
from headcap.reconstruction.points import PointCloud
from headcap.registration.anchors import Anchors
from headcap.registration.keyframes import (
    Keyframe,
    KeyframeSettings,
    area_mm2,
    find_keyframe,
    newly_seen,
    tie_keyframe,
    with_keyframe,
)
from headcap.registration.motion import Trajectory
from headcap.registration.photographs import Photograph
from headcap.registration.reference import Reference, build_reference, scaled_reference
from headcap.registration.render import project, shade
from headcap.registration.template import Template

N, SIZE = 21, 0.06
SETTINGS = KeyframeSettings(least_area_mm2=1.0)


def _camera() -> Camera:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 0.3
    return Camera("front", 120, 120, np.array([[400.0, 0, 59.5], [0, 400, 59.5], [0, 0, 1]]), np.zeros(5), pose)


def _pattern(shift: float) -> np.ndarray:
    y, x = np.mgrid[:120, :120].astype(np.float32)
    return (128 + 40 * np.sin((x - shift) / 5) * np.cos(y / 7)).astype(np.float32)


@pytest.fixture
def hidden() -> tuple[Reference, np.ndarray]:
    """A sheet whose middle rows are lips that the reference frame does not show; also those triangles (m,)."""
    axis = np.linspace(-SIZE / 2, SIZE / 2, N)
    x, y = np.meshgrid(axis, axis)
    vertices = np.stack([x, y, np.zeros_like(x)], -1).reshape(-1, 3)
    a = (np.arange(N - 1)[:, None] * N + np.arange(N - 1)).ravel()
    triangles = np.concatenate([np.stack([a, a + 1, a + N + 1], 1), np.stack([a, a + N + 1, a + N], 1)]).astype(np.int32)
    lips = np.abs(vertices[:, 1]) < 0.007
    template = Template(vertices, triangles, vertices[:, :2], triangles, regions={"lips_upper": lips})
    whole = build_reference(template, Rig((_camera(),)), [_pattern(0.0)], own_photographs=True, edge_margin_px=1)
    strip = lips[triangles].all(1)
    whole.sources[0].pictures[0].serves[strip] = False
    return whole, strip


def _cloud(offset_m: float) -> PointCloud:
    points = np.random.default_rng(4).uniform(-SIZE / 2, SIZE / 2, (8000, 3))
    points[:, 2] = offset_m
    normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    colours = np.zeros((len(points), 3), np.uint8)
    return PointCloud(points.astype(np.float32), normals.astype(np.float32), np.ones(len(points), np.float32), colours, 0.5)


def test_only_confirmed_strips_next_to_known_skin_are_new(hidden):
    reference, strip = hidden
    vertices = reference.template.vertices
    new = newly_seen(reference, vertices, _cloud(0.0), SETTINGS)
    assert new.any()
    assert not (new & ~strip).any()
    # rows are 3 mm apart and the strip is four rows high: only its first and last row touch what is known
    assert new.sum() == strip.sum() // 2
    # a sheet of 60 mm in 20 x 20 squares, two triangles each
    assert np.isclose(area_mm2(vertices, reference.template.triangles[new]), new.sum() * 0.5 * 3.0**2)
    assert not newly_seen(reference, vertices, _cloud(0.002), SETTINGS).any()


@pytest.mark.parametrize(("tilt_deg", "found"), [(0.0, True), (85.0, False)])
def test_a_strip_that_cameras_hardly_see_is_no_keyframe(hidden, tilt_deg, found):
    reference, _ = hidden
    angle = np.radians(tilt_deg)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    cloud = replace(_cloud(0.0), positions=_cloud(0.0).positions @ turn.T, normals=_cloud(0.0).normals @ turn.T)
    vertices, motion = reference.template.vertices @ turn.T, Trajectory(np.zeros(1), reference.template.vertices[None], 0)
    assert area_mm2(vertices, reference.template.triangles[newly_seen(reference, vertices, cloud, SETTINGS)]) > 100
    keyframe = find_keyframe(reference, 0.5, vertices, motion, [Photograph(0, _pattern(0.0), 0.0)], cloud, SETTINGS)
    assert (keyframe is not None) == found


def test_a_keyframe_serves_the_strip_and_nothing_twice(hidden):
    reference, _ = hidden
    camera, vertices, triangles = reference.cameras[0], reference.template.vertices, reference.template.triangles
    new = newly_seen(reference, vertices, _cloud(0.0), SETTINGS)
    moved = np.tile([0.0015, 0.0, 0.0], (len(vertices), 1))  # two pixels: the photograph was taken while the sheet moved on
    photograph = Photograph(0, _pattern(2.0), 0.004)
    keyframe = tie_keyframe(reference, 0.5, vertices, [moved], [photograph], new)
    grown = with_keyframe(reference, keyframe, [photograph])
    serves = keyframe.serves[0]
    assert not (serves & ~new).any()
    # all of the strip but its ends, which lie at the sheet's own silhouette
    inner = (np.abs(vertices[triangles][:, :, 0]) < 0.025).all(1)
    assert np.array_equal((serves & inner), (new & inner))
    assert not (reference.sources[0].served & keyframe.serves[0]).any()
    assert np.array_equal(grown.sources[0].served, reference.sources[0].served | serves)
    assert not (newly_seen(grown, vertices, _cloud(0.0), SETTINGS) & serves).any()
    projection = project(camera, vertices, triangles)
    image, known = shade(projection, triangles, grown.sources[0])
    own = np.isin(projection.raster.triangle, np.flatnonzero(serves)) & known
    # both photographs show one sheet: what the second serves looks as the first would have shown it; a cubic through samples of
    # a wave of 31 pixels errs by less than its height (2 pi / 31)^4 / 10
    assert own.sum() > 100
    assert np.abs(image - _pattern(0.0)[projection.window.slices])[own].max() < 0.2


def test_keyframes_follow_the_references_scale(hidden):
    reference, _ = hidden
    new = newly_seen(reference, reference.template.vertices, _cloud(0.0), SETTINGS)
    photograph = Photograph(0, _pattern(0.0), 0.0)
    still = [np.zeros_like(reference.template.vertices)]
    keyframe = tie_keyframe(reference, 0.5, reference.template.vertices, still, [photograph], new)
    small = with_keyframe(scaled_reference(reference, 60), keyframe, [photograph])
    pixels, _ = small.cameras[0].project(reference.template.vertices)
    assert small.sources[0].pictures[1].image.shape == (60, 60)
    assert np.abs(pixels - small.sources[0].pictures[1].pixels).max() < 1e-3


def test_keyframes_travel_with_the_anchors(tmp_path, rng):
    pixels, serves = rng.normal(size=(2, 5, 2)).astype(np.float32), rng.random((2, 4)) > 0.5
    pixels[1] = np.nan
    anchors = Anchors(0, np.arange(3.0), np.zeros((3, 5, 3), np.float32), np.zeros(3), 0.0, (Keyframe(1.0, pixels, serves),))
    anchors.save(tmp_path / "anchors.npz")
    (read,) = Anchors.load(tmp_path / "anchors.npz", 2, 2).keyframes
    assert read.time_s == 1.0
    assert np.array_equal(read.pixels, pixels, equal_nan=True)
    assert np.array_equal(read.serves, serves)
