"""Rendering from a first photograph gives that photograph back; what is covered, oblique or behind does not serve."""

import numpy as np
import pytest

from headcap.cameras import Camera, Rig
from headcap.registration.photometric import PhotometricSettings, ViewComparison
from headcap.registration.reference import build_reference, scaled_reference
from headcap.registration.render import project, shade, visible_share
from headcap.registration.template import Template


def _camera(size: int = 120) -> Camera:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[2, 3] = 0.3
    centre = (size - 1) / 2
    return Camera("front", size, size, np.array([[400.0, 0, centre], [0, 400, centre], [0, 0, 1]]), np.zeros(5), pose)


def _sheet(n: int, size: float, z: float) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.linspace(-size / 2, size / 2, n), np.linspace(-size / 2, size / 2, n))
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    triangles = np.concatenate([np.stack([a, a + 1, a + n + 1], 1), np.stack([a, a + n + 1, a + n], 1)]).astype(np.int32)
    return np.stack([x, y, np.full_like(x, z)], -1).reshape(-1, 3), triangles


def _pattern(size: int = 120, shift: float = 0.0) -> np.ndarray:
    y, x = np.mgrid[:size, :size].astype(np.float32)
    return (128 + 40 * np.sin((x - shift) / 5) * np.cos(y / 7) + 20 * np.sin((x - shift + y) / 9)).astype(np.float32)


@pytest.fixture
def reference():
    vertices, triangles = _sheet(15, 0.06, 0.0)
    template = Template(vertices, triangles, vertices[:, :2], triangles)
    return build_reference(template, Rig((_camera(),)), [_pattern()], own_photographs=True, edge_margin_px=1)


def test_unmoved_mesh_shows_the_photograph_itself(reference):
    source = reference.sources[0]
    projection = project(_camera(), reference.template.vertices, reference.template.triangles)
    image, known = shade(projection, reference.template.triangles, source)
    # 80 of the surface's pixels a side, two lost at each rim
    assert known.sum() > 0.85 * projection.raster.hit.sum()
    # cubic interpolation at the pixels' own centres: only float32 rounding of the projections is left
    assert np.abs(image - _pattern()[projection.window.slices])[known].max() < 0.05


def test_edges_of_the_surface_do_not_serve(reference):
    clear = reference.sources[0].pictures[0].clear
    projection = project(_camera(), reference.template.vertices, reference.template.triangles)
    rows, columns = np.nonzero(projection.raster.hit)
    assert not clear[projection.window.slices][rows.min(), columns.min()]
    assert clear[60, 60]


def test_covered_sheet_is_not_visible():
    front, triangles = _sheet(9, 0.03, 0.02)
    back, _ = _sheet(9, 0.03, 0.0)
    both = np.concatenate([front, back])
    all_triangles = np.concatenate([triangles, triangles + len(front)])
    projection = project(_camera(), both, all_triangles)
    share = visible_share(projection.raster, projection.pixels - (projection.window.x0, projection.window.y0), all_triangles)
    # the front sheet is nearer and covers all but the rim of the back one
    assert share[: len(triangles)].min() > 0.6
    assert np.median(share[len(triangles) :]) == 0


def test_reduced_reference_ties_the_same_points(reference):
    small = scaled_reference(reference, 60)
    assert small.cameras[0].size == (60, 60)
    pixels, _ = small.cameras[0].project(reference.template.vertices)
    assert np.abs(pixels - small.sources[0].pictures[0].pixels).max() < 1e-3


@pytest.mark.parametrize("gain", [1.0, 0.7])
def test_surface_flow_sees_a_shift_at_any_gain(reference, gain):
    template, camera, shift = reference.template, _camera(), 0.3
    normals = np.tile([0.0, 0.0, 1.0], (len(template.vertices), 1))
    photograph = (gain * _pattern(shift=shift) + 9).astype(np.float32)
    settings = PhotometricSettings()
    view = ViewComparison(camera, reference.sources[0], template.vertices, normals, template.triangles, photograph, settings)
    normal = view.normal(template.vertices)
    inside = (np.abs(template.vertices[:, :2]) < 0.02).all(1)
    step_m = normal.right[inside, 0].sum() / normal.blocks[inside, 0].sum()
    # 0.3 px is 0.225 mm at this distance; central differences of the pattern's shortest wave (31 px) err by 1 %, noise floor more
    assert step_m == pytest.approx(shift * 0.3 / 400, rel=0.15)
