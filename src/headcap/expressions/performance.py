"""What a person was captured doing: displacements from the neutral face over time (quasi-eigen paper, section 3)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

BLOCK = 64
"""Frames that are in memory at once where a sequence is read from a file."""


@dataclass(frozen=True, eq=False)
class Performance:
    """Xi of section 3: l frames of n points, without the head's motion, as displacements d* from the neutral face v^0."""

    neutral: NDArray[np.float32]
    """v^0 (n, 3) metres: vertices of a mesh or markers."""
    triangles: NDArray[np.int32]
    """(m, 3) of a mesh; (0, 3) where the points are markers."""
    blocks: Callable[[], Iterable[NDArray[np.float32]]]
    """Gives all frames anew at each call, in order, in blocks (f, n, 3) of displacements, metres."""
    time_s: NDArray[np.float64]
    """(l,)"""
    source: str
    """What it was read from, for messages and pages."""
    points: tuple[str, ...] = ()
    """Names of markers."""
    regions: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    """(n,) by name, where the topology is known."""
    figures: dict[str, float] = field(default_factory=dict)
    """What reading it found: filled gaps, residual of the head's motion..."""

    def __len__(self) -> int:
        return len(self.time_s)

    def __post_init__(self) -> None:
        object.__setattr__(self, "neutral", np.ascontiguousarray(self.neutral, np.float32))
        object.__setattr__(self, "triangles", np.ascontiguousarray(self.triangles, np.int32).reshape(-1, 3))

    @property
    def columns(self) -> int:
        """3 n."""
        return self.neutral.size

    def rows(self) -> Iterator[NDArray[np.float32]]:
        """The blocks as rows (f, 3 n) of a matrix."""
        for block in self.blocks():
            yield block.reshape(len(block), -1)


def in_memory(displacements: NDArray, block: int = BLOCK) -> Callable[[], Iterable[NDArray[np.float32]]]:
    """The blocks of an array (l, n, 3), which may be a memory map."""

    def blocks() -> Iterator[NDArray[np.float32]]:
        """The array from its first frame on."""
        for first in range(0, len(displacements), block):
            yield np.asarray(displacements[first : first + block], np.float32)

    return blocks


def joined(performances: Sequence[Performance]) -> Performance:
    """Several performances of one person one after another; the first one's neutral face, regions and rate serve for all.

    Raises `ValueError` where they differ in topology or neutral face.
    """
    first = performances[0]
    for other in performances[1:]:
        if not (np.array_equal(first.triangles, other.triangles) and np.allclose(first.neutral, other.neutral, atol=1e-6)):
            raise ValueError(f"{other.source} has another neutral face than {first.source}")
    step = float(np.median(np.diff(first.time_s))) if len(first) > 1 else 1.0

    def blocks() -> Iterator[NDArray[np.float32]]:
        """Those of one performance after those of the other."""
        for performance in performances:
            yield from performance.blocks()

    return Performance(
        neutral=first.neutral,
        triangles=first.triangles,
        blocks=blocks,
        time_s=np.arange(sum(map(len, performances))) * step,
        source=", ".join(performance.source for performance in performances),
        points=first.points,
        regions=first.regions,
    )
