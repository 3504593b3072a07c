"""The head's rigid motion, taken out of a performance: what is left is expression (quasi-eigen paper, section 5.1).

The paper's actress wore seven markers for it. A mesh has none: there the part that holds still is found, vertices whose distance
to the neutral face stays least once the head's motion is out, by reweighted alignment of some frames, and is kept for all frames.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.geometry.transforms import rigid, transform

_ROUNDS, _SETTLED = 30, 1e-3
_ENOUGH = 4000
"""Points that settle the motion of sampled frames; all are judged by it."""
_LEAST_SCALE_M = 1e-6
"""Residuals below a micrometre are rounding and must not part the vertices of a rigid body."""


def fit_rigid_frames(points: NDArray, target: NDArray, weights: NDArray | None = None) -> NDArray[np.float64]:
    """Least-squares rigid motions target_from_frame (f, 4, 4) of points (f, s, 3) onto a target (s, 3), all frames at once.

    `weights` (s,) or (f, s); a point of weight zero may be NaN. Kabsch's solution, a proper rotation always.
    """
    weights = np.broadcast_to(1.0 if weights is None else np.asarray(weights, float), points.shape[:2])
    share = weights / weights.sum(axis=1, keepdims=True)
    points = np.where(share[..., None] > 0, points, 0.0).astype(np.float64)
    source_mean = np.einsum("fs,fsk->fk", share, points)
    target_mean = share @ target
    # share stands on one side only: it sums both to zero
    moved = (target[None] - target_mean[:, None]) * share[..., None]
    u, _, vt = np.linalg.svd(np.swapaxes(moved, 1, 2) @ (points - source_mean[:, None]))
    u[:, :, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]
    rotation = u @ vt
    return rigid(rotation, target_mean - np.einsum("fij,fj->fi", rotation, source_mean))


def moved_frames(target_from_frame: NDArray, points: NDArray) -> NDArray[np.float64]:
    """Points (f, n, 3) under the motion (f, 4, 4) of each frame."""
    return points @ np.swapaxes(target_from_frame[:, :3, :3], 1, 2) + target_from_frame[:, None, :3, 3]


def displaced_frames(
    frames: NDArray, scale: float, target_from_frame: NDArray, target: NDArray, weights: NDArray
) -> NDArray[np.float32]:
    """Displacements w_v (M_f (scale x_fv) - y_v) of frames x (f, n, 3) from a target y (n, 3), with weights w (n,), in one pass.

    `scale` is metres per unit of the frames; (f, n, 3) metres, computed in double precision.
    """
    out = np.empty(frames.shape, np.float32)
    # a copy in any case, so that maps that cannot be written need no kernel of their own
    points = np.array(frames, np.float64 if frames.dtype.itemsize > 4 else np.float32)
    turns = np.ascontiguousarray(target_from_frame[:, :3, :3] * scale, np.float64)
    shifts = np.ascontiguousarray(target_from_frame[:, :3, 3], np.float64)
    _displace(points, turns, shifts, np.ascontiguousarray(target, np.float64), np.ascontiguousarray(weights, np.float64), out)
    return out


@njit(cache=True)
def _displace(points, turns, shifts, target, weights, out):
    for frame in range(points.shape[0]):
        turn, shift = turns[frame], shifts[frame]
        for vertex in range(points.shape[1]):
            x, y, z = points[frame, vertex, 0], points[frame, vertex, 1], points[frame, vertex, 2]
            for axis in range(3):
                moved = turn[axis, 0] * x + turn[axis, 1] * y + turn[axis, 2] * z + shift[axis]
                out[frame, vertex, axis] = weights[vertex] * (moved - target[vertex, axis])


def find_still(points: NDArray, target: NDArray, share: float) -> tuple[NDArray[np.bool_], float]:
    """What holds still, (s,), among points (f, s, 3) against the neutral (s, 3); and its rms residual, metres.

    `share` of the points is taken for still. Weights (1 + (r / r_share)^2)^-2 of each point's rms residual r over the frames are
    iterated from 1 (Geman and McClure's), so the vertices that move lose their say; r_share is the share's quantile of r.
    """
    some = np.arange(0, len(target), max(1, len(target) // _ENOUGH))
    few, few_target, weights = np.ascontiguousarray(points[:, some]), target[some], np.ones(len(some))
    for _ in range(_ROUNDS):
        motion = fit_rigid_frames(few, few_target, weights)
        residual = _residual(few, few_target, motion)
        scale = max(float(np.quantile(residual, share)), _LEAST_SCALE_M)
        before, weights = weights, (1 + (residual / scale) ** 2) ** -2
        if np.abs(weights - before).max() < _SETTLED:
            break
    residual = _residual(points, target, motion)
    scale = max(float(np.quantile(residual, share)), _LEAST_SCALE_M)
    still = residual <= scale
    return still, float(np.sqrt((residual[still] ** 2).mean()))


def _residual(points: NDArray, target: NDArray, motion: NDArray) -> NDArray[np.float64]:
    """(s,) rms distance over the frames of moved points (f, s, 3) from the target (s, 3), metres."""
    squared = np.zeros(len(target))
    for one, frame in zip(motion, points, strict=True):
        squared += ((transform(one, frame) - target) ** 2).sum(axis=1)
    return np.sqrt(squared / len(points))
