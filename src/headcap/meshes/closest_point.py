"""Nearest points on a triangle mesh, through a tree built once."""

from dataclasses import dataclass

import igl
import numpy as np
from numpy.typing import NDArray

from headcap.meshes.normals import triangle_normals


@dataclass(frozen=True)
class Closest:
    """For each query point its nearest point on a surface."""

    points: NDArray[np.float64]
    """(q, 3) nearest points."""
    triangle: NDArray[np.int64]
    """(q,) the triangle each lies in."""
    barycentric: NDArray[np.float64]
    """(q, 3) its weights of that triangle's corners."""
    distance: NDArray[np.float64]
    """(q,) metres, unsigned."""

    def interpolate(self, triangles: NDArray, values: NDArray) -> NDArray:
        """Vertex values (n, k) at the nearest points (q, k)."""
        return np.einsum("qc,qck->qk", self.barycentric, values[triangles[self.triangle]])


class Surface:
    """A triangle mesh (n, 3), (m, 3) that answers nearest-point queries in O(log m)."""

    def __init__(self, vertices: NDArray, triangles: NDArray) -> None:
        self.vertices = np.ascontiguousarray(vertices, np.float64)
        self.triangles = np.ascontiguousarray(triangles, np.int64)
        self._tree = igl.AABB()
        self._tree.init(self.vertices, self.triangles)

    def closest(self, points: NDArray) -> Closest:
        """Nearest surface points of queries (q, 3)."""
        points = np.ascontiguousarray(points, np.float64)
        squared, triangle, nearest = self._tree.squared_distance(self.vertices, self.triangles, points)
        triangle = np.atleast_1d(triangle)
        nearest = nearest.reshape(-1, 3)
        weights = barycentric_weights(self.vertices[self.triangles[triangle]], nearest)
        return Closest(nearest, triangle, weights, np.sqrt(np.atleast_1d(squared)))

    def signed_distance(self, points: NDArray, normals: NDArray) -> NDArray[np.float64]:
        """(q,) distance to the nearest point, positive on the side the vertex normals (n, 3) point to."""
        found = self.closest(points)
        side = np.einsum("qk,qk->q", points - found.points, found.interpolate(self.triangles, normals))
        return np.copysign(found.distance, side)


def barycentric_weights(corners: NDArray, points: NDArray) -> NDArray[np.float64]:
    """Weights (q, 3) of points (q, 3) in triangles with corners (q, 3, 3), clipped to the triangle."""
    normal = triangle_normals(corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3))
    squared = np.maximum(np.einsum("qk,qk->q", normal, normal), 1e-40)
    weights = np.empty((len(points), 3))
    for corner in range(3):
        i, j = (corner + 1) % 3, (corner + 2) % 3
        part = np.cross(corners[:, i] - points, corners[:, j] - points)
        weights[:, corner] = np.einsum("qk,qk->q", part, normal) / squared
    weights = np.clip(weights, 0.0, None)
    return weights / np.maximum(weights.sum(1, keepdims=True), 1e-20)
