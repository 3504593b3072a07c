"""Modified butterfly subdivision of a part of a mesh, as a sparse operator that carries every per-vertex quantity along.

The scheme interpolates: old vertices stay and come first, each split edge gets a vertex. Rules (Zorin, Schroeder & Sweldens 1996,
"Interpolating subdivision for meshes with arbitrary topology", SIGGRAPH 96; boundaries as in Zorin & Schroeder 2000, "Subdivision
for modeling and animation", SIGGRAPH course):

- between regular vertices the eight-point butterfly (w = 0): 1/2, 1/8, -1/16;
- at an interior vertex of valence K != 6 its own ring, s_j = (1/4 + cos(2 pi j / K) + cos(4 pi j / K) / 2) / K for K >= 5,
  (5/12, -1/12, -1/12) for 3, (3/8, 0, -1/8, 0) for 4, and 3/4 for itself; the mean of both where both ends are irregular;
- on a boundary edge the four-point curve -1/16, 9/16, 9/16, -1/16;
- at a boundary vertex of k != 3 triangles the trigonometric rule of `_boundary_fan`;
- where the butterfly of a regular boundary vertex (k = 3) reaches beyond the boundary, the missing vertex is the one that
  completes the parallelogram, which keeps the rule exact on linear functions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from headcap.errors import InputError
from headcap.meshes.topology import Edges, mesh_edges, non_manifold_edges, non_manifold_vertices


@dataclass(frozen=True)
class Subdivision:
    """One step of subdivision of a mesh with n vertices and m triangles; s edges are split."""

    operator: sparse.csr_array
    """S (n + s, n): fine = S @ coarse; rows sum to one, the first n are the identity."""
    triangles: NDArray[np.int32]
    """(m', 3) of the fine mesh, turned as the coarse ones."""
    parents: NDArray[np.int32]
    """(m',) the coarse triangle each came from."""
    split_edges: NDArray[np.int32]
    """(s, 2) ends of the split edges, in the order of the new vertices."""

    def carry(self, values: NDArray) -> NDArray:
        """Positions, displacements or any other smooth quantity (n, ...) on the fine mesh (n + s, ...)."""
        values = np.asarray(values)
        flat = self.operator @ values.reshape(len(values), -1)
        return flat.reshape((-1, *values.shape[1:])).astype(values.dtype, copy=False)

    def carry_basis(self, basis: NDArray) -> NDArray:
        """Blendshapes (b, n, 3) on the fine mesh (b, n + s, 3): S applied to each, so basis and mesh stay in step."""
        if len(basis) == 0:
            return np.zeros((0, self.operator.shape[0], 3), basis.dtype)
        return np.ascontiguousarray(self.carry(basis.transpose(1, 0, 2)).transpose(1, 0, 2))

    def carry_weights(self, weights: NDArray) -> NDArray:
        """Blend weights (n, k), convex in each row, on the fine mesh: S overshoots a little, so it is clipped and rescaled."""
        fine = np.clip(self.carry(weights), 0.0, None)
        return fine / fine.sum(axis=1, keepdims=True)

    def carry_mask(self, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """A vertex mask (n,) on the fine mesh: a new vertex belongs where both ends of its edge do."""
        return np.concatenate([mask, mask[self.split_edges].all(axis=1)])

    def carry_regressor(self, regressor: NDArray) -> NDArray:
        """A linear map from vertices (k, n) on the fine mesh: old vertices are kept, so it gets zeros for the new ones."""
        return np.concatenate([regressor, np.zeros((len(regressor), len(self.split_edges)), regressor.dtype)], axis=1)

    def carry_corners(self, coarse_triangles: NDArray, uv: NDArray, uv_triangles: NDArray) -> tuple[NDArray, NDArray]:
        """Texture coordinates (k, 2) with corners (m, 3) on the fine mesh, split in the middle; seams stay seams.

        Linear, so that a texture painted for the coarse mesh shows at the same places of its triangles.
        """
        n = self.operator.shape[1]
        return _split_corners(self, coarse_triangles, n, np.asarray(uv, np.float64), uv_triangles)


def subdivide_butterfly(triangles: NDArray, n_vertices: int, chosen: NDArray[np.bool_] | None = None) -> Subdivision:
    """Split the chosen triangles (m,) of a mesh (m, 3) in four (all by default), by the modified butterfly rules of this module.

    Neighbours that share one or two split edges are cut in two or three, so there is no crack at the border of the chosen part.
    Raises `InputError` where the mesh is not manifold.
    """
    triangles = np.ascontiguousarray(triangles, np.int32)
    _require_manifold(triangles, n_vertices)
    edges = mesh_edges(triangles)
    chosen = np.ones(len(triangles), bool) if chosen is None else np.asarray(chosen, bool)
    touched = chosen[edges.triangles] & (edges.triangles >= 0)
    split = touched.any(axis=1)
    pairs = edges.vertices[split]
    start, ring, closed = ordered_rings(triangles, n_vertices)
    rows, columns, values = _stencils(pairs, edges.boundary[split], start, ring, closed)
    rows, columns = np.concatenate([np.arange(n_vertices), rows + n_vertices]), np.concatenate([np.arange(n_vertices), columns])
    values = np.concatenate([np.ones(n_vertices), values])
    operator = sparse.csr_array((values, (rows, columns)), shape=(n_vertices + len(pairs), n_vertices))
    operator.sum_duplicates()
    fine, parents = _cut(triangles, _middles(triangles, edges, split, n_vertices))
    return Subdivision(operator, fine, parents, pairs)


def ordered_rings(triangles: NDArray, n_vertices: int) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.bool_]]:
    """Neighbours of every vertex in counter-clockwise order: `ring[start[v]:start[v + 1]]`; `closed` (n,) is false on boundaries.

    A boundary vertex's ring runs from boundary to boundary. The mesh must be manifold.
    """
    triangles = np.ascontiguousarray(triangles, np.int32)
    fans = np.bincount(triangles.ravel(), minlength=n_vertices)
    edges = mesh_edges(triangles)
    closed = np.ones(n_vertices, bool)
    closed[edges.vertices[edges.boundary].ravel()] = False
    start = np.concatenate([[0], np.cumsum(fans + (~closed & (fans > 0)))])
    ring = np.full(start[-1], -1, np.int32)
    _fill_rings(triangles, start, closed, np.concatenate([[0], np.cumsum(fans)]), ring)
    return start, ring, closed


