"""What is wrong with lip contours that were drawn by hand, before anything learns from them."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.lips.features import LipContours

_CROSSING_PX = 1.0
"""A shut mouth's inner contour runs there and back along one line; drawn by hand its two ways cross by less than this."""
_OVER_PX = 3.0
"""How far the inner contour may lie outside the outer one: rolled-in lips have both in one, and a hand is not exact."""


def label_faults(labels: Mapping[int, LipContours], frames: int, size: tuple[int, int]) -> list[str]:
    """Lines that say what is wrong with labels of a video of so many frames of (width, height) pixels; none where all is well.

    Frames that the video does not have; contours that leave the picture; contours that cross themselves, as where points stand in
    another order than along the lips; an inner contour that leaves the outer one.
    """
    lines = []
    for frame, drawn in sorted(labels.items()):
        if not 0 <= frame < frames:
            lines.append(f"frame {frame}: there is none, the video has frames 0 to {frames - 1}")
            continue
        lines += [f"frame {frame}: {fault}" for fault in _faults(drawn, size)]
    return lines


def crossings(ring: NDArray, least_px: float = _CROSSING_PX) -> NDArray[np.int64]:
    """Pairs (c, 2) of sides of a ring (k, 2), by their first points, that cross with all four ends at least so far off."""
    ring = np.asarray(ring, float)
    first, second = np.triu_indices(len(ring), 2)
    # the last side meets the first in the ring's first point
    apart = (second - first) < len(ring) - 1
    first, second = first[apart], second[apart]
    ahead = np.roll(ring, -1, axis=0)
    own = _offsets(ring[first], ahead[first], ring[second], ahead[second])
    other = _offsets(ring[second], ahead[second], ring[first], ahead[first])
    sides = np.concatenate([own, other], axis=1)
    parted = (own[:, 0] * own[:, 1] < 0) & (other[:, 0] * other[:, 1] < 0)
    crossed = parted & (np.abs(sides).min(axis=1) >= least_px)
    return np.stack([first[crossed], second[crossed]], axis=1)


def _faults(drawn: LipContours, size: tuple[int, int]) -> list[str]:
    lines = []
    for name, ring in (("outer", drawn.outer), ("inner", drawn.inner)):
        outside = ((ring < 0) | (ring > np.array(size) - 1)).any(axis=1)
        if outside.any():
            lines.append(f"{int(outside.sum())} of {len(ring)} points of the {name} contour lie outside the picture")
        pairs = crossings(ring)
        if len(pairs):
            lines.append(f"the {name} contour crosses itself between points {pairs[0][0] + 1} and {pairs[0][1] + 1}")
    far = _outside_by(drawn.inner, drawn.outer)
    if far > _OVER_PX:
        lines.append(f"the inner contour leaves the outer one by {far:.0f} pixels")
    return lines


def _offsets(start: NDArray, end: NDArray, *points: NDArray) -> NDArray[np.float64]:
    """(p, q) signed distances of points (p, 2) from lines through start and end (p, 2)."""
    along = end - start
    unit = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    offsets = [unit[:, 0] * (point - start)[:, 1] - unit[:, 1] * (point - start)[:, 0] for point in points]
    return np.stack(offsets, axis=1)


def _outside_by(points: NDArray, ring: NDArray) -> float:
    """How far the outermost of points (p, 2) lies outside a ring (k, 2), pixels; negative where all are inside."""
    polygon = np.ascontiguousarray(ring, np.float32)
    return -min(cv2.pointPolygonTest(polygon, (float(x), float(y)), True) for x, y in points)
