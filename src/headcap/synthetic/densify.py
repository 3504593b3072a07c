"""A denser mesh of the same surface: Loop's subdivision as a matrix that also carries weights along."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from headcap.meshes.topology import mesh_edges


def subdivide(triangles: NDArray, n_vertices: int) -> tuple[sparse.csr_array, NDArray[np.int32]]:
    """Loop's rule (Loop 1987; boundaries as cubic splines): operator (fine, coarse) and triangles (4 m, 3).

    The coarse vertices come first, so coarse triangles remain valid on the fine mesh.
    """
    edges = mesh_edges(triangles)
    e, inner = len(edges.vertices), ~edges.boundary
    rows, columns, values = [], [], []
    middle = n_vertices + np.arange(e)
    near = np.where(inner, 3 / 8, 1 / 2)
    for end in range(2):
        rows.append(middle), columns.append(edges.vertices[:, end]), values.append(near)
    opposite = _opposite(edges.vertices, edges.triangles, triangles)
    for side in range(2):
        rows.append(middle[inner]), columns.append(opposite[inner, side]), values.append(np.full(inner.sum(), 1 / 8))
    old = _old_vertices(edges.vertices, edges.boundary, n_vertices)
    moved = sparse.coo_array(old)
    rows.append(moved.coords[0]), columns.append(moved.coords[1]), values.append(moved.data)
    indices = (np.concatenate(rows), np.concatenate(columns))
    operator = sparse.csr_array((np.concatenate(values), indices), shape=(n_vertices + e, n_vertices))
    return operator, _split(triangles, edges.vertices, n_vertices)


def _old_vertices(pairs: NDArray, boundary: NDArray, n: int) -> sparse.csr_array:
    both = np.concatenate([pairs, pairs[:, ::-1]])
    on_boundary = np.concatenate([boundary, boundary])
    rim = np.zeros(n, bool)
    rim[pairs[boundary].ravel()] = True
    keep = np.where(rim[both[:, 0]], on_boundary, True)
    both = both[keep]
    valence = np.bincount(both[:, 0], minlength=n)
    safe = np.maximum(valence, 1)
    beta = np.where(rim, 1 / 8, (5 / 8 - (3 / 8 + np.cos(2 * np.pi / safe) / 4) ** 2) / safe)
    ring = sparse.csr_array((beta[both[:, 0]], (both[:, 0], both[:, 1])), shape=(n, n))
    return sparse.csr_array(ring + sparse.diags_array(1 - valence * beta))


def _opposite(pairs: NDArray, sides: NDArray, triangles: NDArray) -> NDArray[np.int64]:
    corners = triangles[np.maximum(sides, 0)].astype(np.int64)
    return corners.sum(2) - pairs.sum(1, dtype=np.int64)[:, None]


def _split(triangles: NDArray, pairs: NDArray, n: int) -> NDArray[np.int32]:
    key = pairs[:, 0].astype(np.int64) * n + pairs[:, 1]
    a, b, c = triangles.astype(np.int64).T

    def between(i: NDArray, j: NDArray) -> NDArray:
        """The vertices (m,) put in the middle of edges i-j."""
        return n + np.searchsorted(key, np.minimum(i, j) * n + np.maximum(i, j))

    ab, bc, ca = between(a, b), between(b, c), between(c, a)
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([np.stack(part, axis=1) for part in parts]).astype(np.int32)
