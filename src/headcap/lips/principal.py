"""Principal components of more correction layers than fit a singular value decomposition, take by take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_BLOCK = 4096
_LEAST_SPREAD = 1e-4
"""Components below this share of the first one's deviation are rounding."""
_SPARE, _ROUNDS = 12, 2
"""Directions beyond those wanted, and passes that sharpen them: the spectrum of corrections falls fast."""


@dataclass(frozen=True, eq=False)
class PrincipalCorrections:
    """k principal components of frames with p numbers each."""

    mean: NDArray[np.float32]
    """(p,)"""
    components: NDArray[np.float32]
    """(k, p) orthonormal, of falling variance."""
    coordinates: tuple[NDArray[np.float64], ...]
    """Per take (f, k)."""
    energy: float
    """Sum of squares about the mean."""

    @property
    def lost(self) -> float:
        """Sum of squares about the mean that no component tells."""
        return max(self.energy - float(sum((part**2).sum() for part in self.coordinates)), 0.0)


def principal_corrections(takes: Sequence[NDArray[np.float32]], count: int, seed: int = 0) -> PrincipalCorrections:
    """Leading components of takes of (f, p) numbers, which may be memory maps.

    Randomised range finder with power iterations (Halko, Martinsson & Tropp 2011, algorithms 4.4 and 5.1) in single precision,
    sums in double: takes are read nine times and never copied; memory is that of (frames + p) x count.
    """
    frames, width = sum(map(len, takes)), takes[0].shape[1]
    wanted = min(count + _SPARE, frames, width)
    mean = (sum(take.sum(axis=0, dtype=np.float64) for take in takes) / frames).astype(np.float32)
    energy = sum(_energy(take, mean) for take in takes)
    directions = np.random.default_rng(seed).normal(size=(width, wanted)).astype(np.float32)
    for _ in range(_ROUNDS + 1):
        seen = np.linalg.qr(np.concatenate([_seen(take, mean, directions) for take in takes]))[0]
        directions = _back(takes, mean, seen)
    components = _orthonormal(directions, count)
    coordinates = tuple(_seen(take, mean, components.T).astype(np.float64) for take in takes)
    return PrincipalCorrections(mean, components, coordinates, energy)


def _orthonormal(directions: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    """(k, p) principal axes of directions (p, j) by their Gram matrix in double: a tenth of the time of a decomposition of all.

    What single precision does not tell from nothing is left out.
    """
    gram = np.zeros((directions.shape[1],) * 2)
    for start in range(0, len(directions), _BLOCK):
        block = directions[start : start + _BLOCK].astype(np.float64)
        gram += block.T @ block
    values, turn = np.linalg.eigh(gram)
    kept = np.argsort(values)[::-1][:count]
    kept = kept[values[kept] > (_LEAST_SPREAD**2) * values.max(initial=0.0)]
    return np.ascontiguousarray((directions @ (turn[:, kept] / np.sqrt(values[kept])).astype(np.float32)).T)


def _energy(take: NDArray, mean: NDArray) -> float:
    # sum of squares about the mean, row by row so that nothing is copied
    return float(sum(np.square(row - mean, dtype=np.float64).sum() for row in take))


def _seen(take: NDArray, mean: NDArray, directions: NDArray) -> NDArray[np.float32]:
    return take @ directions - mean @ directions


def _back(takes: Sequence[NDArray], mean: NDArray, seen: NDArray) -> NDArray[np.float32]:
    out, first = -np.outer(mean, seen.sum(axis=0)), 0
    for take in takes:
        out += take.T @ seen[first : first + len(take)]
        first += len(take)
    return out