def _require_manifold(triangles: NDArray, n_vertices: int) -> None:
    edges, vertices = len(non_manifold_edges(triangles)), len(non_manifold_vertices(triangles, n_vertices))
    if edges or vertices:
        raise InputError(
            f"the mesh has {edges} non-manifold edges and {vertices} non-manifold vertices",
            expected="an oriented manifold to subdivide",
            remedy="Repair the mesh: each edge may belong to two triangles at most, each vertex to one fan.",
        )


def _middles(triangles: NDArray, edges: Edges, split: NDArray, n_vertices: int) -> NDArray[np.int64]:
    """(m, 3) the new vertex on each triangle's edges 01, 12, 20, or -1."""
    number = np.where(split, n_vertices + np.cumsum(split) - 1, -1)
    keys = edges.vertices[:, 0].astype(np.int64) * n_vertices + edges.vertices[:, 1]
    ahead = np.roll(triangles, -1, axis=1).astype(np.int64)
    wanted = np.minimum(triangles, ahead) * n_vertices + np.maximum(triangles, ahead)
    return number[np.searchsorted(keys, wanted)]


def _cut(triangles: NDArray, middles: NDArray) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Fine triangles and the coarse triangle of each, in the order of the coarse ones."""
    count = (middles >= 0).sum(axis=1)
    pieces, parents = [triangles[count == 0]], [np.flatnonzero(count == 0)]
    for splits, first in ((1, middles >= 0), (2, middles < 0), (3, middles >= 0)):
        which = np.flatnonzero(count == splits)
        turn = (first[which].argmax(axis=1)[:, None] + np.arange(3)) % 3
        a, b, c = np.take_along_axis(triangles[which], turn, axis=1).T
        x, y, z = np.take_along_axis(middles[which], turn, axis=1).T  # on ab, bc, ca
        parts = {
            1: [(a, x, c), (x, b, c)],
            2: [(y, c, z), (a, b, y), (a, y, z)],
            3: [(a, x, z), (x, b, y), (z, y, c), (x, y, z)],
        }[splits]
        pieces += [np.stack(part, axis=1) for part in parts]
        parents += [which] * len(parts)
    parent = np.concatenate(parents)
    order = np.argsort(parent, kind="stable")
    return np.concatenate(pieces)[order].astype(np.int32), parent[order].astype(np.int32)


def _split_corners(step: Subdivision, triangles: NDArray, n: int, uv: NDArray, uv_triangles: NDArray) -> tuple[NDArray, NDArray]:
    edges = mesh_edges(triangles)
    keys = edges.vertices[:, 0].astype(np.int64) * n + edges.vertices[:, 1]
    split = np.isin(keys, step.split_edges[:, 0].astype(np.int64) * n + step.split_edges[:, 1])
    middles = _middles(triangles, edges, split, n)
    # one texture point per pair of texture points: two at a seam, where the pairs differ
    ahead = np.roll(uv_triangles, -1, axis=1).astype(np.int64)
    pairs = np.sort(np.stack([uv_triangles, ahead], axis=2), axis=2)[middles >= 0]
    found, number = np.unique(pairs[:, 0].astype(np.int64) * len(uv) + pairs[:, 1], return_inverse=True)
    uv_middles = np.full(middles.shape, -1)
    uv_middles[middles >= 0] = len(uv) + number.ravel()
    ends = np.stack([found // len(uv), found % len(uv)], axis=1)
    return np.concatenate([uv, uv[ends].mean(axis=1)]), _cut(uv_triangles, uv_middles)[0]


@njit(cache=True)
def _fill_rings(triangles, start, closed, fan_start, ring):
    n = len(start) - 1
    first = np.empty(len(triangles) * 3, np.int32)
    second = np.empty(len(triangles) * 3, np.int32)
    filled = np.zeros(n, np.int64)
    for f in range(len(triangles)):
        for corner in range(3):
            v = triangles[f, corner]
            at = fan_start[v] + filled[v]
            first[at], second[at] = triangles[f, (corner + 1) % 3], triangles[f, (corner + 2) % 3]
            filled[v] += 1
    for v in range(n):
        low, high = fan_start[v], fan_start[v + 1]
        if low == high:
            continue
        current = first[low]
        if not closed[v]:
            for k in range(low, high):  # the neighbour that no triangle of the fan leads to
                led_to = False
                for j in range(low, high):
                    led_to = led_to or second[j] == first[k]
                if not led_to:
                    current = first[k]
        at = start[v]
        ring[at] = current
        for _ in range(start[v + 1] - start[v] - 1):
            for k in range(low, high):
                if first[k] == current:
                    current = second[k]
                    break
            at += 1
            ring[at] = current


@njit(cache=True)
def _irregular_weight(valence, j):
    """Weight s_j of the j-th neighbour counted from the split edge, at an interior vertex (Zorin et al. 1996, section 3)."""
    if valence == 3:
        return 5.0 / 12.0 if j == 0 else -1.0 / 12.0
    if valence == 4:
        return 3.0 / 8.0 if j == 0 else (-1.0 / 8.0 if j == 2 else 0.0)
    angle = 2.0 * np.pi * j / valence
    return (0.25 + np.cos(angle) + 0.5 * np.cos(2.0 * angle)) / valence


@njit(cache=True)
def _boundary_fan(k, i, weights):
    """Weights of a boundary vertex [0] and its k + 1 neighbours [1:], for the edge to neighbour i, 0 < i < k.

    With t = pi / k: c_j = (sin it sin jt + sin 2it sin 2jt / 2) / k inside the fan,
    c_0 = -c_k = cos(it) / 4 - sin 2t sin 2it / (4 k (cos t - cos 2t)) on its boundary,
    and 1 - sin t sin it / (k (1 - cos t)) for the vertex itself.
    """
    t = np.pi / k
    weights[0] = 1.0 - np.sin(t) * np.sin(i * t) / (k * (1.0 - np.cos(t)))
    rim = 0.25 * np.cos(i * t) - np.sin(2 * t) * np.sin(2 * i * t) / (4.0 * k * (np.cos(t) - np.cos(2 * t)))
    weights[1], weights[k + 1] = rim, -rim
    for j in range(1, k):
        weights[j + 1] = (np.sin(i * t) * np.sin(j * t) + 0.5 * np.sin(2 * i * t) * np.sin(2 * j * t)) / k


@njit(cache=True)
def _half_butterfly(v, other, place, neighbours, closed, columns, values, used):
    """One end's half of the eight-point rule; `place` is where `other` stands among the neighbours of v."""
    count = len(neighbours)
    columns[used], values[used] = v, 0.5
    used += 1
    for side in (-1, 1):
        wing, tip = place + side, place + 2 * side
        columns[used], values[used] = neighbours[wing % count], 1.0 / 16.0
        used += 1
        if closed or 0 <= tip < count:
            columns[used], values[used] = neighbours[tip % count], -1.0 / 16.0
            used += 1
        else:  # v + wing - other completes the parallelogram beyond the boundary
            columns[used], values[used] = v, -1.0 / 16.0
            columns[used + 1], values[used + 1] = neighbours[wing], -1.0 / 16.0
            columns[used + 2], values[used + 2] = other, 1.0 / 16.0
            used += 3
    return used


