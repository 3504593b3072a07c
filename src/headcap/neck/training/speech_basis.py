"""Speech blendshapes: leading singular vectors of what the larynx leaves (paper, section 5.2, "Blendshape update", eq. 3, 20).

Outside the larynx region a frame's residual M_j - T_0 is the same in every iteration (N(T_0) = N(T)). It is therefore reduced
once to its leading coordinates; inside, the residual itself is kept. The basis of these coordinates is orthonormal, so singular
vectors of the reduced matrix are those of the whole one, up to what the reduction left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

Blocks = Callable[[], Iterable[NDArray]]
"""Gives the rows of a tall matrix anew at each call, in blocks (f, c)."""

OVERSAMPLING = 10
SETTLED, MOST_PASSES = 1e-3, 12


def leading_directions(
    blocks: Blocks, columns: int, count: int, *, start: NDArray | None = None, seed: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Leading right singular vectors (count, c), orthonormal rows, and singular values (count,) of a tall matrix.

    Randomised subspace iteration with Rayleigh-Ritz (Halko et al. 2011): every pass reads the matrix once. `start` (any, c) are
    directions near the wanted ones. Stops when a pass changes the captured energy by less than a thousandth of what is left.
    """
    width = min(count + OVERSAMPLING, columns)
    subspace = _orthonormal(_filled(start, width, columns, seed))
    captured = -np.inf
    for _ in range(MOST_PASSES):
        image, energy = _power(blocks, subspace)
        values, turn = np.linalg.eigh(subspace @ image.T)
        values, turn = values[::-1], turn[:, ::-1]
        before, captured = captured, float(values[:count].sum())
        if captured - before <= SETTLED * max(energy - captured, 0.0) + 1e-12 * energy:
            break
        subspace = _orthonormal(turn.T @ image)
    vectors = (turn.T @ subspace)[:count]
    return vectors, np.sqrt(np.maximum(values[:count], 0.0))


def reduce_rows(blocks: Blocks, columns: int, count: int, *, seed: int = 0) -> tuple[NDArray, NDArray, float]:
    """Rows of a tall matrix in their leading coordinates (f, count), the directions (count, c), and the energy left out."""
    directions, _ = leading_directions(blocks, columns, count, seed=seed)
    directions = directions.astype(np.float32)
    energy, parts = 0.0, []
    for block in blocks():
        energy += float(np.einsum("fc,fc->", block, block, dtype=np.float64))
        parts.append(block @ directions.T)
    reduced = np.concatenate(parts)
    return reduced, directions, max(energy - float((reduced.astype(float) ** 2).sum()), 0.0)


def _power(blocks: Blocks, subspace: NDArray) -> tuple[NDArray, float]:
    """S^T S applied to the rows of a subspace (w, c), and the energy of S."""
    image, energy = np.zeros_like(subspace), 0.0
    for block in blocks():
        basis = subspace.astype(block.dtype)
        image += (block @ basis.T).T.astype(block.dtype) @ block
        energy += float(np.einsum("fc,fc->", block, block, dtype=np.float64))
    return image, energy


def _filled(start: NDArray | None, width: int, columns: int, seed: int) -> NDArray:
    random = np.random.default_rng(seed).standard_normal((width, columns))
    if start is not None and len(start):
        random[: min(len(start), width)] = start[:width] * np.sqrt(columns)
    return random


def _orthonormal(rows: NDArray) -> NDArray[np.float64]:
    return np.ascontiguousarray(qr(rows.T, mode="economic")[0].T)
