"""Frames of a mesh sequence as one array that is read where it is indexed; a cache on disk for formats that are slow to read."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError


class Positions(Protocol):
    """(f, n, 3) read where it is indexed."""

    shape: tuple[int, ...]

    def __getitem__(self, chosen: slice | NDArray) -> NDArray: ...


@dataclass(frozen=True, eq=False)
class MeshFrames:
    """f frames of n vertices as a file holds them."""

    positions: Positions
    """(f, n, 3) in the file's unit; metres where `in_metres`."""
    time_s: NDArray[np.float64]
    """(f,)"""
    source: str
    triangles: NDArray[np.int32] | None = None
    """(m, 3) where the file holds a topology."""
    in_metres: bool = False
    """The format says its unit, or is ours: whatever unit the caller names does not apply."""
    labels: tuple[str, ...] = ()
    """(f,) what each frame is called, where frames are files."""

    def __len__(self) -> int:
        return self.positions.shape[0]

    def called(self, frames: NDArray) -> str:
        """Frames by number, and by file where they are files: "3, 7 to 9"."""
        named = f" ({self.labels[frames[0]]})" if self.labels else ""
        return frame_runs(frames, 12) + named


class FrameCache:
    """An array (f, n, 3) float32 on disk that nobody else sees and that is gone with the last reference to it."""

    def __init__(self, frames: int, vertices: int) -> None:
        with tempfile.TemporaryFile() as handle:
            self.positions = np.memmap(handle, np.float32, "w+", shape=(frames, vertices, 3))

    def put(self, frame: int, vertices: NDArray) -> None:
        """Keep one frame (n, 3)."""
        self.positions[frame] = vertices


def decoded(frames: Iterable[NDArray], count: int, vertices: int) -> NDArray[np.float32]:
    """Frames (n, 3) put on disk one by one: (f, n, 3)."""
    cache = FrameCache(count, vertices)
    for frame, positions in enumerate(frames):
        cache.put(frame, positions)
    return cache.positions


def refuse_other_count(name: str, count: int, first: str, expected: int, what: str) -> None:
    """Raise `InputError` where a file has another count than the first one."""
    if count != expected:
        raise InputError(
            f"{name} has {count} {what}",
            expected=f"the {expected} of {first}",
            remedy="Export all frames from one mesh, in one vertex order.",
        )


def frame_runs(frames: NDArray, most: int = 6) -> str:
    """Frame numbers (rising) in words: "3, 7 to 9"."""
    edges = np.flatnonzero(np.diff(frames) > 1)
    firsts, lasts = frames[np.r_[0, edges + 1]], frames[np.r_[edges, len(frames) - 1]]
    told = [f"{a}" if a == b else f"{a} to {b}" for a, b in zip(firsts[:most], lasts[:most], strict=True)]
    return ", ".join(told) + (f" and {len(firsts) - most} runs more" if len(firsts) > most else "")
