"""Weights go from basis to basis by least squares, back where nothing is lost, and what is lost is told."""

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.expressions import ExpressionBasis
from headcap.expressions.conversion import conversion_matrix, convert_weights

N = 40
TRIANGLES = np.stack([np.arange(N - 2), np.arange(1, N - 1), np.arange(2, N)], axis=1)


@pytest.fixture
def source(rng):
    shapes = 0.01 * rng.normal(size=(4, N, 3))
    return ExpressionBasis(("a", "b", "c", "d"), 0.1 * rng.normal(size=(N, 3)), shapes, TRIANGLES)


def mixed(basis, mixture):
    """Shapes that are mixtures (j, k) of a basis'."""
    names = tuple(f"m{i}" for i in range(len(mixture)))
    return ExpressionBasis(names, basis.neutral, np.tensordot(mixture, basis.displacements.astype(float), 1), basis.triangles)


def test_there_and_back_is_the_identity_where_one_spans_the_other(source, rng):
    mixture = rng.normal(size=(4, 4))
    target = mixed(source, mixture)
    there, back = conversion_matrix(source, target), conversion_matrix(target, source)
    # single precision of the shapes, by the condition of the mixture
    atol = 1e-6 * np.linalg.cond(mixture)
    np.testing.assert_allclose(there.matrix @ back.matrix, np.eye(4), atol=atol)
    np.testing.assert_allclose(back.matrix, mixture, atol=atol)
    assert there.share.max() < atol
    weights = rng.uniform(size=(70, 4))
    found = convert_weights(source, target, weights)
    np.testing.assert_allclose(found.weights @ mixture, weights, atol=4 * atol)
    assert found.total_share < atol


def test_a_larger_target_reproduces_though_its_weights_are_not_unique(source, rng):
    target = mixed(source, rng.normal(size=(7, 4)))
    weights = rng.uniform(size=(5, 4))
    found = convert_weights(source, target, weights)
    np.testing.assert_allclose(target.blend(found.weights), source.blend(weights), atol=1e-7)
    # the shortest of all
    null = np.linalg.svd(target.rows.astype(float).T)[2][4:]
    assert np.abs(found.weights @ null.T).max() < 1e-5


def test_what_is_left_stands_upright_on_the_target_and_is_told_in_millimetres(source, rng):
    target = ExpressionBasis(("x", "y"), source.neutral, 0.01 * rng.normal(size=(2, N, 3)), TRIANGLES)
    weights = rng.uniform(size=(66, 4))
    weights[3] = 0
    found = convert_weights(source, target, weights)
    wanted = weights @ source.rows.astype(float)
    left = wanted - found.weights @ target.rows.astype(float)
    # orthogonal up to rounding of the products
    assert np.abs(left @ target.rows.T.astype(float)).max() < 1e-12 * np.square(target.rows).sum() / 1e-4
    each = np.linalg.norm(left.reshape(66, N, 3), axis=2)
    np.testing.assert_allclose(found.rms_mm, 1e3 * np.sqrt(np.square(each).mean(axis=1)))
    np.testing.assert_allclose(found.worst_mm, 1e3 * each.max(axis=1))
    moving = np.arange(66) != 3
    np.testing.assert_allclose(found.share[moving], np.linalg.norm(left[moving], axis=1) / np.linalg.norm(wanted[moving], axis=1))
    assert found.share[3] == 0
    assert found.total_share == pytest.approx(np.linalg.norm(left) / np.linalg.norm(wanted))


def test_bounds_hold_and_the_rest_is_the_best_there_is(source, rng):
    target = mixed(source, rng.normal(size=(3, 4)))
    weights = rng.normal(size=(12, 4))
    free, held = convert_weights(source, target, weights), convert_weights(source, target, weights, (0.0, 1.0))
    assert ((held.weights >= 0) & (held.weights <= 1)).all()
    assert (held.rms_mm >= free.rms_mm - 1e-12).all()
    # Karush, Kuhn, Tucker: the slope is zero inside, points outwards at a bound
    rows = target.rows.astype(float)
    slope = (held.weights @ rows - weights @ source.rows.astype(float)) @ rows.T
    tolerance = 1e-9 * np.abs(weights @ source.rows.astype(float) @ rows.T).max()
    at_zero, at_one = held.weights <= 1e-9, held.weights >= 1 - 1e-9
    assert (slope[at_zero] >= -tolerance).all()
    assert (slope[at_one] <= tolerance).all()
    assert np.abs(slope[~at_zero & ~at_one]).max() <= tolerance
    assert at_zero.any()
    assert at_one.any()


def test_wide_bounds_change_nothing(source, rng):
    target = mixed(source, rng.normal(size=(3, 4)))
    weights = rng.uniform(size=(6, 4))
    wide = convert_weights(source, target, weights, (-1e3, 1e3))
    np.testing.assert_allclose(wide.weights, convert_weights(source, target, weights).weights, atol=1e-9)


def test_other_topologies_and_other_numbers_of_weights_are_refused(source):
    fewer = ExpressionBasis(source.names, source.neutral[:-1], source.displacements[:, :-1], TRIANGLES[:-1])
    with pytest.raises(InputError, match="bases of 40 vertices, 38 triangles and 39 vertices, 37"):
        conversion_matrix(source, fewer)
    with pytest.raises(InputError, match=r"weights \(2, 3\)"):
        convert_weights(source, source, np.zeros((2, 3)))


def test_triangles_in_another_order_are_the_same_topology(source):
    turned = ExpressionBasis(source.names, source.neutral, source.displacements, np.roll(TRIANGLES, 1, axis=1)[::-1])
    np.testing.assert_allclose(conversion_matrix(source, turned).matrix, np.eye(4), atol=1e-6)
    inside_out = ExpressionBasis(source.names, source.neutral, source.displacements, TRIANGLES[:, ::-1])
    with pytest.raises(InputError, match="one topology"):
        conversion_matrix(source, inside_out)
