"""What a pose leaves of a tracked mesh at rest, and its derivative: the inner loop of pose estimation."""

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

PARAMETERS = 12
"""Tangents: the placement's turn and shift, in the head's frame, then the turns of neck and jaw."""


@njit(cache=True, fastmath=True)
def unposed_residuals(observed, rest, correctives, weights, joints, turns, shift, residual, jacobian):
    """Residuals r (k, 3) = unskinned(observed) - rest - B_P(theta) and J = -dr/dx (3 k, 12) in place (eq. 4, 5).

    `observed`, `rest` (k, 3) metres, `correctives` (k, 18 or 0, 3), `weights` (k, 3) of trunk, neck, jaw, `joints` (2, 3),
    `turns` (3, 3, 3) rotations of placement, neck, jaw, `shift` (3,). Tangents x: placement R exp(a), t + R b; neck exp(c) R;
    jaw exp(d) R. An empty `jacobian` is not filled. Everything is exact, not only near a good fit.
    """
    root, neck, jaw = turns[0], turns[1], turns[2]
    chin, features = neck @ jaw, _features(neck, jaw)
    slopes, inverse = _feature_slopes(neck, jaw), np.empty((3, 3))
    q, u = np.empty(3), np.empty(3)
    for v in range(len(rest)):
        for i in range(3):
            q[i] = 0.0
            for j in range(3):
                q[i] += root[j, i] * (observed[v, j] - shift[j])
        _unskin_one(q, weights[v], neck, chin, joints, inverse, u)
        for i in range(3):
            residual[v, i] = u[i] - rest[v, i]
        for f in range(correctives.shape[1]):
            for i in range(3):
                residual[v, i] -= features[f] * correctives[v, f, i]
        if len(jacobian) == 0:
            continue
        _fill_turns(q, u, weights[v], neck, jaw, joints, inverse, jacobian[3 * v : 3 * v + 3])
        if correctives.shape[1] > 0:
            for f in range(9):
                for axis in range(3):
                    for i in range(3):
                        jacobian[3 * v + i, 6 + axis] += slopes[0, axis, f] * correctives[v, f, i]
                        jacobian[3 * v + i, 9 + axis] += slopes[1, axis, f] * correctives[v, 9 + f, i]


@njit(cache=True, fastmath=True)
def _unskin_one(q, weights, neck, chin, joints, inverse, u):
    """u, which the bones' blend takes to q (both in the head's frame), and the inverse of the blend's 3 x 3 part."""
    blend, away = np.empty((3, 3)), np.empty(3)
    for i in range(3):
        away[i] = q[i] - (weights[1] + weights[2]) * joints[0, i]
        for j in range(3):
            blend[i, j] = weights[1] * neck[i, j] + weights[2] * chin[i, j]
            between = joints[1, j] - joints[0, j]
            away[i] += weights[1] * neck[i, j] * joints[0, j] + weights[2] * (chin[i, j] * joints[1, j] - neck[i, j] * between)
        blend[i, i] += weights[0]
    _invert(blend, inverse)
    _apply(inverse, away, u)


@njit(cache=True, fastmath=True)
def _fill_turns(q, u, weights, neck, jaw, joints, inverse, rows):
    """Rows (3, 12) of J for one vertex, but for what the pose correctives add."""
    arm, at_jaw, tip, column = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    # what the turns act on: q for the placement, what hangs on the neck, what hangs on the jaw
    for i in range(3):
        at_jaw[i] = 0.0
        for j in range(3):
            at_jaw[i] += jaw[i, j] * (u[j] - joints[1, j])
    for i in range(3):
        arm[i] = 0.0
        for j in range(3):
            hanging = weights[1] * (u[j] - joints[0, j]) + weights[2] * (at_jaw[j] + joints[1, j] - joints[0, j])
            arm[i] += neck[i, j] * hanging
    for axis in range(3):
        _cross_unit(axis, q, column)
        _store(inverse, column, rows, axis)
        for i in range(3):
            column[i] = 1.0 if i == axis else 0.0
        _store(inverse, column, rows, 3 + axis)
        _cross_unit(axis, arm, column)
        _store(inverse, column, rows, 6 + axis)
        _cross_unit(axis, at_jaw, tip)
        for i in range(3):
            column[i] = weights[2] * (neck[i, 0] * tip[0] + neck[i, 1] * tip[1] + neck[i, 2] * tip[2])
        _store(inverse, column, rows, 9 + axis)


@njit(cache=True)
def _features(neck, jaw):
    """(18,) R(theta) - I row by row, as `heads.skinning.pose_features`."""
    out = np.empty(18)
    for r in range(3):
        for c in range(3):
            own = 1.0 if r == c else 0.0
            out[3 * r + c], out[9 + 3 * r + c] = neck[r, c] - own, jaw[r, c] - own
    return out


@njit(cache=True)
def _feature_slopes(neck, jaw):
    """(2, 3, 9) derivatives [e]x R of the pose features by tangents."""
    out = np.empty((2, 3, 9))
    column, turned = np.empty(3), np.empty(3)
    for joint in range(2):
        for axis in range(3):
            for c in range(3):
                for r in range(3):
                    column[r] = neck[r, c] if joint == 0 else jaw[r, c]
                _cross_unit(axis, column, turned)
                for r in range(3):
                    out[joint, axis, 3 * r + c] = turned[r]
    return out


@njit(cache=True, inline="always")
def _cross_unit(axis, vector, out):
    """Unit vector of an axis, cross a vector."""
    a, b = (axis + 1) % 3, (axis + 2) % 3
    out[axis] = 0.0
    out[a] = -vector[b]
    out[b] = vector[a]


@njit(cache=True, inline="always")
def _apply(matrix, vector, out):
    for i in range(3):
        out[i] = matrix[i, 0] * vector[0] + matrix[i, 1] * vector[1] + matrix[i, 2] * vector[2]


@njit(cache=True, inline="always")
def _store(inverse, column, rows, parameter):
    for i in range(3):
        rows[i, parameter] = inverse[i, 0] * column[0] + inverse[i, 1] * column[1] + inverse[i, 2] * column[2]


@njit(cache=True, inline="always")
def _invert(m, out):
    for i in range(3):
        a, b = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            c, d = (j + 1) % 3, (j + 2) % 3
            out[j, i] = m[a, c] * m[b, d] - m[a, d] * m[b, c]
    scale = 1.0 / (m[0, 0] * out[0, 0] + m[0, 1] * out[1, 0] + m[0, 2] * out[2, 0])
    for i in range(3):
        for j in range(3):
            out[i, j] *= scale


def moved(turns: NDArray, shift: NDArray, step: NDArray) -> tuple[NDArray, NDArray]:
    """Turns (3, 3, 3) and shift (3,) after a step of tangents (12,)."""
    small = Rotation.from_rotvec(step.reshape(4, 3)[[0, 2, 3]]).as_matrix()
    return np.stack([turns[0] @ small[0], small[1] @ turns[1], small[2] @ turns[2]]), shift + turns[0] @ step[3:6]
