"""Laws of eq. 5: weights are those of other solvers, truths are recovered, optima hold their conditions."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear, nnls

from headcap.errors import InputError
from headcap.expressions import ExpressionBasis, Performance
from headcap.expressions.bounded import solve_frames, solve_sequence
from headcap.expressions.performance import in_memory
from headcap.expressions.weights import ExpressionSolver

POINTS, SHAPES, FRAMES = 60, 12, 40
NO_TRIANGLES = np.zeros((0, 3), np.int32)


@pytest.fixture
def basis(rng):
    # neighbours overlap: a Gram matrix of which coordinate descent alone would make hard work
    mixing = np.eye(SHAPES) + 0.9 * np.eye(SHAPES, k=1) + 0.5 * np.eye(SHAPES, k=2)
    shapes = np.tensordot(mixing, 3e-3 * rng.normal(size=(SHAPES, POINTS, 3)), 1)
    return ExpressionBasis([f"shape {i}" for i in range(SHAPES)], np.zeros((POINTS, 3)), shapes, NO_TRIANGLES)


@pytest.fixture
def frames(basis, rng):
    """Smooth weights beyond all bounds, and motion outside the basis."""
    time = np.arange(FRAMES) / 10
    weights = 0.4 + np.sin(np.outer(time, rng.uniform(0.5, 3, SHAPES)) + rng.uniform(0, 6, SHAPES))
    return (basis.blend(weights) + 1e-3 * rng.normal(size=(FRAMES, POINTS, 3))).astype(np.float32)


def matrix(basis):
    return basis.rows.astype(float).T


def rows(frames):
    return frames.reshape(len(frames), -1).astype(float)


def objective(basis, frames, weights, smoothing, sparsity):
    """As the solver's docstring writes it."""
    unit = np.trace(matrix(basis).T @ matrix(basis)) / len(basis)
    error = rows(frames) - weights @ matrix(basis).T
    steps = np.diff(weights, axis=0)
    return 0.5 * (error**2).sum() + 0.5 * smoothing * unit * (steps**2).sum() + sparsity * unit * np.abs(weights).sum()


def test_free_weights_are_least_squares(basis, frames):
    found = ExpressionSolver(basis).solve(frames)
    expected = np.linalg.lstsq(matrix(basis), rows(frames).T)[0].T
    # single precision of the projection times the condition of the shapes, about 10
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("bounds", [None, (0.0, np.inf), (0.0, 1.0), (-3.0, 3.0)])
@pytest.mark.parametrize("smoothing", [0.0, 0.5])
def test_true_weights_are_recovered(basis, rng, bounds, smoothing):
    """Constant weights, which smoothing does not touch, inside all bounds."""
    weights = np.tile(rng.uniform(0.1, 0.9, SHAPES), (5, 1))
    found = ExpressionSolver(basis, bounds=bounds, smoothing=smoothing).solve(basis.blend(weights))
    np.testing.assert_allclose(found, weights, atol=1e-5)


def test_non_negative_weights_are_those_of_nnls(basis, frames):
    found = ExpressionSolver(basis, bounds=(0.0, np.inf)).solve(frames)
    expected = np.array([nnls(matrix(basis), frame)[0] for frame in rows(frames)])
    assert (found == 0).any()
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("bounds", [(0.0, 1.0), (-0.3, 0.4), (0.2, 0.5)])
def test_weights_in_a_box_are_those_of_bounded_least_squares(basis, frames, bounds):
    found = ExpressionSolver(basis, bounds=bounds).solve(frames)
    expected = [lsq_linear(matrix(basis), frame, bounds, method="bvls", tol=1e-14).x for frame in rows(frames)]
    assert ((found == bounds[0]).sum() > FRAMES) & ((found == bounds[1]).sum() > FRAMES)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_wide_bounds_bind_nothing(basis, frames):
    free = ExpressionSolver(basis).solve(frames)
    np.testing.assert_allclose(ExpressionSolver(basis, bounds=(-1e3, 1e3)).solve(frames), free, atol=1e-8)


def test_smooth_weights_solve_the_system_of_all_frames(basis, frames):
    smoothing = 0.3
    gram = matrix(basis).T @ matrix(basis)
    unit = np.trace(gram) / SHAPES
    steps = np.diff(np.eye(FRAMES), axis=0)
    system = np.kron(np.eye(FRAMES), gram) + smoothing * unit * np.kron(steps.T @ steps, np.eye(SHAPES))
    expected = np.linalg.solve(system, (rows(frames) @ matrix(basis)).ravel()).reshape(FRAMES, SHAPES)
    found = ExpressionSolver(basis, smoothing=smoothing).solve(frames)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    rough = ExpressionSolver(basis).solve(frames)
    assert (np.diff(found, axis=0) ** 2).sum() < (np.diff(rough, axis=0) ** 2).sum()


@pytest.mark.parametrize("smoothing", [0.01, 1.0])
def test_smooth_weights_in_a_box_are_those_of_bounded_least_squares(basis, frames, smoothing):
    """The whole sequence as one problem of stacked rows."""
    frames = frames[:12]
    unit = np.trace(matrix(basis).T @ matrix(basis)) / SHAPES
    stacked = np.vstack(
        [
            np.kron(np.eye(12), matrix(basis)),
            np.sqrt(smoothing * unit) * np.kron(np.diff(np.eye(12), axis=0), np.eye(SHAPES)),
        ]
    )
    right = np.concatenate([rows(frames).ravel(), np.zeros(11 * SHAPES)])
    # the problem through its triangular factor: the same squares, a fifteenth of the rows
    unitary, upper = np.linalg.qr(stacked)
    expected = lsq_linear(upper, unitary.T @ right, (0.0, 0.6), method="bvls", tol=1e-14).x.reshape(12, SHAPES)
    found = ExpressionSolver(basis, bounds=(0.0, 0.6), smoothing=smoothing).solve(frames)
    assert ((found == 0.0) | (found == 0.6)).sum() > 10
    np.testing.assert_allclose(found, expected, atol=1e-5)


