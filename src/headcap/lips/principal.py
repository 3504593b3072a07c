"""Principal components of more correction layers than fit a singular value decomposition, take by take."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.geometry.leading_directions import principal_components


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
    """Leading components of takes of (f, p) numbers, which may be memory maps; they are read nine times and never copied."""
    found = principal_components(lambda: takes, takes[0].shape[1], count, seed=seed)
    coordinates = tuple(found.coordinates(take).astype(np.float64) for take in takes)
    return PrincipalCorrections(found.mean, found.vectors, coordinates, found.energy)
