"""Points tied to a surface as triangle and barycentrics, so that they can be found again when it has moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.meshes.closest_point import Surface
from headcap.meshes.normals import triangle_normals
from headcap.meshes.topology import boundary_edges

# Two layers of skin that touch (closed lips, an eyelid on the other) face each other: their normals are opposite.
_MIN_COSINE = 0.3
_SEARCH_MARGIN_M = 0.015


@dataclass(frozen=True)
class Ties:
    """Material points of a surface."""

    triangle: NDArray[np.int64]
    """(n,) triangle index, -1 where the surface has no counterpart."""
    barycentric: NDArray[np.float64]
    """(n, 3) weights of the triangle's corners."""
    distance_m: NDArray[np.float64]
    """(n,) from the tied point to its material point at the moment of tying."""

    @property
    def tied(self) -> NDArray[np.bool_]:
        """(n,) true where there is a counterpart."""
        return self.triangle >= 0

    def positions(self, vertices: NDArray, triangles: NDArray) -> NDArray[np.float64]:
        """Where the material points (n, 3) are on the moved surface (v, 3), (m, 3); NaN where untied."""
        points = np.einsum("nc,nck->nk", self.barycentric, np.asarray(vertices, float)[triangles[self.triangle]])
        points[~self.tied] = np.nan
        return points

    def normals(self, vertices: NDArray, triangles: NDArray) -> NDArray[np.float64]:
        """Unit normals (n, 3) of the tied triangles on the moved surface."""
        normals = triangle_normals(np.asarray(vertices, float), triangles[self.triangle])
        return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)


def tie(points: NDArray, normals: NDArray, vertices: NDArray, triangles: NDArray) -> Ties:
    """Tie points (n, 3) with unit normals (n, 3) to the nearest points of a surface whose normals agree (cosine >= 0.3).

    Only triangles within 15 mm beyond the nearest surface of any direction are searched; a point without an agreeing
    one there stays untied.
    """
    unit = triangle_normals(vertices, triangles)
    unit /= np.maximum(np.linalg.norm(unit, axis=1, keepdims=True), 1e-30)
    found = Surface(vertices, triangles).closest(points)
    triangle, weights, distance = found.triangle.astype(np.int64), found.barycentric.copy(), found.distance.copy()
    corners = np.asarray(vertices, float)[triangles]
    low, high = corners.min(axis=1), corners.max(axis=1)
    for i in np.flatnonzero(np.einsum("nk,nk->n", unit[triangle], normals) < _MIN_COSINE):
        reach = distance[i] + _SEARCH_MARGIN_M
        near = np.flatnonzero(((low <= points[i] + reach) & (high >= points[i] - reach)).all(axis=1))
        near = near[unit[near] @ normals[i] >= _MIN_COSINE]
        again = Surface(vertices, triangles[near]).closest(points[i : i + 1]) if len(near) else None
        if again is None or again.distance[0] > reach:
            triangle[i], distance[i] = -1, np.inf
        else:
            triangle[i], weights[i], distance[i] = near[again.triangle[0]], again.barycentric[0], again.distance[0]
    return Ties(triangle, weights, distance)


def at_border(triangle: NDArray, barycentric: NDArray, triangles: NDArray) -> NDArray[np.bool_]:
    """(n,) true where the nearest point lies on an open border of the surface: beyond it there is nothing to compare with."""
    n_vertices = int(triangles.max()) + 1
    edges = np.sort(boundary_edges(triangles), axis=1).astype(np.int64)
    border_codes = edges[:, 0] * n_vertices + edges[:, 1]
    corners = triangles[triangle].astype(np.int64)
    on_border = np.zeros(len(triangle), bool)
    for opposite in range(3):
        pair = np.sort(corners[:, [(opposite + 1) % 3, (opposite + 2) % 3]], axis=1)
        is_border = np.isin(pair[:, 0] * n_vertices + pair[:, 1], border_codes)
        on_border |= is_border & (barycentric[:, opposite] < 1e-6)
    # a nearest point in a border vertex may be reported in a triangle that touches the border in that vertex alone
    border_vertex = np.zeros(n_vertices, bool)
    border_vertex[edges.ravel()] = True
    return on_border | (border_vertex[corners] & (barycentric > 1 - 1e-6)).any(axis=1)
