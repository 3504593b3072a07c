"""The sculptor: strength 0 is exact, each way to miss changes its own quantity alone, equal seeds are equal."""

import numpy as np
import pytest
from pydantic import ValidationError

from headcap.errors import InputError
from headcap.expressions import ExpressionBasis
from headcap.meshes.laplacian import cotangent_laplacian, vertex_areas
from headcap.meshes.topology import boundary_mask
from headcap.synthetic.sculptor import SculptorSettings, nearest_shapes, sculpt, slip, smoothed

SIDE, STEP_M = 31, 0.004
EXACT = dict.fromkeys(SculptorSettings.model_fields, 0.0)


def only(**strength: float) -> SculptorSettings:
    return SculptorSettings(**EXACT | strength)


def sheet() -> tuple[np.ndarray, np.ndarray]:
    """A flat square of 12 cm."""
    y, x = np.meshgrid(np.arange(SIDE), np.arange(SIDE), indexing="ij")
    vertices = STEP_M * np.stack([x - SIDE // 2, y - SIDE // 2, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    corner = (y[:-1, :-1] * SIDE + x[:-1, :-1]).ravel()
    quads = np.stack([corner, corner + 1, corner + SIDE + 1, corner + SIDE], axis=1)
    return vertices, np.concatenate([quads[:, :3], quads[:, [0, 2, 3]]]).astype(np.int32)


@pytest.fixture(scope="module")
def basis() -> ExpressionBasis:
    vertices, triangles = sheet()
    centres = 0.03 * np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0], [-0.8, -1, 0]])
    ways = np.array([[0, 0, 1.0], [0, 1, 0], [1, 0, 0], [0, 0.2, 1]])
    bumps = np.exp(-((vertices[None] - centres[:, None]) ** 2).sum(-1) / (2 * 0.012**2))
    return ExpressionBasis(tuple("abcd"), vertices, 0.005 * bumps[..., None] * ways[:, None], triangles)


def test_strength_nought_gives_the_shapes_back(basis):
    made = sculpt(basis, only(), 4)
    assert (made.displacements == basis.displacements).all()
    assert made.names == basis.names
    assert (made.neutral == basis.neutral).all()
    assert (made.triangles == basis.triangles).all()


def test_equal_seeds_are_equal_and_others_differ(basis):
    made = sculpt(basis, SculptorSettings(), 4).displacements
    assert (made == sculpt(basis, SculptorSettings(), 4).displacements).all()
    # all that differs is within what the settings allow, and none is as it was
    others = sculpt(basis, SculptorSettings(), 5).displacements
    assert all(np.linalg.norm(one - other) > 0.05 * np.linalg.norm(one) for one, other in zip(made, others, strict=True))


def test_one_way_to_miss_draws_the_same_whatever_the_others_do(basis):
    gains = sculpt(basis, only(amplitude=0.3), 4).displacements.sum(axis=(1, 2)) / basis.displacements.sum(axis=(1, 2))
    with_slip = sculpt(basis, only(amplitude=0.3, misplacement_mm=5), 4).displacements
    slipped = sculpt(basis, only(misplacement_mm=5), 4).displacements
    assert with_slip == pytest.approx(gains[:, None, None] * slipped, rel=1e-5, abs=1e-9)


def test_amplitude_is_one_gain_per_shape(basis):
    made = sculpt(basis, only(amplitude=0.3), 4)
    gains = np.linalg.norm(made.rows, axis=1) / np.linalg.norm(basis.rows, axis=1)
    assert made.displacements == pytest.approx(gains[:, None, None] * basis.displacements, rel=1e-5, abs=1e-10)
    assert ((gains > 0.7) & (gains < 1.3)).all()
    assert np.ptp(gains) > 0.05


def test_a_wrong_neighbour_comes_in_by_its_share_of_the_norm(basis):
    nearest = nearest_shapes(basis)
    assert list(nearest[[0, 3]]) == [3, 0]
    added = sculpt(basis, only(neighbour=0.4), 4).rows - basis.rows
    share = np.linalg.norm(added, axis=1) / np.linalg.norm(basis.rows, axis=1)
    assert ((share > 0.2 - 1e-6) & (share < 0.4 + 1e-6)).all()
    alike = np.einsum("kn,kn->k", added, basis.rows[nearest])
    # float32 shapes: what was added is a difference of them
    assert alike == pytest.approx(np.linalg.norm(added, axis=1) * np.linalg.norm(basis.rows[nearest], axis=1), rel=1e-5)


def test_asymmetry_is_a_gain_that_grows_from_the_middle_against_the_other_side(basis):
    made = sculpt(basis, only(asymmetry=0.3), 4)
    strong = np.abs(basis.displacements) > 1e-5
    gains = np.where(strong, made.displacements / np.where(strong, basis.displacements, 1), np.nan)
    x = basis.neutral[:, 0]
    sides = np.tanh(2 * x / np.abs(x).max())
    slope = np.array([np.nanmedian((gain - 1)[np.abs(x) > 1e-6] / sides[np.abs(x) > 1e-6, None]) for gain in gains])
    assert (np.abs(slope) < 0.3).all()
    assert np.ptp(slope) > 0.02
    assert np.nan_to_num(gains - 1 - slope[:, None, None] * sides[:, None]) == pytest.approx(0, abs=1e-4)


