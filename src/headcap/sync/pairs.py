"""One number per camera from differences between pairs of cameras, some of them wrong."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def from_pair_medians(differences: Array) -> Array:
    """Values (n,) with mean zero from differences[i, j] = x[j] - x[i], antisymmetric (n, n), NaN where unknown.

    Each value is the median over all detours by one other camera, from the camera whose detours scatter least; right as
    long as more than half of a camera's detours are.
    """
    n = len(differences)
    best, best_scatter = np.zeros(n), np.inf
    for root in range(n):
        detours = differences[root][:, None] + differences
        detours[root] = differences[root]
        values = _median(detours, 0.0)
        # a camera that no detour reaches costs more than any disagreement
        scatter = _median(np.abs(detours - values), 1e6).sum()
        if scatter < best_scatter:
            best, best_scatter = values, scatter
    return best - best.mean()


def solve_pairs(differences: Array, weights: Array, start: Array, scale: float, iterations: int = 30) -> Array:
    """Weighted least squares with Cauchy loss (iteratively reweighted): values (n,) of mean zero.

    `differences` as in `from_pair_medians`; `weights` (n, n) symmetric, 0 where a pair is unknown; `scale` is the residual
    at which a pair's weight is halved. It shrinks onto `scale` from the residuals of `start`, so a rough start is no trap.
    """
    known = np.isfinite(differences) & (weights > 0)
    target = np.where(known, differences, 0.0)
    values, n = start - start.mean(), len(start)
    widest = float(np.median(np.abs(residuals(target, values)[known]))) if known.any() else scale
    for step in range(iterations):
        current = max(scale, widest * 0.5**step)
        robust = np.where(known, weights / (1 + (residuals(target, values) / current) ** 2), 0.0)
        laplacian = np.diag(robust.sum(axis=1)) - robust
        rhs = (robust * target).sum(axis=0)
        values = np.linalg.lstsq(laplacian + 1.0 / n * robust.max(initial=1e-12), rhs, rcond=None)[0]
        values -= values.mean()
    return values


def residuals(differences: Array, values: Array) -> Array:
    """(n, n) differences minus what the values say."""
    return differences - (values[None, :] - values[:, None])


def _median(table: Array, unknown: float) -> Array:
    """Median of each column's known entries, `unknown` where there is none."""
    known = np.isfinite(table)
    filled = np.where(known.any(axis=0), np.where(known, table, np.nan), unknown)
    return np.nanmedian(filled, axis=0)
