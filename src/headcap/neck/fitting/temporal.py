"""Coefficients over a whole sequence: a temporal prior that goes with the data term, and what it does to a given motion.

The prior charges accelerations in the measure in which the meshes charge errors: least sum_t w_t |x_t - x^_t|_H^2 + strength *
sum_t |second difference of x|_H^2, H the data term's Hessian. Where H is that of all frames, as it is for psi and phi (their
bases do not change) and nearly so for pose and larynx, the joint minimum over a sequence is reached coefficient by coefficient:
each is smoothed alone, by one banded solve, and directions that the meshes tell less are not smoothed more than others.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.linalg import solveh_banded
from scipy.spatial.transform import Rotation


class TemporalPrior(BaseModel):
    """How fast coefficients may change: motion at the cutoff is halved, slower motion of frequency f loses (f / cutoff)^4."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    cutoff_hz: float = Field(8.0, gt=0, description="Frequency that keeps half its amplitude; heads shake at 2 to 4 Hz")


def smoothed(values: NDArray, time_s: NDArray, prior: TemporalPrior, weights: NDArray | None = None) -> NDArray[np.float64]:
    """Values (f, ...) at rising moments (f,) under a temporal prior; `weights` (f,) say how much each frame counts, 1 by default.

    Frames of weight 0, which may be NaN, are filled by the smoothest curve. At an even rate r the answer to a motion of frequency
    f is 1 / (1 + (sin(pi f / r) / sin(pi cutoff / r))^4). Nothing is smoothed where the cutoff is half the rate or more, and
    nothing is known where no frame counts. Cost: proportional to f.
    """
    values, time_s = np.asarray(values, float), np.asarray(time_s, float)
    f = len(values)
    weights = np.ones(f) if weights is None else np.asarray(weights, float)
    fine = weights > 0
    if f < 3 or not fine.any():
        return np.array(values)
    step = float(np.median(np.diff(time_s)))
    flat = np.where(fine[:, None], values.reshape(f, -1), 0.0)
    if 2 * prior.cutoff_hz * step >= 1.0:
        if fine.all():
            return np.array(values)
        strength = 1e-9  # nothing is smoothed, gaps are filled all the same
    else:
        strength = (2.0 * np.sin(np.pi * prior.cutoff_hz * step)) ** -4
    if fine.sum() < 2:
        return np.broadcast_to(values[fine][0], values.shape).copy()
    banded = strength * _bending(time_s / step)
    banded[2] += weights
    return solveh_banded(banded, weights[:, None] * flat).reshape(values.shape)


def smoothed_rotations(
    rotations: NDArray, time_s: NDArray, prior: TemporalPrior, weights: NDArray | None = None
) -> NDArray[np.float64]:
    """Rotations (f, 3, 3) under a temporal prior, as turns from their mean: any orientation in the room is as good as another."""
    fine = np.isfinite(rotations).all(axis=(1, 2)) if weights is None else np.asarray(weights) > 0
    if not fine.any():
        return np.array(rotations)
    mean = Rotation.from_matrix(rotations[fine]).mean()
    turns = np.zeros((len(rotations), 3))
    turns[fine] = (mean.inv() * Rotation.from_matrix(rotations[fine])).as_rotvec()
    return (mean * Rotation.from_rotvec(smoothed(turns, time_s, prior, fine.astype(float)))).as_matrix()


def smoothed_placements(
    placement: NDArray, time_s: NDArray, prior: TemporalPrior, weights: NDArray | None = None
) -> NDArray[np.float64]:
    """Rigid transforms (f, 4, 4) under a temporal prior."""
    out = np.tile(np.eye(4), (len(placement), 1, 1))
    out[:, :3, :3] = smoothed_rotations(placement[:, :3, :3], time_s, prior, weights)
    out[:, :3, 3] = smoothed(placement[:, :3, 3], time_s, prior, weights)
    return out


def second_differences(time: NDArray) -> NDArray[np.float64]:
    """(f - 2, 3) weights of neighbouring frames in the second difference at moments (f,), exact for straight lines."""
    before, after = np.diff(time)[:-1], np.diff(time)[1:]
    whole = before + after
    return np.stack([2 / (before * whole), -2 / (before * after), 2 / (after * whole)], axis=1)


def _bending(time: NDArray) -> NDArray[np.float64]:
    """D^T D of second differences D over moments (f,), upper banded form (3, f)."""
    rows, f = second_differences(time), len(time)
    out = np.zeros((3, f))
    for i in range(3):
        for j in range(i, 3):
            out[2 - (j - i), j : j + f - 2] += rows[:, i] * rows[:, j]
    return out