def test_directions_turn_and_lengths_stay(basis):
    made = sculpt(basis, only(direction_deg=40), 4)
    length = np.linalg.norm(basis.displacements, axis=-1)
    assert np.linalg.norm(made.displacements, axis=-1) == pytest.approx(length, rel=1e-5, abs=1e-10)
    cosine = np.einsum("kni,kni->kn", made.displacements, basis.displacements)[length > 1e-4] / length[length > 1e-4] ** 2
    assert cosine.min() > np.cos(np.radians(40)) - 1e-5
    assert cosine.min() < 0.95


def test_smoothing_keeps_the_integral_and_widens_a_bump_by_its_variance():
    vertices, triangles = sheet()
    areas = vertex_areas(vertices, triangles)
    # seven standard deviations from the edges, which would reflect it
    bump = np.exp(-(vertices**2).sum(axis=1) / (2 * 0.008**2))
    blurred = smoothed(vertices, triangles, bump[None, :, None] * np.ones(3), 0.004)[0, :, 0]
    assert areas @ blurred == pytest.approx(areas @ bump, rel=1e-6)
    # one implicit step of M + t L, t = length^2 / 2, adds 2 t to the variance along each axis
    weights = areas * np.stack([bump, blurred])
    variance = weights @ vertices[:, :2] ** 2 / weights.sum(axis=1, keepdims=True)
    assert variance[1] - variance[0] == pytest.approx(0.004**2, rel=1e-3)
    laplacian = cotangent_laplacian(vertices, triangles)
    assert blurred @ laplacian @ blurred < 0.9 * bump @ laplacian @ bump


def test_a_slip_reads_linear_functions_where_it_points_and_stays_at_open_edges():
    vertices, triangles = sheet()
    shift = np.array([0.0012, -0.0009, 0.002])
    operator = slip(vertices, triangles, np.tile(shift, (len(vertices), 1)))
    slope = np.array([3.0, -2.0, 0.0])
    inside = ~boundary_mask(triangles, len(vertices))
    assert (operator @ (vertices @ slope))[inside] == pytest.approx((vertices + shift)[inside] @ slope, abs=1e-12)
    assert operator.sum(axis=1) == pytest.approx(1.0)
    assert operator.data.min() >= -1e-12
    down_and_right = (vertices[:, 0] == vertices[:, 0].max()) & (vertices[:, 1] == vertices[:, 1].min())
    assert (operator @ vertices)[down_and_right] == pytest.approx(vertices[down_and_right])


def test_misplaced_shapes_are_the_same_shapes_elsewhere(basis):
    made = sculpt(basis, only(misplacement_mm=6), 4)
    # the third sits in the middle, where the two sides slip opposite ways and stretch it
    for index in (0, 1, 3):
        before, after = basis.displacements[index], made.displacements[index]
        weights = np.stack([np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1)])
        centres = weights @ basis.neutral / weights.sum(axis=1, keepdims=True)
        # half the length at least, less what points out of the sheet; a tenth of the bump is at its edges, where nothing slips
        assert 0.0002 < np.linalg.norm(centres[1] - centres[0]) < 0.006
        assert np.abs(after).max() <= np.abs(before).max() + 1e-9
        assert weights[1].sum() == pytest.approx(weights[0].sum(), rel=0.05)


def test_all_but_asymmetry_leave_the_sides_alike():
    vertices, triangles = sheet()
    mirrored = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)[:, ::-1].ravel()
    x, y, _ = vertices.T
    bump = np.exp(-((np.abs(x) - 0.02) ** 2 + (y - 0.01) ** 2) / (2 * 0.01**2))
    even = 0.005 * bump[:, None] * np.column_stack([np.tanh(x / 0.01), np.ones_like(x), np.ones_like(x)])
    shapes = ExpressionBasis(("one", "other"), vertices, np.stack([even, even * [0.5, 1, -1]]), triangles)

    def unlike(**strength: float) -> float:
        made = sculpt(shapes, only(**strength), 4).displacements
        away = made[:, mirrored] * [-1, 1, 1] - made
        return float(np.linalg.norm(away) / np.linalg.norm(made))

    assert max(unlike(direction_deg=40), unlike(amplitude=0.3), unlike(neighbour=0.3)) < 1e-6
    # the sheet's diagonals all run one way, which the slip and the blur see
    assert max(unlike(misplacement_mm=6), unlike(smoothing_mm=8)) < 0.05
    assert unlike(asymmetry=0.3) > 0.05


def test_points_without_triangles_neither_slip_nor_blur(basis):
    markers = ExpressionBasis(basis.names, basis.neutral, basis.displacements, np.zeros((0, 3)))
    with pytest.raises(InputError, match="without triangles"):
        sculpt(markers, SculptorSettings(), 0)
    made = sculpt(markers, only(amplitude=0.2, neighbour=0.2, asymmetry=0.2, direction_deg=20), 0)
    assert made.displacements.shape == basis.displacements.shape


def test_strengths_have_bounds():
    with pytest.raises(ValidationError):
        SculptorSettings(amplitude=1.2)
    with pytest.raises(ValidationError):
        SculptorSettings(smoothing_mm=-1)
