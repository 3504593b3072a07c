"""Second-order spherical-harmonics light on a diffuse surface (Ramamoorthi and Hanrahan 2001), with analytic derivatives.

Intensity of a point with albedo a and unit normal n in colour channel q: c_q = a_q sum_k L_qk A_k Y_k(n), k = 0..8, where Y_k
are the real harmonics of bands 0, 1, 2 and A_k = 1, 2/3, 1/4 (the clamped cosine's factors over pi). L is the distant radiance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

COEFFICIENTS = 9
_CONSTANT = 0.282095
_LINEAR = 0.488603 * 2.0 / 3.0
_MIXED, _AXIAL, _SQUARES = 1.092548 / 4.0, 0.315392 / 4.0, 0.546274 / 4.0


def harmonics(normals: NDArray) -> NDArray[np.float64]:
    """A_k Y_k (n, 9) of unit normals (n, 3)."""
    x, y, z = np.moveaxis(np.asarray(normals, np.float64), -1, 0)
    return np.stack(
        [
            np.full_like(x, _CONSTANT),
            _LINEAR * y,
            _LINEAR * z,
            _LINEAR * x,
            _MIXED * x * y,
            _MIXED * y * z,
            _AXIAL * (3.0 * z * z - 1.0),
            _MIXED * x * z,
            _SQUARES * (x * x - y * y),
        ],
        axis=-1,
    )


def shading(normals: NDArray, light: NDArray) -> NDArray[np.float64]:
    """Intensity (n, q) of white surface points with unit normals (n, 3) under light (q, 9)."""
    return harmonics(normals) @ np.asarray(light).T


def shading_slopes(normals: NDArray, light: NDArray) -> NDArray[np.float64]:
    """Derivative (n, q, 3) of `shading` by the normals (n, 3), taken as free vectors: bands are polynomials in x, y, z."""
    x, y, z = np.asarray(normals, np.float64).T
    light = np.asarray(light, np.float64)
    y1, z1, x1, xy, yz, zz, xz, squares = (light[:, k][None] for k in range(1, COEFFICIENTS))
    x, y, z = x[:, None], y[:, None], z[:, None]
    by_x = _LINEAR * x1 + _MIXED * (xy * y + xz * z) + 2.0 * _SQUARES * squares * x
    by_y = _LINEAR * y1 + _MIXED * (xy * x + yz * z) - 2.0 * _SQUARES * squares * y
    by_z = _LINEAR * z1 + _MIXED * (yz * y + xz * x) + 6.0 * _AXIAL * zz * z
    return np.stack([by_x, by_y, by_z], axis=-1)


def solve_light(
    normals: NDArray, albedo: NDArray, colours: NDArray, weights: NDArray, prior: NDArray, stiffness: float
) -> NDArray[np.float64]:
    """Light (q, 9) that explains colours (n, q) of points with normals (n, 3) and albedo (n, q), weighted least squares.

    `weights` (n,); `stiffness` is the share of the data's own weight with which each coefficient is held at `prior` (q, 9): what
    normals all alike do not tell stays where it was.
    """
    rows = harmonics(normals)
    out = np.empty((albedo.shape[1], COEFFICIENTS))
    for q in range(albedo.shape[1]):
        scaled = rows * albedo[:, q, None]
        matrix = (scaled * weights[:, None]).T @ scaled
        held = stiffness * max(np.trace(matrix) / COEFFICIENTS, 1e-30)
        right = scaled.T @ (weights * colours[:, q]) + held * prior[q]
        out[q] = np.linalg.solve(matrix + held * np.eye(COEFFICIENTS), right)
    return out
