"""Deformation transfer between meshes of one topology (Sumner & Popovic 2004), with a factor that serves every frame."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from headcap.errors import InputError
from headcap.meshes.laplacian import Factor, cotangent_laplacian
from headcap.meshes.normals import triangle_normals
from headcap.meshes.topology import vertex_components

_LEAST_AREA = 1e-9
"""Triangles below this share of the mean area have no deformation that could be told."""


class DeformationTransfer:
    """Carries what deforms a source mesh over to a target mesh in its own rest shape.

    Sumner & Popovic 2004, eq. 8: target vertices minimise the sum over triangles of |S - T|_F^2 with S, T the deformation
    gradients of source and target (sec. 3, a fourth vertex along the normal, eq. 2). Two things are done as in Botsch et al. 2006
    ("Deformation transfer for detail-preserving surface editing"): triangles count by their area at rest, and the target's fourth
    vertices, which are free, are eliminated, so that a Poisson equation in the target's cotangent Laplacian remains: one
    factor, one solve of (n, 3) per frame, at any rotation.

    Gradients do not know where the mesh is. Every connected piece is placed by the centroid of its `anchors`:
    c' = c'_source + A (c_target - c_source), A the mean gradient about them. Where the source's anchors hold still, so do the
    target's on average; a rigid motion of the source's frame is the same rigid motion of the result.
    """

    def __init__(self, source: NDArray, target: NDArray, triangles: NDArray, anchors: NDArray | None = None) -> None:
        """Rest shapes (n, 3), triangles (m, 3), and the mask (n,) of what places the mesh, all of it by default.

        Raises `InputError` for shapes of another topology, triangles without area, or vertices without a triangle.
        """
        source, target = (np.ascontiguousarray(shape, np.float64) for shape in (source, target))
        self.triangles = np.ascontiguousarray(triangles, np.int32)
        self._check(source, target)
        self._inverse = np.linalg.inv(_frames(source, self.triangles))
        self._cotangents = _cotangents(target, self.triangles)
        edges = np.stack([target[self.triangles[:, k]] - target[self.triangles[:, 0]] for k in (1, 2)], axis=-1)
        self._edges = self._inverse @ edges
        """(m, 3, 2) two edges of each target triangle in the frame of the source's."""
        self._place(source, target, np.ones(len(target), bool) if anchors is None else np.asarray(anchors))
        laplacian = cotangent_laplacian(target, self.triangles)
        # one vertex of each piece is held at zero: the right-hand side sums to zero, so that this is exact
        held = np.bincount(self._first, minlength=len(target)).astype(float)
        self._factor = Factor(laplacian + sparse.diags_array(held))

    def __call__(self, deformed: NDArray) -> NDArray[np.float64]:
        """The target (..., n, 3) deformed as the source was into `deformed` (..., n, 3)."""
        deformed = np.asarray(deformed, np.float64)
        flat = deformed.reshape(-1, *self._shape)
        out = np.empty_like(flat)
        for mesh, result in zip(np.ascontiguousarray(flat), out, strict=True):
            result[:] = self._one(mesh)
        return out.reshape(deformed.shape)

    def gradients(self, deformed: NDArray) -> NDArray[np.float64]:
        """Deformation gradients S (m, 3, 3) of the source's triangles (eq. 4: S = V' V^-1)."""
        return _frames(np.ascontiguousarray(deformed, np.float64), self.triangles) @ self._inverse

    def _one(self, mesh: NDArray) -> NDArray[np.float64]:
        right, mean = _divergence(mesh, self.triangles, self._edges, self._cotangents, self._inverse, self._shares)
        solved = self._factor.solve(right)
        # where the anchors' centroid of each piece belongs, against where it came to lie
        wanted = self._centroid @ mesh + np.einsum("cij,cj->ci", mean, self._lever)
        return solved + (wanted - self._centroid @ solved)[self._piece]

    def _place(self, source: NDArray, target: NDArray, anchors: NDArray) -> None:
        n = self._shape[0]
        self._piece = vertex_components(self.triangles, n)
        pieces = int(self._piece.max()) + 1
        # a piece without anchors is placed by all of itself
        none = np.bincount(self._piece[anchors], minlength=pieces) == 0
        weight = (anchors | none[self._piece]).astype(float)
        rows = sparse.csr_array((weight, (self._piece, np.arange(n))), shape=(pieces, n))
        self._centroid = sparse.csr_array(sparse.diags_array(1.0 / rows.sum(axis=1)) @ rows)
        self._lever = self._centroid @ target - self._centroid @ source
        self._first = np.unique(self._piece, return_index=True)[1]
        share = weight[self.triangles].mean(axis=1) * np.linalg.norm(triangle_normals(target, self.triangles), axis=1)
        piece = self._piece[self.triangles[:, 0]]
        share = share / np.bincount(piece, share, pieces)[piece]
        near = np.flatnonzero(share)
        self._shares = sparse.csr_array((share[near], (piece[near], near)), shape=(pieces, len(piece)))

    def _check(self, source: NDArray, target: NDArray) -> None:
        self._shape = target.shape
        remedy = "Use meshes of one topology whose triangles all have an area and whose vertices all belong to one."
        if source.shape != target.shape or source.ndim != 2 or source.shape[1] != 3 or self.triangles.max() >= len(source):
            found = f"shapes {source.shape}, {target.shape}, triangles up to vertex {self.triangles.max()}"
            raise InputError(found, expected="two (n, 3) and triangles below n", remedy=remedy)
        for name, shape in (("source", source), ("target", target)):
            area = np.linalg.norm(triangle_normals(shape, self.triangles), axis=1)
            flat = ~(area > _LEAST_AREA * area.mean())
            if flat.any():
                raise InputError(f"{flat.sum()} triangles of the {name} have no area", expected="none", remedy=remedy)
        loose = len(source) - len(np.unique(self.triangles))
        if loose:
            raise InputError(f"{loose} vertices without a triangle", expected="none", remedy=remedy)


