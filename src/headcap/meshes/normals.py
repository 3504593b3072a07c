"""Normals of triangle meshes."""

import numpy as np
from numba import njit
from numpy.typing import NDArray


def triangle_normals(vertices: NDArray, triangles: NDArray) -> NDArray:
    """Area-weighted normals (n_triangles, 3): half the cross product of the edges is left unscaled."""
    normals = np.empty((len(triangles), 3))
    _normals(np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(triangles, np.int32), normals)
    return normals


def vertex_normals(vertices: NDArray, triangles: NDArray) -> NDArray[np.float64]:
    """Unit vertex normals (n, 3), area-weighted; zero where a vertex has no triangle."""
    sums = np.zeros((len(vertices), 3))
    _sum_normals(np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(triangles, np.int32), sums)
    length = np.sqrt((sums**2).sum(1, keepdims=True))
    return sums / np.where(length > 0, length, 1.0)


@njit(cache=True)
def _normals(vertices, triangles, normals):
    for f in range(len(triangles)):
        a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        normals[f, 0], normals[f, 1], normals[f, 2] = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@njit(cache=True)
def _sum_normals(vertices, triangles, sums):
    for a, b, c in triangles:
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for corner in (a, b, c):
            sums[corner, 0] += nx
            sums[corner, 1] += ny
            sums[corner, 2] += nz
