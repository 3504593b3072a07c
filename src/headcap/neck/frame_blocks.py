"""Frames in blocks, so that memory does not grow with their number."""

from __future__ import annotations

from collections.abc import Iterator


def in_blocks(count: int, size: int) -> Iterator[slice]:
    """Slices that cut `count` frames into blocks."""
    for first in range(0, count, size):
        yield slice(first, min(first + size, count))
