"""The throat without its larynx: base T_0, direction t_s and weights W of a neutral head (section 5.2, eq. 8 to 10)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from headcap.errors import InputError
from headcap.meshes.laplacian import Factor, cotangent_laplacian
from headcap.neck.larynx.larynx_map import LarynxMap

BORDER_TRUST = 100.0
"""Weight of eq. 8's boundary term over its Laplacian term (1 / lambda): the base meets its border to a hundredth of the bump."""
LEAST_SHARE = 0.5
"""Offsets below this share of the largest say nothing about t_s: their direction is the Laplacian's, not the larynx's. Over
eleven rehearsed throats t_s is 0.6 to 10 degrees off with a half, up to 17 with a quarter, and up to 138 with a tenth: L is many
times as large as the bump, and each of its vertices has the same say in eq. 9."""


@dataclass(frozen=True, eq=False)
class Throat:
    """The larynx region L of one person's neutral head, k vertices, with the skin around it held (N(T_0) = N(T))."""

    neutral: NDArray[np.float64]
    """(k, 3) of the recorded neutral head, metres."""
    border: NDArray[np.bool_]
    """(k,) B, the vertices of L with a neighbour outside."""
    laplacian: sparse.csr_array
    """(k, k) cotangent Laplacian's rows and columns of L."""
    held: NDArray[np.float64]
    """(k, 3) what the same rows make of the vertices outside L."""
    triangles: NDArray[np.int32]
    """(m, 3) triangles within L."""

    @classmethod
    def of(cls, neutral: NDArray, triangles: NDArray, larynx: LarynxMap) -> Throat:
        """Of a neutral head (n, 3), (m, 3) in the topology of a larynx map."""
        neutral = np.asarray(neutral, float)
        inside = np.zeros(len(neutral), np.bool_)
        inside[larynx.vertices] = True
        rows = cotangent_laplacian(neutral, triangles, least_weight=0.0)[larynx.vertices]
        number = np.full(len(neutral), -1, np.int32)
        number[larynx.vertices] = np.arange(len(larynx.vertices))
        held = rows @ np.where(inside[:, None], 0.0, neutral)
        own = number[triangles[inside[triangles].all(axis=1)]]
        return cls(neutral[larynx.vertices], larynx.window == 0, sparse.csr_array(rows[:, larynx.vertices]), held, own)

    @property
    def stiffness(self) -> sparse.csr_array:
        """(k, k) quadratic part of eq. 16: L^T L."""
        return sparse.csr_array(self.laplacian.T @ self.laplacian)

    @property
    def pull(self) -> NDArray[np.float64]:
        """(k, 3) linear part of eq. 16, from the skin around L."""
        return self.laplacian.T @ self.held

    def roughness(self, base: NDArray) -> float:
        """E_Lap of eq. 16 for a base (k, 3), square metres."""
        return float(((self.laplacian @ base + self.held) ** 2).sum())

    def border_error(self, base: NDArray) -> float:
        """E_bdry of eq. 18 for a base (k, 3), square metres."""
        return float(((base - self.neutral)[self.border] ** 2).sum())


def bare_base(throat: Throat) -> NDArray[np.float64]:
    """T_0 on L (k, 3) by eq. 8: it meets the border and has as little Laplacian as it can."""
    matrix = throat.stiffness + BORDER_TRUST * sparse.diags_array(throat.border.astype(float))
    return Factor(matrix).solve(BORDER_TRUST * throat.border[:, None] * throat.neutral - throat.pull)


def bump_direction(throat: Throat, base: NDArray) -> NDArray[np.float64]:
    """t_s (3,) by eq. 9: the mean direction of the offsets from the base (k, 3) to the neutral throat.

    Raises `InputError` where nothing stands out from the base.
    """
    offset = throat.neutral - base
    length = np.linalg.norm(offset, axis=1)
    large = length > max(LEAST_SHARE * length.max(), 1e-9)
    total = (offset[large] / length[large, None]).sum(axis=0)
    if not large.any() or np.linalg.norm(total) < 1e-6:
        raise InputError(
            "the throat's offsets from its base have no common direction",
            expected="a larynx that stands out somewhere",
            remedy="Check that the neutral mesh is a head in metres, y up, z out of the face, and in the model's topology.",
        )
    return total / np.linalg.norm(total)


def initial_larynx(throat: Throat, empty: LarynxMap) -> tuple[NDArray[np.float64], LarynxMap]:
    """T_0 on L (k, 3) and the larynx map of a neutral head: eq. 8, eq. 9, ray shooting along t_s, eq. 10.

    Where the neutral throat lies below the base the weight is negative: eq. 10's length with the sign that keeps eq. 1 true.
    """
    surface = bare_base(throat)
    direction = bump_direction(throat, surface)
    shift = _shots(throat.neutral, direction, surface, throat.triangles)
    base = throat.neutral + shift[:, None] * direction
    base[throat.border] = throat.neutral[throat.border]
    weights = (throat.neutral - base) @ direction
    return base, empty.with_weights(empty.weights_m, direction).fitted(weights)


@njit(cache=True)
def _shots(points, direction, vertices, triangles):
    """(k,) nearest signed distance along a direction from each point to a surface; 0 where the line misses it."""
    nearest = np.full(len(points), np.inf)
    for f in range(len(triangles)):
        a, b, c = vertices[triangles[f, 0]], vertices[triangles[f, 1]], vertices[triangles[f, 2]]
        u, v = b - a, c - a
        p = np.cross(direction, v)
        determinant = np.dot(u, p)
        if abs(determinant) < 1e-18:
            continue
        for i in range(len(points)):
            s = points[i] - a
            x = np.dot(s, p) / determinant
            if x < -1e-9 or x > 1 + 1e-9:
                continue
            q = np.cross(s, u)
            y = np.dot(direction, q) / determinant
            if y < -1e-9 or x + y > 1 + 1e-9:
                continue
            t = np.dot(v, q) / determinant
            if abs(t) < abs(nearest[i]):
                nearest[i] = t
    return np.where(np.isfinite(nearest), nearest, 0.0)
