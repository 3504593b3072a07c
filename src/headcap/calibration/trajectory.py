"""The moving board as a smooth function of time: cubic B-splines of quaternion and place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
ORDER = 4
"""Coefficients that act at one moment (cubic)."""
WIDTH = 7
"""Numbers per coefficient: quaternion x, y, z, w and place x, y, z."""
BAND = ORDER * WIDTH
ACCELERATION_M_S2, ACCELERATION_RAD_S2 = 200.0, 400.0
"""Standard deviations of a board's acceleration where nothing was seen: more than a hand can do, so no bias where seen."""


@dataclass(frozen=True)
class Trajectory:
    """world_from_board over time; the quaternion is normalised where it is used."""

    start_s: float
    knot_s: float
    coefficients: Array
    """(k, 7)."""

    def basis(self, time_s: Array) -> tuple[NDArray[np.int64], Array, Array]:
        """First coefficient (n,), weights (n, 4) and their time derivatives (n, 4) at times (n,)."""
        u = (np.asarray(time_s, float) - self.start_s) / self.knot_s
        first = np.clip(np.floor(u).astype(int), 0, len(self.coefficients) - ORDER)
        w = u - first
        weights = np.stack([(1 - w) ** 3, 3 * w**3 - 6 * w**2 + 4, -3 * w**3 + 3 * w**2 + 3 * w + 1, w**3], axis=1) / 6
        slopes = np.stack([-((1 - w) ** 2), 3 * w**2 - 4 * w, -3 * w**2 + 2 * w + 1, w**2], axis=1) / (2 * self.knot_s)
        return first, weights, slopes

    def states(self, time_s: Array) -> tuple[Array, Array]:
        """Raw (n, 7) values and time derivatives at times (n,)."""
        first, weights, slopes = self.basis(time_s)
        near = self.coefficients[first[:, None] + np.arange(ORDER)]
        return np.einsum("nk,nkd->nd", weights, near), np.einsum("nk,nkd->nd", slopes, near)


def empty_trajectory(start_s: float, end_s: float, knot_s: float) -> Trajectory:
    """A board at rest in the origin, with coefficients for every moment from start to end."""
    count = int(np.ceil((end_s - start_s) / knot_s)) + ORDER
    return Trajectory(start_s, knot_s, np.tile([0, 0, 0, 1.0, 0, 0, 0], (count, 1)))


def turn_jacobian(quaternion: Array) -> Array:
    """(n, 3, 4) derivative of the rotation vector (about world axes) with respect to raw quaternions (n, 4).

    A turn by dq is twice the vector part of dq * conj(q) / |q|^2.
    """
    x, y, z, w = (quaternion / np.sum(quaternion**2, axis=1, keepdims=True)).T
    rows = [[w, -z, y, -x], [z, w, -x, -y], [-y, x, w, -z]]
    return 2 * np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def motion_jacobian(state: Array) -> Array:
    """(n, 6, 7) derivative of (rotation vector, place) with respect to raw states (n, 7)."""
    out = np.zeros((len(state), 6, WIDTH))
    out[:, :3, :4] = turn_jacobian(state[:, :4])
    out[:, 3:, 4:] = np.eye(3)
    return out


def spread(jacobian: Array, weights: Array) -> Array:
    """(n, r, 7) derivatives by state to (n, r, 28) derivatives by the four acting coefficients."""
    return np.einsum("nrd,nk->nrkd", jacobian, weights).reshape(len(jacobian), jacobian.shape[1], BAND)


