"""Cross-sections of the lips at places that stay with the skin: how far the lips are apart, and how far they are rolled.

The lip paper shows rolling (figures 9, 11, 13) and measures none of it; what is defined here tells it in degrees.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.lips.mouth import Mouth
from headcap.meshes.topology import mesh_edges

_STATIONS = np.linspace(0.3, 0.7, 9)
"""Places between the right (0) and the left corner (1): towards the corners the lips are one, and a roll has no meaning."""


@dataclass(frozen=True, eq=False)
class MaterialPoints:
    """Points on edges of a topology, which move with its skin."""

    edges: NDArray[np.int64]
    """(s, 2) vertices."""
    share: NDArray[np.float64]
    """(s,) how far along."""

    def of(self, mesh: NDArray) -> NDArray[np.float64]:
        """(s, 3) on a mesh (n, 3)."""
        start, end = mesh[self.edges[:, 0]], mesh[self.edges[:, 1]]
        return start + self.share[:, None] * (end - start)


@dataclass(frozen=True, eq=False)
class LipSections:
    """Cross-sections (s,) of a topology's lips, told at rest and tied to the skin from then on.

    Of each lip a section knows its border to the skin and its rim, which is where the lips meet at rest (where they are apart
    then, the lowest of the upper and the highest of the lower lip). Meshes are canonical: y up, z out of the face.
    """

    upper_border: MaterialPoints
    upper_rim: MaterialPoints
    lower_rim: MaterialPoints
    lower_border: MaterialPoints

    @classmethod
    def of(cls, neutral: NDArray, mouth: Mouth, regions: dict[str, NDArray]) -> LipSections:
        """Of a neutral head (n, 3) with regions lips_upper and lips_lower, and lips_inner_* where lips are rolled in.

        Raises `InputError` for a head whose lips a section misses.
        """
        neutral = np.asarray(neutral, np.float64)
        corners = neutral[mouth.outline[[0, mouth.left]], 0]
        stations = corners[0] + _STATIONS * (corners[1] - corners[0])
        ring = np.stack([mouth.outline, np.roll(mouth.outline, -1)], axis=1)
        upper, lower = (_edges(mouth, regions, side) for side in ("upper", "lower"))
        return cls(
            _extreme(neutral, ring[: mouth.left], stations, 1.0),
            _extreme(neutral, upper, stations, -1.0),
            _extreme(neutral, lower, stations, 1.0),
            _extreme(neutral, ring[mouth.left :], stations, -1.0),
        )

    def gap(self, mesh: NDArray) -> NDArray[np.float64]:
        """(s,) distances between the two rims, in the mesh's unit."""
        return np.linalg.norm(self.upper_rim.of(mesh) - self.lower_rim.of(mesh), axis=1)

    def roll(self, mesh: NDArray) -> NDArray[np.float64]:
        """(2, s) radians of upper and lower lip: how far each is rolled out; negative: rolled in.

        The angle, seen along the line between the corners (x), of the way from a lip's border to its rim, against straight down
        (upper lip) and straight up (lower lip); it grows as the rim comes forward of the border.
        """
        upper, lower = (
            rim.of(mesh) - border.of(mesh)
            for border, rim in ((self.upper_border, self.upper_rim), (self.lower_border, self.lower_rim))
        )
        return np.stack([np.arctan2(upper[:, 2], -upper[:, 1]), np.arctan2(lower[:, 2], lower[:, 1])])


def _edges(mouth: Mouth, regions: dict[str, NDArray], side: str) -> NDArray[np.int64]:
    lip = regions[f"lips_{side}"] | regions.get(f"lips_inner_{side}", False)
    return mesh_edges(mouth.triangles[lip[mouth.triangles].all(axis=1)]).vertices.astype(np.int64)


def _extreme(neutral: NDArray, edges: NDArray, stations: NDArray, sign: float) -> MaterialPoints:
    """The highest (sign 1) or lowest (-1) crossing of edges (e, 2) with each plane x = station."""
    start, end = neutral[edges[:, 0]], neutral[edges[:, 1]]
    run = (end[:, 0] - start[:, 0])[:, None]
    share = (stations - start[:, :1]) / np.where(run == 0, np.inf, run)
    crosses = (share >= 0) & (share <= 1) & (run != 0)
    if not crosses.any(axis=0).all():
        raise InputError(
            f"{int((~crosses.any(axis=0)).sum())} cross-sections of the mouth without a lip",
            expected="lips that reach from corner to corner",
            remedy="Check the regions lips_upper and lips_lower of the head, and its axes (y up, z out of the face).",
        )
    height = start[:, 1:2] + share * (end - start)[:, 1:2]
    best = np.where(crosses, sign * height, -np.inf).argmax(axis=0)
    return MaterialPoints(edges[best], share[best, np.arange(len(stations))])
