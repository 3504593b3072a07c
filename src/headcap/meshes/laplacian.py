"""Laplacians of triangle meshes and a sparse Cholesky factor to solve with many times.

All Laplacians here are positive semidefinite (row sums zero, diagonal positive); the bilaplacian is L^T M^-1 L.
"""

import numpy as np
from cholespy import CholeskySolverD, MatrixType
from numpy.typing import NDArray
from scipy import sparse

from headcap.meshes.normals import triangle_normals
from headcap.meshes.topology import vertex_adjacency


def uniform_laplacian(triangles: NDArray, n_vertices: int) -> sparse.csr_array:
    """Graph Laplacian (n, n): degree minus adjacency, blind to edge lengths."""
    adjacency = vertex_adjacency(triangles, n_vertices)
    return sparse.csr_array(sparse.diags_array(adjacency.sum(axis=1)) - adjacency)


def cotangent_laplacian(vertices: NDArray, triangles: NDArray, *, least_weight: float | None = None) -> sparse.csr_array:
    """Cotangent Laplacian (n, n) of vertices (n, 3), unit-free (Pinkall & Polthier 1993).

    `least_weight` clamps edge weights from below (0 keeps the matrix an M-matrix where triangles are obtuse).
    """
    pairs, weights = _half_cotangents(vertices, triangles)
    n = len(vertices)
    off_diagonal = sparse.csr_array((weights, (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    off_diagonal = off_diagonal + off_diagonal.T
    if least_weight is not None:
        off_diagonal.data = np.maximum(off_diagonal.data, least_weight)
    return sparse.csr_array(sparse.diags_array(off_diagonal.sum(axis=1)) - off_diagonal)


def vertex_areas(vertices: NDArray, triangles: NDArray) -> NDArray[np.float64]:
    """(n,) a third of the area of the triangles at each vertex, square metres."""
    area = np.linalg.norm(triangle_normals(vertices, triangles), axis=1) / 6.0
    return np.bincount(triangles.ravel(), np.repeat(area, 3), len(vertices))


def bilaplacian(laplacian: sparse.csr_array, areas: NDArray | None = None) -> sparse.csr_array:
    """L^T M^-1 L (n, n): thin-plate energy; without areas M is the identity."""
    if areas is None:
        return sparse.csr_array(laplacian.T @ laplacian)
    inverse = sparse.diags_array(1.0 / np.maximum(areas, 1e-12 * max(areas.max(), 1e-30)))
    return sparse.csr_array(laplacian.T @ inverse @ laplacian)


class Factor:
    """Cholesky factor of a sparse symmetric positive definite (n, n) matrix, for many right-hand sides."""

    def __init__(self, matrix: sparse.sparray) -> None:
        coo = sparse.coo_array(matrix)
        if coo.shape[0] != coo.shape[1] or not np.isfinite(coo.data).all():
            raise ValueError(f"a factor needs a square finite matrix, got {coo.shape}")
        rows, columns = (np.ascontiguousarray(axis, np.int32) for axis in coo.coords)
        self._solver = CholeskySolverD(coo.shape[0], rows, columns, np.ascontiguousarray(coo.data, float), MatrixType.COO)

    def solve(self, right: NDArray) -> NDArray[np.float64]:
        """Solve for right-hand sides (n,) or (n, k)."""
        right = np.ascontiguousarray(right, np.float64)
        out = np.zeros_like(right)
        self._solver.solve(right, out)
        return out


def _half_cotangents(vertices: NDArray, triangles: NDArray) -> tuple[NDArray, NDArray]:
    corners = vertices[triangles]
    twice_area = np.maximum(np.linalg.norm(triangle_normals(vertices, triangles), axis=1), 1e-20)
    pairs, weights = [], []
    for corner in range(3):
        i, j = (corner + 1) % 3, (corner + 2) % 3
        to_i, to_j = corners[:, i] - corners[:, corner], corners[:, j] - corners[:, corner]
        pairs.append(triangles[:, [i, j]])
        weights.append(0.5 * np.einsum("nk,nk->n", to_i, to_j) / twice_area)
    return np.concatenate(pairs), np.concatenate(weights)
