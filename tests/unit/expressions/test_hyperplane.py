import numpy as np
import pytest

from headcap.expressions import ExpressionBasis, Performance
from headcap.expressions.hyperplane import spanning_axes, unreached
from headcap.expressions.performance import in_memory
from headcap.expressions.principal import eigenfaces
from headcap.expressions.projection import quasi_eigen_faces

NONE = np.zeros((0, 3), np.int32)
POINTS, MODES = 30, 12


@pytest.fixture
def displacements(rng):
    """Falling modes about a mean that is not at rest, millimetres in metres."""
    modes = np.linalg.qr(rng.normal(size=(3 * POINTS, MODES)))[0].T
    weights = rng.normal(size=(200, MODES)) * 0.7 ** np.arange(MODES)
    return 0.01 * (weights @ modes + 0.5 * rng.normal(size=3 * POINTS) / np.sqrt(3 * POINTS)).reshape(200, POINTS, 3)


@pytest.fixture
def eigen(displacements):
    frames = np.arange(len(displacements)) / 30
    return eigenfaces(Performance(np.zeros((POINTS, 3)), NONE, in_memory(displacements), frames, "take"), count=MODES)


def hand_made(rng, count):
    names = tuple(f"shape {k}" for k in range(count))
    return ExpressionBasis(names, np.zeros((POINTS, 3)), 0.01 * rng.normal(size=(count, POINTS, 3)), NONE)


def left_over(basis, displacements):
    """Mean square that free weights leave, solved frame by frame."""
    rows, frames = basis.rows.astype(float), displacements.reshape(len(displacements), -1)
    weights = np.linalg.lstsq(rows.T, frames.T, rcond=1e-6)[0]
    return np.square(frames - weights.T @ rows).sum() / len(frames)


def test_what_is_left_is_told_without_the_frames(rng, displacements, eigen):
    hand = hand_made(rng, 6)
    for count in (1, 3, 5):
        axes = eigen.through_neutral(count)
        made = quasi_eigen_faces(hand, axes, augment=False).quasi
        # shapes, axes and mean are kept in single precision
        np.testing.assert_allclose(unreached(hand, eigen)[count - 1], left_over(made, displacements), rtol=1e-3)


def test_independent_shapes_get_one_axis_fewer_than_they_are(rng, eigen):
    assert len(spanning_axes(hand_made(rng, 6), eigen)) == 6


def test_no_other_number_of_axes_leaves_less(rng, displacements, eigen):
    """Also where two pairs of shapes are performed alike."""
    hand = hand_made(rng, 6)
    rows = hand.rows.astype(float).copy()
    axes = eigen.rows.astype(float)
    for one, other in ((0, 1), (2, 3)):
        rows[other] += ((rows[one] - rows[other]) @ axes.T) @ axes
    paired = ExpressionBasis(hand.names, hand.neutral, rows.reshape(6, POINTS, 3), NONE)
    chosen = spanning_axes(paired, eigen)
    others = [
        left_over(quasi_eigen_faces(paired, eigen.through_neutral(m), augment=False).quasi, displacements) for m in range(1, 6)
    ]
    found = left_over(quasi_eigen_faces(paired, chosen, augment=False).quasi, displacements)
    assert found <= min(others) * (1 + 1e-3)
    assert found < 0.9 * others[-1]
