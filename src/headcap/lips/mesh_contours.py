"""Lip contours that a camera would see of a known mesh: the outer border as it lies, the inner one where lips end for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.lips.features import LipContours
from headcap.lips.mouth import Mouth
from headcap.meshes.topology import mesh_edges

_STATIONS = 41
"""Places across the mouth at which the rims of its opening are told."""


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
        used = np.unique(np.concatenate([self.outline, self.upper.ravel(), self.lower.ravel()]))
        pixels, depth = np.zeros((len(mesh), 2)), np.zeros(len(mesh))
        pixels[used], depth[used] = camera.project(mesh[used])
        right, left = pixels[self.corners]
        along = (left - right) / np.linalg.norm(left - right)
        # down in the picture for a head that is upright in it
        down = np.array([-along[1], along[0]]) * np.sign(along[0] or 1.0)
        flat = np.stack([(pixels - right) @ along, (pixels - right) @ down], axis=1)
        stations = np.linspace(0.0, np.linalg.norm(left - right), _STATIONS)[1:-1]
        upper, upper_depth = _rim(flat, depth, self.upper, stations, 1.0)
        lower, lower_depth = _rim(flat, depth, self.lower, stations, -1.0)
        known = np.isfinite(upper) & np.isfinite(lower)
        front = np.where(upper_depth < lower_depth, upper, lower)
        over = upper > lower
        upper, lower = np.where(over, front, upper)[known], np.where(over, front, lower)[known]
        across = right + stations[known, None] * along
        ring = [right[None], across + upper[:, None] * down, left[None], (across + lower[:, None] * down)[::-1]]
        return LipContours(pixels[self.outline], np.concatenate(ring))


def _rim(flat: NDArray, depth: NDArray, edges: NDArray, stations: NDArray, sign: float) -> tuple[NDArray, NDArray]:
    """Extreme height and its depth (s,) of edges (e, 2) over stations (s,); NaN where none passes."""
    start, end = flat[edges[:, 0]], flat[edges[:, 1]]
    run = end[:, :1] - start[:, :1]
    share = (stations - start[:, :1]) / np.where(run == 0, np.inf, run)
    height = start[:, 1:] + share * (end[:, 1:] - start[:, 1:])
    passes = (share >= 0) & (share <= 1) & (run != 0)
    best = np.where(passes, sign * height, -np.inf).argmax(axis=0)
    at = np.arange(len(stations))
    known = passes[best, at]
    deep = depth[edges[best, 0]] + share[best, at] * (depth[edges[best, 1]] - depth[edges[best, 0]])
    return np.where(known, height[best, at], np.nan), np.where(known, deep, np.nan)
