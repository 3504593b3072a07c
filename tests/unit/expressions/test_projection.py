"""Laws of eq. 3 and 4 and of what follows them: projections, missing axes, overlap, locality."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.expressions import Eigenfaces, ExpressionBasis
from headcap.expressions.influence import localised, off_plane, regions_of_influence
from headcap.expressions.projection import (
    EXCURSION,
    coordinates,
    missing_axes,
    missing_report,
    projected,
    quasi_eigen_faces,
    span_report,
)
from headcap.expressions.shape_changes import cosines, overlaps, shape_changes

SIDE = 12
POINTS, AXES = SIDE**2, 6


def grid_triangles():
    corner = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)[:-1, :-1].ravel()
    return np.concatenate(
        [np.stack([corner, corner + 1, corner + SIDE], 1), np.stack([corner + 1, corner + SIDE + 1, corner + SIDE], 1)]
    ).astype(np.int32)


@pytest.fixture
def eigen(rng):
    vectors = np.linalg.qr(rng.normal(size=(3 * POINTS, AXES)))[0].T
    mean = 1e-3 * rng.normal(size=(POINTS, 3))
    variances = 1e-3 * 0.5 ** np.arange(AXES)
    return Eigenfaces(
        mean.astype(np.float32), vectors.reshape(AXES, POINTS, 3).astype(np.float32), variances, variances.sum() * 1.01
    )


def basis(displacements, names=None):
    grid = np.stack([*np.meshgrid(np.arange(SIDE), np.arange(SIDE)), np.zeros((SIDE, SIDE))], axis=-1).reshape(-1, 3) * 0.01
    names = names or tuple(f"shape {index}" for index in range(len(displacements)))
    return ExpressionBasis(names, grid, displacements, grid_triangles())


@pytest.fixture
def hand(rng):
    return basis(5e-3 * rng.normal(size=(9, POINTS, 3)))


def test_shapes_in_the_plane_stay_as_they_are(rng, eigen):
    inside = eigen.mean + np.tensordot(0.05 * rng.normal(size=(7, AXES)), eigen.vectors, 1)
    made = quasi_eigen_faces(basis(inside), eigen, augment=False)
    # displacements of about 1e-2 m in single precision
    np.testing.assert_allclose(made.quasi.displacements, made.hand.displacements, atol=1e-7)
    changes = shape_changes(made)
    np.testing.assert_allclose(changes.kept, 1.0, atol=1e-5)
    assert changes.largest_mm.max() < 1e-3


def test_projection_is_the_nearest_point_of_the_plane(eigen, hand, rng):
    made = quasi_eigen_faces(hand, eigen, augment=False)
    left = (hand.rows - made.quasi.rows).astype(float)
    # what was taken away is square to every axis...
    np.testing.assert_allclose(left @ eigen.rows.T, 0.0, atol=1e-6)
    # ...so any other point of the plane is farther off
    other = projected(made.coordinates + 1e-3 * rng.normal(size=made.coordinates.shape), eigen)
    farther = np.linalg.norm(hand.rows - other.reshape(len(hand), -1), axis=1)
    assert (farther > np.linalg.norm(left, axis=1)).all()
    np.testing.assert_allclose(off_plane(made.quasi.displacements, eigen), 0.0, atol=1e-5)


def test_projecting_again_changes_nothing(eigen, hand):
    once = quasi_eigen_faces(hand, eigen, augment=False)
    twice = quasi_eigen_faces(once.quasi, eigen, augment=False)
    np.testing.assert_allclose(twice.quasi.displacements, once.quasi.displacements, atol=1e-7)
    np.testing.assert_allclose(twice.coordinates, once.coordinates, atol=1e-6)


def test_coordinates_are_products_with_the_axes(eigen, hand):
    """Eq. 3, element by element, in double."""
    expected = [
        [np.sum(axis.astype(float) * (shape.astype(float) - eigen.mean)) for axis in eigen.vectors]
        for shape in hand.displacements
    ]
    np.testing.assert_allclose(coordinates(hand, eigen), expected, atol=1e-7)


def without(displacements, eigen, axis):
    """Shapes without any part along an axis."""
    direction = eigen.rows[axis].astype(float)
    rows = displacements.reshape(len(displacements), -1).astype(float)
    return (rows - np.outer(rows @ direction, direction)).reshape(displacements.shape)


def test_an_axis_left_out_is_found_and_added(eigen, hand):
    # exact zero of the paper's sums: nothing along the axis about the mean either
    level = replace(eigen, mean=without(eigen.mean[None], eigen, 3)[0].astype(np.float32))
    made = quasi_eigen_faces(basis(without(hand.displacements, level, 3)), level, missing_share=0.05, augment=True)
    assert made.missing == (3,)
    assert made.quasi.names[-1] == "eigenface_04"
    assert len(made.quasi) == len(hand) + 1
    added = made.quasi.rows[-1]
    assert np.linalg.norm(added) == pytest.approx(EXCURSION * np.sqrt(level.variances[3]), rel=1e-5)
    np.testing.assert_allclose(added / np.linalg.norm(added), level.rows[3], atol=1e-6)
    listed = quasi_eigen_faces(made.hand, level, missing_share=0.05, augment=False)
    assert (listed.missing, listed.quasi.names) == ((3,), made.hand.names)


def test_an_axis_that_only_the_mean_has_is_missing_too(eigen, hand):
    """All w_ij of eq. 3 are alike and large, and yet no quasi-eigen face moves along the axis."""
    shifted = replace(eigen, mean=(eigen.mean + 0.05 * eigen.vectors[2]).astype(np.float32))
    shapes = basis(without(hand.displacements, eigen, 2))
    weights = coordinates(shapes, shifted)
    assert np.abs(weights[:, 2]).sum() > np.sqrt(shifted.variances[2])
    made = quasi_eigen_faces(shapes, shifted, augment=False)
    np.testing.assert_allclose(made.quasi.rows @ eigen.rows[2], 0.0, atol=1e-6)
    assert made.missing == (2,)


def test_the_threshold_is_a_share_of_the_performances_own_motion(eigen):
    weights = np.zeros((4, AXES))
    weights[0] = 0.5 * np.sqrt(eigen.variances)
    level = replace(eigen, mean=np.zeros_like(eigen.mean))
    assert missing_axes(weights, level, 0.49) == ()
    assert missing_axes(weights, level, 0.51) == tuple(range(AXES))


def test_the_animator_is_told_the_nearest_shape(eigen, hand):
    level = replace(eigen, mean=np.zeros_like(eigen.mean))
    shapes = without(hand.displacements, level, 1)
    # a trace of the axis in one shape: under the threshold, but nearer than the others
    shapes[4] -= 2e-4 * eigen.vectors[1]
    made = quasi_eigen_faces(basis(shapes), level, missing_share=0.05)
    (told,) = missing_report(made)
    assert (told.axis, told.name, told.nearest) == (1, "eigenface_02", "shape 4")
    assert told.correlation == pytest.approx(-2e-4 / np.linalg.norm(shapes[4]), rel=1e-3)
    assert told.share == pytest.approx(2e-4 / np.sqrt(level.variances[1]), rel=1e-2)
    assert told.variance_share == pytest.approx(level.variances[1] / level.total_variance)


def test_enough_different_shapes_span_what_the_eigenfaces_do(eigen, hand):
    report = span_report(quasi_eigen_faces(hand, eigen, augment=False).quasi, eigen)
    # the axes, and what the mean has beside them
    assert report.rank == AXES + 1
    np.testing.assert_allclose(report.reached, 1.0, atol=1e-4)
    assert report.coverage == pytest.approx(report.eigen_coverage, rel=1e-4)


def test_copies_span_next_to_nothing_although_no_axis_is_missing(eigen, hand, rng):
    copies = hand.displacements[:1] * rng.uniform(0.5, 1.5, size=(9, 1, 1))
    level = replace(eigen, mean=np.zeros_like(eigen.mean))
    made = quasi_eigen_faces(basis(copies), level, augment=True)
    assert made.missing == ()
    report = span_report(made.quasi, level)
    assert report.rank == 1
    along = level.rows @ made.quasi.rows[0].astype(float)
    expected = along**2 / (along @ along)
    np.testing.assert_allclose(report.reached, expected, atol=1e-5)
    assert report.coverage == pytest.approx(expected @ level.variances / level.total_variance, rel=1e-4)


def test_overlap_is_told_before_and_after(eigen, hand):
    level = replace(eigen, mean=np.zeros_like(eigen.mean))
    plane = 0.05 * eigen.vectors[0]
    aside = without(hand.displacements[:2], eigen, 0)
    for axis in range(1, AXES):
        aside = without(aside, eigen, axis)
    # far from each other as they were made, the same within the plane
    shapes = np.concatenate([plane + aside, hand.displacements[2:]])
    made = quasi_eigen_faces(basis(shapes), level, augment=False)
    assert abs(cosines(made.hand)[0, 1]) < 0.9
    (pair,) = [pair for pair in overlaps(made, 0.99) if {pair.first, pair.second} == {"shape 0", "shape 1"}]
    assert pair.before == pytest.approx(cosines(made.hand)[0, 1])
    assert pair.after == pytest.approx(1.0, abs=1e-5)


def test_changes_are_those_of_the_displacements(eigen, hand):
    made = quasi_eigen_faces(hand, eigen, augment=False)
    found = shape_changes(made)
    away = np.linalg.norm(made.quasi.displacements[3] - hand.displacements[3], axis=1)
    assert found.largest_mm[3] == pytest.approx(1e3 * away.max(), rel=1e-5)
    assert found.rms_mm[3] == pytest.approx(1e3 * np.sqrt((away**2).mean()), rel=1e-5)
    level = replace(eigen, mean=np.zeros_like(eigen.mean))
    # without a mean a projection's length is the cosine
    found = shape_changes(quasi_eigen_faces(hand, level, augment=False))
    np.testing.assert_allclose(found.kept, np.cos(np.radians(found.angle_deg)), rtol=1e-4)


@pytest.fixture
def local(rng):
    """A shape that moves one corner of the grid only."""
    centre = basis(np.zeros((1, POINTS, 3))).neutral
    bump = np.exp(-((centre[:, :2] - 0.02) ** 2).sum(axis=1) / 0.015**2)
    bump[bump < 1e-3] = 0.0
    return basis(5e-3 * bump[None, :, None] * np.array([0.2, 0.1, 1.0]))


def test_regions_hold_what_moves_and_fade(local):
    (region,) = regions_of_influence(local)
    length = np.linalg.norm(local.displacements[0], axis=1)
    assert (region[length >= 0.1 * length.max()] == 1.0).all()
    assert region[-1] == 0.0
    edges = grid_triangles()[:, :2]
    # the border is blended: no edge jumps from inside to outside
    assert np.abs(region[edges[:, 0]] - region[edges[:, 1]]).max() < 0.9
    assert ((region > 0.05) & (region < 0.95)).any()


def test_local_shapes_move_nothing_outside_and_fit_inside_at_least_as_well(local, eigen):
    plain = quasi_eigen_faces(local, eigen, augment=False).quasi.displacements
    kept = quasi_eigen_faces(local, eigen, augment=False, locality=1.0).quasi.displacements
    (region,) = regions_of_influence(local)
    assert np.abs(kept[0][region == 0]).max() == 0.0
    assert np.abs(plain[0][region == 0]).max() > 0.0
    weight = region[:, None]
    away = [float((weight * (shapes[0] - local.displacements[0]) ** 2)[region == 1].sum()) for shapes in (kept, plain)]
    assert away[0] < away[1]
    assert off_plane(kept, eigen)[0] > off_plane(plain, eigen)[0]


def test_locality_grows_from_the_projection(local, eigen):
    np.testing.assert_allclose(localised(local, eigen, 1e-6), projected(coordinates(local, eigen), eigen), atol=1e-6)
    (region,) = regions_of_influence(local)
    outside = [np.abs(localised(local, eigen, locality)[0][region == 0]).max() for locality in (0.0, 0.5, 1.0)]
    assert outside[0] > outside[1] > outside[2] == 0.0
