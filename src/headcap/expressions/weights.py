"""Weights of a basis that reproduce frames, for all frames at once (quasi-eigen paper, eq. 5)."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct
from scipy.linalg import solve_triangular

from headcap.errors import InputError
from headcap.expressions.basis import ExpressionBasis
from headcap.expressions.bounded import solve_frames, solve_sequence
from headcap.expressions.performance import Performance

SINGULAR = 1e-10
"""Eigenvalue of the Gram matrix of unit shapes, over the largest, below which shapes in single precision are dependent."""
RIDGE = 1e-8
"""Over the mean square norm of the shapes, added where they are dependent."""

Bounds = tuple[float, float] | None


class ExpressionSolver:
    """Weights of frames in a basis: eq. 5, free, non-negative (bounds (0, inf)) or in a box, smooth over time, sparse.

    Minimises 1/2 sum_t |d_t - sum_i w_ti e_i|^2 + 1/2 smoothing g sum_t |w_t - w_{t-1}|^2 + sparsity g sum_ti |w_ti| over all
    frames together, with g the mean square norm of the shapes: `smoothing` is how dear a unit step of all weights is beside a
    unit error of them, `sparsity` the weight under which a shape that stands alone is left out. Bounds hold for all shapes
    alike. Every case is solved to its optimum: free weights by one cached Cholesky factor, smooth ones in the cosines that
    diagonalise differences over time, bounded and sparse ones by projected Newton steps (`bounded`), each frame begun at the
    last one's weights. Smoothing with bounds or sparsity takes frames x shapes^2 doubles of memory.

    Where shapes depend on each other weights are not unique: `ridge` (square metres, 0 where there was no need) is then added
    to the Gram matrix, which prefers small weights. Frames are projected on orthonormal combinations of the shapes, so that
    single precision costs a weight its rounding times the condition of the shapes and not times its square.
    """

    def __init__(self, basis: ExpressionBasis, *, bounds: Bounds = None, smoothing: float = 0.0, sparsity: float = 0.0) -> None:
        if smoothing < 0 or sparsity < 0:
            raise ValueError(f"smoothing {smoothing} and sparsity {sparsity} must not be negative")
        if bounds is not None and not bounds[0] < bounds[1]:
            raise ValueError(f"bounds {bounds} leave no room")
        self.basis, self.bounds = basis, bounds
        rows = basis.rows.astype(np.float64)
        self.gram = rows @ rows.T
        typical = float(np.trace(self.gram)) / len(basis)
        self.ridge = RIDGE * typical if _dependent(self.gram) else 0.0
        self.gram[np.diag_indices(len(basis))] += self.ridge
        self._factor = np.linalg.cholesky(self.gram)
        self._axes = solve_triangular(self._factor, rows, lower=True).astype(np.float32)
        self._smoothing, self._sparsity = smoothing * typical, sparsity * typical

    def solve(self, displacements: NDArray | Performance) -> NDArray[np.float64]:
        """Weights (l, k) of displacements (l, n, 3) in metres, or of a performance, whose frames are streamed.

        Raises `InputError` where the points are not those of the basis, or frames are not finite.
        """
        if isinstance(displacements, Performance):
            parts: Iterable[NDArray] = displacements.rows()
        else:
            parts = [np.asarray(displacements, np.float32).reshape(len(displacements), -1)]
        seen = np.concatenate([self._seen(part) for part in parts]).astype(np.float64)
        broken = np.flatnonzero(~np.isfinite(seen).all(axis=1))
        if len(broken):
            raise InputError(
                f"frames {', '.join(map(str, broken[:10]))}{' ...' if len(broken) > 10 else ''} are not finite",
                expected="finite coordinates in every frame",
                remedy="Repair or cut these frames.",
            )
        if self.bounds is None and self._sparsity == 0:
            return self._free(seen)
        return self._bounded(seen)

    def _seen(self, rows: NDArray) -> NDArray[np.float32]:
        if rows.shape[1] != self._axes.shape[1]:
            raise InputError(
                f"frames of {rows.shape[1] // 3} points",
                expected=f"{self._axes.shape[1] // 3} as the basis has",
                remedy="Give frames and basis of one topology.",
            )
        return rows @ self._axes.T

    def _free(self, seen: NDArray) -> NDArray[np.float64]:
        if self._smoothing == 0:
            return solve_triangular(self._factor, seen.T, lower=True, trans="T").T
        return _smooth(self.gram, seen @ self._factor.T, self._smoothing)

    def _bounded(self, seen: NDArray) -> NDArray[np.float64]:
        low, high = (-np.inf, np.inf) if self.bounds is None else self.bounds
        right, start = seen @ self._factor.T, np.clip(np.zeros(len(self.basis)), low, high)
        if self._smoothing == 0:
            weights, unsettled = solve_frames(self.gram, right, low, high, self._sparsity, start)
        else:
            begin = _smooth(self.gram, right, self._smoothing)
            weights, settled = solve_sequence(self.gram, right, low, high, self._sparsity, self._smoothing, begin)
            unsettled = 0 if settled else len(seen)
        if unsettled:
            raise ArithmeticError(f"the weights of {unsettled} of {len(seen)} frames did not settle")
        return weights


def _dependent(gram: NDArray) -> bool:
    length = np.sqrt(np.diagonal(gram))
    if length.min() <= 0:
        return True
    values = np.linalg.eigvalsh(gram / np.outer(length, length))
    return bool(values[0] < SINGULAR * values[-1])


def _smooth(gram: NDArray, right: NDArray, smoothing: float) -> NDArray[np.float64]:
    """Free weights (l, k) of all frames together: eigenvectors of the Gram matrix, and cosines over time, part the unknowns.

    Squares of differences over l frames have the cosines of the discrete transform as eigenvectors, 2 - 2 cos(pi j / l).
    """
    values, turn = np.linalg.eigh(gram)
    bend = 2.0 - 2.0 * np.cos(np.pi * np.arange(len(right)) / len(right))
    spectrum = dct(right @ turn, type=2, norm="ortho", axis=0) / (values + smoothing * bend[:, None])
    return idct(spectrum, type=2, norm="ortho", axis=0) @ turn.T