@njit(cache=True)
def _irregular_ring(v, place, neighbours, closed, share, fan, columns, values, used):
    """The rule of an irregular vertex: itself and its ring, times `share`."""
    count = len(neighbours)
    if not closed:
        _boundary_fan(count - 1, place, fan)
    columns[used], values[used] = v, share * (0.75 if closed else fan[0])
    for j in range(count):
        columns[used + 1 + j] = neighbours[(place + j) % count] if closed else neighbours[j]
        values[used + 1 + j] = share * (_irregular_weight(count, j) if closed else fan[j + 1])
    return used + 1 + count


@njit(cache=True)
def _stencils(pairs, on_boundary, start, ring, closed):
    longest = 0
    for v in range(len(start) - 1):
        longest = max(longest, start[v + 1] - start[v])
    capacity = len(pairs) * 2 * (longest + 9)
    rows, columns, values = np.empty(capacity, np.int64), np.empty(capacity, np.int64), np.empty(capacity)
    fan, used = np.empty(longest + 2), 0
    for e in range(len(pairs)):
        before = used
        irregular = 0
        for end in range(2):
            v = pairs[e, end]
            irregular += (start[v + 1] - start[v]) != (6 if closed[v] else 4)
        for end in range(2):
            v, other = pairs[e, end], pairs[e, 1 - end]
            neighbours = ring[start[v] : start[v + 1]]
            if on_boundary[e]:
                columns[used], values[used] = v, 9.0 / 16.0
                columns[used + 1] = neighbours[-1] if neighbours[0] == other else neighbours[0]
                values[used + 1] = -1.0 / 16.0
                used += 2
                continue
            place = 0
            while neighbours[place] != other:
                place += 1
            if irregular == 0:
                used = _half_butterfly(v, other, place, neighbours, closed[v], columns, values, used)
            elif len(neighbours) != (6 if closed[v] else 4):
                used = _irregular_ring(v, place, neighbours, closed[v], 1.0 / irregular, fan, columns, values, used)
        for at in range(before, used):
            rows[at] = e
    return rows[:used], columns[:used], values[:used]
