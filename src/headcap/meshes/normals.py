"""Normals of triangle meshes."""

import numpy as np
from numpy.typing import NDArray


def triangle_normals(vertices: NDArray, triangles: NDArray) -> NDArray:
    """Area-weighted normals (n_triangles, 3): half the cross product of the edges is left unscaled."""
    corners = vertices[triangles]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def vertex_normals(vertices: NDArray, triangles: NDArray) -> NDArray:
    """Unit vertex normals (n, 3), area-weighted; zero where a vertex has no triangle."""
    weighted = triangle_normals(vertices, triangles)
    sums = np.stack([np.bincount(triangles.ravel(), np.repeat(weighted[:, axis], 3), len(vertices)) for axis in range(3)], axis=1)
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    return sums / np.where(length > 0, length, 1.0)
