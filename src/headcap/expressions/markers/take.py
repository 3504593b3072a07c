"""Labelled markers over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError


@dataclass(frozen=True, eq=False)
class MarkerTake:
    """f frames of k labelled markers in the capture system's frame."""

    names: tuple[str, ...]
    positions_m: NDArray[np.float64]
    """(f, k, 3); NaN where a marker was not seen."""
    time_s: NDArray[np.float64]
    """(f,) rising."""
    source: str
    notes: tuple[str, ...] = ()
    """What reading left out, in words."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        if self.positions_m.shape != (len(self.time_s), len(self.names), 3):
            raise ValueError(f"{len(self.time_s)} times, {len(self.names)} names, positions {self.positions_m.shape}")

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(f, k)"""
        return np.isfinite(self.positions_m).all(axis=2)

    def numbers(self, names: Sequence[str]) -> NDArray[np.int64]:
        """Places of markers by name; raises `InputError` naming those that are not there."""
        unknown = [name for name in names if name not in self.names]
        if unknown:
            raise InputError(
                f"{self.source} has no marker {', '.join(unknown)}",
                expected=", ".join(self.names),
                remedy="Use the take's labels.",
            )
        return np.array([self.names.index(name) for name in names], np.int64)

    def chosen(self, numbers: NDArray) -> MarkerTake:
        """Some of the markers, in the order asked for."""
        return replace(self, names=tuple(self.names[k] for k in numbers), positions_m=self.positions_m[:, numbers])

    def without(self, names: Sequence[str]) -> MarkerTake:
        """All but the markers named."""
        left_out = self.numbers(names)
        return self.chosen(np.setdiff1d(np.arange(len(self.names)), left_out))