class BandedNormal:
    """Normal equations of coefficients, as the lower band that scipy's banded Cholesky takes."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.count = trajectory.coefficients.size
        self.band = np.zeros((BAND, self.count))
        self.right = np.zeros(self.count)
        self._prior(trajectory)

    def add(self, first: NDArray[np.int64], blocks: Array, right: Array) -> None:
        """Add blocks (n, 28, 28) and right sides (n, 28) at coefficients `first` (n,)."""
        row, column = np.tril_indices(BAND)
        flat = ((row - column) * self.count + column)[None] + (first * WIDTH)[:, None]
        self.band += np.bincount(flat.ravel(), blocks[:, row, column].ravel(), self.band.size).reshape(self.band.shape)
        places = (first * WIDTH)[:, None] + np.arange(BAND)
        self.right += np.bincount(places.ravel(), right.ravel(), self.count)

    def solve(self, right: Array) -> Array:
        """Solve for right sides (count, ...)."""
        if not hasattr(self, "_factor"):
            self._factor = cholesky_banded(self.band, lower=True)
        return cho_solve_banded((self._factor, True), right)

    def _prior(self, trajectory: Trajectory) -> None:
        """Small second differences, and quaternions of unit length."""
        c, h = trajectory.coefficients, trajectory.knot_s
        sigma = np.r_[np.full(4, ACCELERATION_RAD_S2 / 2), np.full(3, ACCELERATION_M_S2)] * h**2
        difference = np.kron(np.array([[1.0, -2.0, 1.0]]), np.diag(1 / sigma))
        block = np.zeros((BAND, BAND))
        block[: 3 * WIDTH, : 3 * WIDTH] = difference.T @ difference
        count = len(c) - ORDER + 1
        windows = np.stack([c[i : i + count] for i in range(ORDER)], axis=1).reshape(count, BAND)
        self.add(np.arange(count), np.broadcast_to(block, (count, BAND, BAND)), -windows @ block)
        last = np.zeros((BAND, BAND))
        last[WIDTH:, WIDTH:] = block[: 3 * WIDTH, : 3 * WIDTH]
        self.add(np.array([count - 1]), last[None], -windows[-1:] @ last)
        # the length of a quaternion is free; a per mille holds it without moving what it stands for
        unit = np.zeros((len(c), BAND, BAND))
        gradient = 2 * c[:, :4]
        place = np.minimum(np.arange(len(c)), len(c) - ORDER)
        offset = (np.arange(len(c)) - place) * WIDTH
        right = np.zeros((len(c), BAND))
        for i in range(len(c)):
            rows = slice(offset[i], offset[i] + 4)
            unit[i, rows, rows] = np.outer(gradient[i], gradient[i]) * 1e6 + np.eye(4) * 1e-3
            right[i, rows] = -gradient[i] * (np.sum(c[i, :4] ** 2) - 1) * 1e6
        self.add(place, unit, right)


def fit_poses(trajectory: Trajectory, time_s: Array, world_from_board: Array, *, rounds: int = 4) -> Trajectory:
    """Least-squares start from single poses (n, 4, 4) at times (n,), false ones weighed down (Cauchy)."""
    order = np.argsort(time_s, kind="stable")
    time_s, poses = time_s[order], world_from_board[order]
    quaternion = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    _same_hemisphere(quaternion)
    target = np.hstack([quaternion, poses[:, :3, 3]])
    first, weights, _ = trajectory.basis(time_s)
    jacobian = spread(np.broadcast_to(np.eye(WIDTH), (len(target), WIDTH, WIDTH)), weights)
    # single views give a board's place to some millimetres and its turn to half a degree
    sigma = np.r_[np.full(4, 0.005), np.full(3, 0.003)]
    zero = Trajectory(trajectory.start_s, trajectory.knot_s, np.zeros_like(trajectory.coefficients))
    fitted = Trajectory(zero.start_s, zero.knot_s, zero.coefficients + np.r_[quaternion[0], poses[0, :3, 3]])
    trust = np.ones(len(target))
    for _ in range(rounds):
        normal = BandedNormal(fitted)
        weighted = jacobian / sigma[:, None] * np.sqrt(trust)[:, None, None]
        residual = (target - fitted.states(time_s)[0]) / sigma * np.sqrt(trust)[:, None]
        normal.add(first, np.einsum("nri,nrj->nij", weighted, weighted), np.einsum("nri,nr->ni", weighted, residual))
        step = normal.solve(normal.right).reshape(-1, WIDTH)
        fitted = Trajectory(fitted.start_s, fitted.knot_s, fitted.coefficients + step)
        off = np.linalg.norm((target - fitted.states(time_s)[0]) / sigma, axis=1)
        trust = 1 / (1 + (off / 3) ** 2)
    return fitted


def _same_hemisphere(quaternion: Array) -> None:
    """Give each quaternion (n, 4) the sign that is nearest to the mean of the few before it (in place)."""
    for i in range(1, len(quaternion)):
        if quaternion[i] @ quaternion[max(0, i - 5) : i].sum(0) < 0:
            quaternion[i] *= -1
