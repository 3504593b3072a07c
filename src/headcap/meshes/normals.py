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
    _normalise(sums)
    return sums


@njit(cache=True)
def _normals(vertices, triangles, normals):
    for f in range(len(triangles)):
        a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        normals[f, 0], normals[f, 1], normals[f, 2] = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@njit(cache=True)
def _sum_normals(vertices, triangles, sums):
    for f in range(len(triangles)):
        a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for corner in (a, b, c):
            sums[corner, 0] += nx
            sums[corner, 1] += ny
            sums[corner, 2] += nz


@njit(cache=True)
def _normalise(sums):
    for v in range(len(sums)):
        length = np.sqrt(sums[v, 0] * sums[v, 0] + sums[v, 1] * sums[v, 1] + sums[v, 2] * sums[v, 2])
        if length > 0:
            for axis in range(3):
                sums[v, axis] /= length