def _frames(vertices: NDArray, triangles: NDArray) -> NDArray[np.float64]:
    """V (m, 3, 3) of eq. 2, 3: two edges and the normal n / sqrt(|n|) as columns."""
    corners = vertices[triangles]
    normal = triangle_normals(vertices, triangles)
    normal = normal / np.sqrt(np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30))
    return np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], normal], axis=-1)


def _cotangents(vertices: NDArray, triangles: NDArray) -> NDArray[np.float64]:
    """(m, 3) half the cotangent of the angle at each corner."""
    corners = vertices[triangles]
    twice_area = np.linalg.norm(triangle_normals(vertices, triangles), axis=1)
    sides = [(corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]) for k in range(3)]
    return np.stack([0.5 * np.einsum("ni,ni->n", a, b) / twice_area for a, b in sides], axis=1)


def _divergence(mesh, triangles, edges, cotangents, inverse, shares) -> tuple[NDArray, NDArray]:
    """Right-hand side (n, 3) of the Poisson equation, and the mean gradient (c, 3, 3) about each piece's anchors."""
    frames = np.empty((len(triangles), 3, 3))
    right = np.zeros_like(mesh)
    _gather(mesh, triangles, edges, cotangents, frames, right)
    share, piece = shares.data, np.repeat(np.arange(shares.shape[0]), np.diff(shares.indptr))
    weighted = (share[:, None, None] * frames[shares.indices]) @ inverse[shares.indices]
    mean = np.stack([np.bincount(piece, part, shares.shape[0]) for part in weighted.reshape(-1, 9).T], axis=1)
    return right, mean.reshape(-1, 3, 3)


@njit(cache=True)
def _gather(mesh, triangles, edges, cotangents, frames, right):
    carried = np.empty((3, 3))
    for f in range(len(triangles)):
        a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        u, v, normal = frames[f, :, 0], frames[f, :, 1], frames[f, :, 2]
        for i in range(3):
            u[i] = mesh[b, i] - mesh[a, i]
            v[i] = mesh[c, i] - mesh[a, i]
        normal[0] = u[1] * v[2] - u[2] * v[1]
        normal[1] = u[2] * v[0] - u[0] * v[2]
        normal[2] = u[0] * v[1] - u[1] * v[0]
        length = (normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2) ** 0.25
        if length > 0.0:
            normal /= length
        # the target's edges as the source's gradient carries them: a to b, a to c
        for i in range(3):
            for k in range(2):
                carried[k, i] = (
                    frames[f, i, 0] * edges[f, 0, k] + frames[f, i, 1] * edges[f, 1, k] + frames[f, i, 2] * edges[f, 2, k]
                )
            ab, ac = carried[0, i], carried[1, i]
            bc = ac - ab
            # an edge counts by the cotangent of the angle across
            right[a, i] -= cotangents[f, 2] * ab + cotangents[f, 1] * ac
            right[b, i] += cotangents[f, 2] * ab - cotangents[f, 0] * bc
            right[c, i] += cotangents[f, 1] * ac + cotangents[f, 0] * bc