@pytest.mark.parametrize("bounds", [None, (-0.5, 0.8), (0.0, 1.0)])
@pytest.mark.parametrize("smoothing", [0.0, 0.2])
def test_sparse_weights_are_optimal(basis, frames, rng, bounds, smoothing):
    sparsity = 0.3
    found = ExpressionSolver(basis, bounds=bounds, smoothing=smoothing, sparsity=sparsity).solve(frames)
    plain = ExpressionSolver(basis, bounds=bounds, smoothing=smoothing).solve(frames)
    assert (found == 0).sum() > (plain == 0).sum()
    least = objective(basis, frames, found, smoothing, sparsity)
    low, high = bounds or (-np.inf, np.inf)
    for size in (1e-1, 1e-2, 1e-3):
        for _ in range(20):
            other = np.clip(found + size * rng.normal(size=found.shape) * (rng.random(found.shape) < 0.2), low, high)
            assert objective(basis, frames, other, smoothing, sparsity) > least
    # and one weight at a time, both ways: a convex sum with separable kinks has its minimum where no coordinate improves
    for frame, shape in rng.integers(0, (FRAMES, SHAPES), size=(60, 2)):
        for step in (-1e-3, 1e-3):
            other = found.copy()
            other[frame, shape] = np.clip(other[frame, shape] + step, low, high)
            assert objective(basis, frames, other, smoothing, sparsity) >= least * (1 - 1e-9)


def test_a_lone_shape_shrinks_by_the_sparsity(rng):
    shape = ExpressionBasis(["one"], np.zeros((POINTS, 3)), 1e-3 * rng.normal(size=(1, POINTS, 3)), NO_TRIANGLES)
    weights = np.array([[0.5], [-0.5], [0.05], [-0.05]])
    found = ExpressionSolver(shape, sparsity=0.1).solve(shape.blend(weights))
    np.testing.assert_allclose(found, [[0.4], [-0.4], [0.0], [0.0]], atol=1e-6)


def test_optima_do_not_depend_on_where_the_search_begins(basis, frames, rng):
    gram, right = matrix(basis).T @ matrix(basis), rows(frames) @ matrix(basis)
    begun = [
        solve_frames(gram, right, 0.0, 1.0, 1e-4, start)[0]
        for start in (np.zeros(SHAPES), np.ones(SHAPES), rng.uniform(size=SHAPES))
    ]
    # gradients at rest to 1e-11 of the right-hand side, times the condition of the Gram matrix, about 100
    np.testing.assert_allclose(begun[1], begun[0], atol=1e-8)
    np.testing.assert_allclose(begun[2], begun[0], atol=1e-8)
    together = [solve_sequence(gram, right, 0.0, 1.0, 1e-4, 1e-3, start) for start in (np.zeros_like(right), np.ones_like(right))]
    assert together[0][1]
    np.testing.assert_allclose(together[0][0], together[1][0], atol=1e-8)


def test_frames_do_not_depend_on_those_before(basis, frames):
    solver = ExpressionSolver(basis, bounds=(0.0, 1.0))
    alone = np.concatenate([solver.solve(frame[None]) for frame in frames])
    # products of one frame and of many sum in another order: single precision times the condition of the shapes
    np.testing.assert_allclose(solver.solve(frames), alone, atol=1e-5)


def test_dependent_shapes_get_a_ridge_and_still_reproduce(basis, rng):
    twice = ExpressionBasis(
        [*basis.names, "sum"],
        basis.neutral,
        np.concatenate([basis.displacements, basis.displacements[:2].sum(axis=0, keepdims=True)]),
        NO_TRIANGLES,
    )
    assert ExpressionSolver(basis).ridge == 0.0
    frames = basis.blend(rng.uniform(0.2, 0.8, (6, SHAPES)))
    for bounds in (None, (0.0, 1.0)):
        solver = ExpressionSolver(twice, bounds=bounds)
        assert solver.ridge > 0
        found = solver.solve(frames)
        # a ten-thousandth of the motion
        np.testing.assert_allclose(twice.blend(found), frames, atol=1e-6)
        assert np.abs(found).max() < 1.0 + 1e-6


def test_a_performance_is_streamed_to_the_same_weights(basis, frames):
    performance = Performance(basis.neutral, NO_TRIANGLES, in_memory(frames, 7), np.arange(FRAMES) / 30, "take")
    solver = ExpressionSolver(basis, bounds=(0.0, 1.0), smoothing=0.1)
    np.testing.assert_allclose(solver.solve(performance), solver.solve(frames), atol=1e-6)


def test_frames_that_do_not_fit_are_refused(basis, frames):
    solver = ExpressionSolver(basis)
    with pytest.raises(InputError, match="59 points; expected 60"):
        solver.solve(frames[:, :59])
    frames[[3, 8], 2, 1] = np.nan
    with pytest.raises(InputError, match="frames 3, 8 are not finite"):
        solver.solve(frames)


@pytest.mark.parametrize("wrong", [{"bounds": (1.0, 0.0)}, {"smoothing": -1.0}, {"sparsity": -0.1}])
def test_settings_without_sense_are_refused(basis, wrong):
    with pytest.raises(ValueError, match=r"bounds|negative"):
        ExpressionSolver(basis, **wrong)
