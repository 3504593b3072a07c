"""Takes of a rig as the inpainting reads them: what was recorded, and the head that was tracked in it, at any moment."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.recordings.frames import TakeFrames
from headcap.recordings.takes import IngestedTake
from headcap.registration.sequence import MeshSequence, joined
from headcap.sync.offsets import TimeOffsets
from headcap.sync.timeline import open_take

_NEIGHBOURS = 4
"""Tracked frames that tell the mesh between them: through so many a cubic goes."""


@dataclass(frozen=True, eq=False)
class TrackedTake:
    """What a rig recorded of a take, and the meshes that were tracked in it."""

    recorded: IngestedTake
    offsets: TimeOffsets
    sequence: MeshSequence

    def open(self) -> TakeFrames:
        """The pictures on the common clock; use as a context manager."""
        return open_take(self.recorded, self.offsets)


@dataclass(frozen=True)
class TrackedTakeFiles:
    """Where a tracked take lies."""

    ingested: Path
    offsets: Path
    sequence: Path

    def load(self) -> TrackedTake:
        """Raises `ArtifactError`."""
        recorded, offsets = IngestedTake.load(self.ingested), TimeOffsets.load(self.offsets)
        return TrackedTake(recorded, offsets, MeshSequence.load(self.sequence))


class MeshMotion:
    """A tracked head at any moment of its take: cameras do not fire when the take's frames are.

    Vertices follow the cubic through the four frames around a moment (Lagrange's form). A straight line between two frames at
    30 Hz would leave out up to 0.5 mm of lips that swing by 10 mm thrice a second.
    """

    def __init__(self, sequence: MeshSequence, vertices: int) -> None:
        """Of heads of so many vertices."""
        self.time_s, self._meshes = np.asarray(sequence.time_s, float), joined(sequence, vertices)

    def at(self, moment_s: float) -> NDArray[np.float64]:
        """The mesh (n, 3), metres, at a time of the common clock."""
        count = min(_NEIGHBOURS, len(self.time_s))
        first = int(np.clip(np.searchsorted(self.time_s, moment_s) - count // 2, 0, len(self.time_s) - count))
        near = slice(first, first + count)
        times = self.time_s[near]
        weights = [np.prod((moment_s - np.delete(times, k)) / (own - np.delete(times, k))) for k, own in enumerate(times)]
        return np.tensordot(weights, self._meshes[near].astype(float), axes=1)
