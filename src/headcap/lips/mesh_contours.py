"""Lip contours that a camera would see of a known mesh: the outer border as it lies, the inner one where lips end for it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.lips.features import LipContours
from headcap.lips.mouth import Mouth
from headcap.meshes.topology import mesh_edges

_STATIONS = 41
"""Places across the mouth at which the rims of its opening are told."""


@dataclass(frozen=True, eq=False)
class Rim:
    """Where a lip ends for a viewer, at stations across the mouth."""

    edges: NDArray[np.int64]
    """(s, 2) vertices of the edge that is the rim there."""
    share: NDArray[np.float64]
    """(s,) how far along."""
    height: NDArray[np.float64]
    """(s,) pixels down from the line between the corners; NaN where the lip has nothing."""
    depth: NDArray[np.float64]
    """(s,) metres from the camera."""


@dataclass(frozen=True, eq=False)
class Opening:
    """The mouth's opening as a camera sees it, between the rims of the two lips."""

    right: NDArray[np.float64]
    """(2,) pixel of the right corner."""
    left: NDArray[np.float64]
    along: NDArray[np.float64]
    """(2,) unit, from the right to the left corner."""
    down: NDArray[np.float64]
    """(2,) unit, down in the picture for a head that is upright in it."""
    stations: NDArray[np.float64]
    """(s,) pixels from the right corner."""
    upper: Rim
    lower: Rim

    @property
    def overlap(self) -> NDArray[np.bool_]:
        """(s,) where the lip in front hides the other's rim."""
        return self.upper.height > self.lower.height

    @property
    def upper_in_front(self) -> NDArray[np.bool_]:
        """(s,)"""
        return self.upper.depth < self.lower.depth

    def ring(self) -> NDArray[np.float64]:
        """(j, 2) pixels from the right corner along the upper rim to the left one and back along the lower."""
        known = np.isfinite(self.upper.height) & np.isfinite(self.lower.height)
        front = np.where(self.upper_in_front, self.upper.height, self.lower.height)
        upper, lower = (np.where(self.overlap, front, rim.height)[known] for rim in (self.upper, self.lower))
        across = self.right + self.stations[known, None] * self.along
        parts = [self.right[None], across + upper[:, None] * self.down, self.left[None], across + lower[:, None] * self.down]
        return np.concatenate([*parts[:3], parts[3][::-1]])


@dataclass(frozen=True, eq=False)
class MeshContours:
    """The lips of a topology as edges."""

    outline: NDArray[np.int64]
    upper: NDArray[np.int64]
    """(e, 2) edges of the upper lip, inside and out."""
    lower: NDArray[np.int64]
    corners: NDArray[np.int64]
    """(2,) where upper and lower lip are one, right and left."""

    @classmethod
    def of(cls, vertices: NDArray, mouth: Mouth, regions: dict[str, NDArray]) -> MeshContours:
        """Of a neutral head (n, 3) with regions lips_upper, lips_lower, lips_inner_upper, lips_inner_lower."""
        edges = []
        for side in ("upper", "lower"):
            lip = regions[f"lips_{side}"] | regions[f"lips_inner_{side}"]
            edges.append(mesh_edges(mouth.triangles[lip[mouth.triangles].all(axis=1)]).vertices.astype(np.int64))
        both = np.intersect1d(*edges)
        corners = both[[vertices[both, 0].argmin(), vertices[both, 0].argmax()]]
        return cls(mouth.outline, edges[0], edges[1], corners)

    def __call__(self, mesh: NDArray, camera: Camera) -> LipContours:
        """Of a mesh (n, 3), metres, in the camera's world.

        The mouth's opening lies between the lowest of the upper lip and the highest of the lower lip in the picture, across the
        line between the corners; where they overlap the lip in front hides the other and the opening is its rim.
        """
        pixels, depth = np.zeros((len(mesh), 2)), np.zeros(len(mesh))
        pixels[self.vertices], depth[self.vertices] = camera.project(mesh[self.vertices])
        return LipContours(pixels[self.outline], self.opening(pixels, depth).ring())

    @cached_property
    def vertices(self) -> NDArray[np.int64]:
        """(u,) all that contours are told by."""
        return np.unique(np.concatenate([self.outline, self.upper.ravel(), self.lower.ravel(), self.corners]))

    def compact(self) -> MeshContours:
        """The same of a mesh that has the `vertices` alone, in their order."""
        parts = (self.outline, self.upper, self.lower, self.corners)
        return MeshContours(*(np.searchsorted(self.vertices, part) for part in parts))

    def opening(self, pixels: NDArray, depth: NDArray) -> Opening:
        """From the vertices' pixels (n, 2) and depths (n,)."""
        right, left = pixels[self.corners]
        along = (left - right) / np.linalg.norm(left - right)
        # down in the picture for a head that is upright in it
        down = np.array([-along[1], along[0]]) * np.sign(along[0] or 1.0)
        flat = np.stack([(pixels - right) @ along, (pixels - right) @ down], axis=1)
        stations = np.linspace(0.0, np.linalg.norm(left - right), _STATIONS)[1:-1]
        rims = (_rim(flat, depth, edges, stations, sign) for edges, sign in ((self.upper, 1.0), (self.lower, -1.0)))
        return Opening(right, left, along, down, stations, *rims)


def _rim(flat: NDArray, depth: NDArray, edges: NDArray, stations: NDArray, sign: float) -> Rim:
    """The lowest (sign 1) or highest (-1) of edges (e, 2) over each station."""
    start, end = flat[edges[:, 0]], flat[edges[:, 1]]
    run = end[:, :1] - start[:, :1]
    share = (stations - start[:, :1]) / np.where(run == 0, np.inf, run)
    height = start[:, 1:] + share * (end[:, 1:] - start[:, 1:])
    passes = (share >= 0) & (share <= 1) & (run != 0)
    best = np.where(passes, sign * height, -np.inf).argmax(axis=0)
    at = np.arange(len(stations))
    known = passes[best, at]
    deep = depth[edges[best, 0]] + share[best, at] * (depth[edges[best, 1]] - depth[edges[best, 0]])
    return Rim(edges[best], share[best, at], np.where(known, height[best, at], np.nan), np.where(known, deep, np.nan))
