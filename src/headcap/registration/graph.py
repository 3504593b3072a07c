"""Embedded deformation of a template by a graph of affine nodes (Sumner et al. 2007, in the tracking of Li et al. 2009).

Nodes and weights follow geodesic distance on the mesh: upper and lower lip are near in space and far on the skin, so they never
share a node across the opening. Every vertex moves by x = sum_j w_j (A_j (v - g_j) + g_j + t_j). Data come as one quadratic per
vertex (`Normal`), however many points and pixels stand behind it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from headcap.meshes.laplacian import Factor
from headcap.meshes.topology import mesh_edges
from headcap.registration.conjugate_gradient import conjugate_gradient
from headcap.registration.photometric import Normal


class GraphSettings(BaseModel):
    """Density and stiffness of the deformation graph."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    spacing_mm: float = Field(15.0, description="Geodesic distance between neighbouring nodes, millimetres")
    fine_spacing_mm: float = Field(8.0, description="The same on and around the lips")
    nodes_per_vertex: int = Field(4, description="Nodes that move one vertex")
    rigidity: float = Field(0.2, description="Standard deviation of a node's strain (its affine part from a rotation)")
    smoothness_mm: float = Field(
        3.0, description="Standard deviation of neighbouring nodes' disagreement, millimetres per 10 mm between them"
    )
    change_mm: float = Field(0.5, description="The same for the change of that disagreement since the frame before")
    fine_factor: float = Field(
        3.0,
        description="Both deviations are multiplied by this between nodes on the lips: they move by themselves, not with bone",
    )
    hidden_factor: float = Field(
        100.0, description="Smoothness deviation is multiplied by this between nodes that the reference frame does not show"
    )
    inner_lips: float = Field(
        0.5,
        ge=0,
        le=1,
        description="How far hidden inner sides of the lips count as shown: 1 as firm as skin, 0 as free as the mouth's inside",
    )
    steps: int = Field(3, description="Gauss-Newton steps per set of correspondences")


SOLVER_TOLERANCE, SOLVER_STEPS = 1e-3, 40


@dataclass(frozen=True)
class Pose:
    """State of the graph's nodes."""

    affine: NDArray[np.float64]
    """(k, 3, 3)"""
    shift: NDArray[np.float64]
    """(k, 3) metres."""


@dataclass(frozen=True)
class Graph:
    """Nodes on a reference mesh and the weights that tie its vertices to them."""

    vertices: NDArray[np.float64]
    """(n, 3) reference, metres."""
    nodes: NDArray[np.int64]
    """(k,) vertices that are nodes."""
    influence: NDArray[np.int64]
    """(n, p) nodes of each vertex."""
    weights: NDArray[np.float64]
    """(n, p) sum to 1."""
    edges: NDArray[np.int64]
    """(e, 2) neighbouring nodes, both directions."""
    shown: NDArray[np.float64]
    """(k,) share of each node's vertices that the reference frame shows."""
    fine: NDArray[np.bool_]
    """(k,) nodes on the lips."""

    @property
    def rest(self) -> Pose:
        """The undeformed state."""
        return Pose(np.tile(np.eye(3), (len(self.nodes), 1, 1)), np.zeros((len(self.nodes), 3)))

    def deform(self, pose: Pose) -> NDArray[np.float64]:
        """Vertices (n, 3) moved by the nodes."""
        moved = np.zeros(self.vertices.shape)
        _blend(self.vertices, self.vertices[self.nodes], self.influence, self.weights, pose.affine, pose.shift, moved)
        return moved


def build_graph(
    vertices: NDArray,
    triangles: NDArray,
    settings: GraphSettings,
    *,
    fine: NDArray[np.bool_] | None = None,
    shown: NDArray | None = None,
) -> Graph:
    """Sample nodes by geodesic distance on a mesh (n, 3), (m, 3).

    `fine` (n,) marks where they stand closer; `shown` (n,) is 1 at vertices that the reference frame shows, 0 where they stretch
    freely: the inside of the mouth would else pull the lips together.
    """
    distances = edge_graph(vertices, triangles)
    spacing = np.full(len(vertices), settings.spacing_mm * 1e-3)
    if fine is not None:
        spacing[fine] = settings.fine_spacing_mm * 1e-3
    nodes = _sample_nodes(distances, spacing)
    influence, weights = _tie(distances, nodes, settings.nodes_per_vertex, 4 * settings.spacing_mm * 1e-3)
    shown = np.ones(len(vertices)) if shown is None else np.asarray(shown, float)
    carried = np.bincount(influence.ravel(), weights.ravel(), len(nodes))
    share = np.bincount(influence.ravel(), (weights * shown[:, None]).ravel(), len(nodes)) / np.maximum(carried, 1e-9)
    edges = _node_edges(influence, weights, len(nodes))
    lips = np.zeros(len(nodes), np.bool_) if fine is None else np.asarray(fine, bool)[nodes]
    return Graph(np.asarray(vertices, float), nodes, influence, weights, edges, share, lips)


def predict(pose: Pose, before: Pose, ratio: float) -> Pose:
    """Carry the motion from `before` to `pose` on by `ratio` of their interval."""
    return Pose(pose.affine + ratio * (pose.affine - before.affine), pose.shift + ratio * (pose.shift - before.shift))


class GraphSolver:
    """Gauss-Newton on data + rigidity + smoothness."""

    def __init__(self, graph: Graph, settings: GraphSettings) -> None:
        self.graph, self.settings = graph, settings
        self.pattern = _pattern(graph)
        self._factor: Factor | None = None
        self._rigidity, self._smoothness, self._change_share = self._prior_weights()

    def energy(self, pose: Pose, normal: Normal, at: NDArray, before: Pose | None = None) -> float:
        """Data quadratic around vertices `at` (n, 3), plus rigidity and smoothness."""
        step = self.graph.deform(pose) - at
        image = normal.apply(step)
        data = 0.5 * float(np.vdot(step, image)) - float(np.vdot(step, normal.right))
        strain, stretch = _rigidity(pose.affine)[0], _smoothness(self.graph, pose) - self._disagreement_target(before)
        wr, ws = self._rigidity, self._smoothness
        return data + 0.5 * float((wr[:, None] * strain**2).sum()) + 0.5 * float((ws[:, None] * stretch**2).sum())

    def gradient(self, pose: Pose, normal: Normal, at: NDArray, before: Pose | None = None) -> NDArray[np.float64]:
        """Derivative (k, 12) of the energy: the affine part row by row, each followed by its shift."""
        return -self._system(pose, normal, at, before)[1].reshape(-1, 12)

    def step(self, pose: Pose, normal: Normal, at: NDArray, before: Pose | None = None) -> Pose:
        """One Gauss-Newton step for data linearised at vertices `at` (n, 3).

        With the pose of the frame before, neighbouring nodes also hold to how they differed there: what data leave open does
        not wander.
        """
        matrix, right = self._system(pose, normal, at, before)
        update = self._solve(matrix, right).reshape(-1, 3, 4)
        return Pose(pose.affine + update[:, :, :3], pose.shift + update[:, :, 3])

    def _solve(self, matrix: sparse.bsr_array, right: NDArray) -> NDArray:
        """Conjugate gradient, preconditioned by an earlier step's factor while that helps: a factor costs a second."""
        if self._factor is not None:
            update, converged = conjugate_gradient(matrix.__matmul__, self._factor.solve, right, SOLVER_TOLERANCE, SOLVER_STEPS)
            if converged:
                return update
        self._factor = Factor(matrix)
        return self._factor.solve(right)

    def _prior_weights(self) -> tuple[NDArray, NDArray, NDArray]:
        """Rigidity (k,) and smoothness (e,) weights, and what share of the latter holds to the frame before."""
        graph, settings = self.graph, self.settings
        length = np.linalg.norm(np.diff(graph.vertices[graph.nodes][graph.edges], axis=1)[:, 0], axis=1)
        soft = (settings.hidden_factor ** (1 - graph.shown))[graph.edges].min(1)
        soft = soft * np.where(graph.fine[graph.edges].any(1), settings.fine_factor, 1.0)
        spread = 1e-3 * np.maximum(length / 0.01, 0.3) * soft
        rest, change = (settings.smoothness_mm * spread) ** -2, (settings.change_mm * spread) ** -2
        return np.full(len(graph.nodes), settings.rigidity**-2), rest + change, change / (rest + change)

    def _disagreement_target(self, before: Pose | None) -> NDArray:
        """(e, 3) between rest and the frame before."""
        if before is None:
            return np.zeros((len(self.graph.edges), 3))
        return self._change_share[:, None] * _smoothness(self.graph, before)

    def _system(self, pose: Pose, normal: Normal, at: NDArray, before: Pose | None):
        graph, pattern = self.graph, self.pattern
        current = graph.deform(pose)
        # data are linear in the vertices: move their right-hand side to where the nodes are now
        right_vertices = normal.right - normal.apply(current - at)
        k = len(graph.nodes)
        matrix, right = np.zeros((len(pattern.rows), 12, 12)), np.zeros((k, 12))
        centres = graph.vertices[graph.nodes]
        _assemble_data(
            graph.vertices,
            centres,
            graph.influence,
            graph.weights,
            pattern.vertex_slots,
            normal.blocks,
            right_vertices,
            matrix,
            right,
        )
        wr, ws = self._rigidity, self._smoothness
        _assemble_rigidity(pose.affine, wr, pattern.diagonal, matrix, right)
        target = self._disagreement_target(before)
        _assemble_smoothness(centres, pose.affine, pose.shift, graph.edges, ws, target, pattern.edge_slots, matrix, right)
        # data may leave a node quite unseen: keep the matrix positive definite
        matrix[pattern.diagonal] += np.eye(12) * 1e-6 * wr[:, None, None]
        return _to_sparse(matrix, pattern, k), right.ravel()


@dataclass(frozen=True)
class _Pattern:
    rows: NDArray
    columns: NDArray
    diagonal: NDArray
    vertex_slots: NDArray
    edge_slots: NDArray


def edge_graph(vertices: NDArray, triangles: NDArray) -> sparse.csr_array:
    """(n, n) lengths of a mesh's edges, metres, both directions."""
    pairs = mesh_edges(triangles).vertices
    length = np.maximum(np.linalg.norm(vertices[pairs[:, 0]] - vertices[pairs[:, 1]], axis=1), 1e-9)
    both = np.concatenate([pairs, pairs[:, ::-1]])
    return sparse.csr_array((np.tile(length, 2), (both[:, 0], both[:, 1])), shape=(len(vertices),) * 2)


def _sample_nodes(distances: sparse.csr_array, spacing: NDArray) -> NDArray[np.int64]:
    """Greedy Poisson sampling: a vertex is a node if no node lies within its spacing, densely sampled places first."""
    nearest = np.full(len(spacing), np.inf)
    nodes = []
    for v in np.argsort(spacing, kind="stable"):
        if nearest[v] < spacing[v]:
            continue
        nodes.append(v)
        nearest = np.minimum(nearest, dijkstra(distances, indices=v, limit=spacing.max()))
    return np.array(nodes, np.int64)


def _tie(distances: sparse.csr_array, nodes: NDArray, count: int, limit: float):
    """The `count` nearest nodes of each vertex with weights (1 - d / d_next)^2."""
    d = dijkstra(distances, indices=nodes, limit=limit).T
    count = min(count, len(nodes) - 1)
    order = np.argpartition(d, count, axis=1)[:, : count + 1]
    near = np.take_along_axis(d, order, 1)
    inner = np.argsort(near, axis=1, kind="stable")
    order, near = np.take_along_axis(order, inner, 1), np.take_along_axis(near, inner, 1)
    # a small island may have fewer nodes than asked for: the unreachable ones get no weight
    reach = np.where(np.isfinite(near[:, -1:]), near[:, -1:], limit)
    weights = np.where(np.isfinite(near[:, :-1]), np.maximum(1 - near[:, :-1] / np.maximum(reach, 1e-9), 0) ** 2, 0.0)
    weights[:, 0] = np.maximum(weights[:, 0], 1e-6)
    influence = np.where(weights > 0, order[:, :-1], order[:, :1])
    return influence.astype(np.int64), weights / weights.sum(1, keepdims=True)


def _node_edges(influence: NDArray, weights: NDArray, n_nodes: int) -> NDArray[np.int64]:
    n, p = influence.shape
    ties = sparse.csr_array(
        (weights.ravel() > 0, (np.repeat(np.arange(n), p), influence.ravel())), shape=(n, n_nodes), dtype=float
    )
    shared = sparse.coo_array(ties.T @ ties)
    rows, columns = shared.coords
    off = rows != columns
    return np.stack([rows[off], columns[off]], axis=1).astype(np.int64)


def _pattern(graph: Graph) -> _Pattern:
    k, edges = len(graph.nodes), graph.edges
    keys = np.unique(np.concatenate([edges[:, 0] * k + edges[:, 1], np.arange(k) * (k + 1)]))
    slot = lambda a, b: np.searchsorted(keys, a * k + b)  # noqa: E731
    influence = graph.influence
    vertex_slots = slot(influence[:, :, None], influence[:, None, :])
    a, b = edges.T
    edge_slots = np.stack([slot(a, a), slot(a, b), slot(b, a), slot(b, b)], axis=1)
    return _Pattern(keys // k, keys % k, slot(np.arange(k), np.arange(k)), vertex_slots, edge_slots)


def _to_sparse(matrix: NDArray, pattern: _Pattern, k: int) -> sparse.bsr_array:
    starts = np.searchsorted(pattern.rows, np.arange(k + 1))
    return sparse.bsr_array((matrix, pattern.columns, starts), shape=(12 * k, 12 * k))


_PAIRS = ((0, 1), (0, 2), (1, 2))


def _rigidity(affine: NDArray):
    """Residuals (k, 6) of columns being orthonormal and their derivative (k, 6, 3, 3) by the affine entries."""
    k = len(affine)
    residual, derivative = np.zeros((k, 6)), np.zeros((k, 6, 3, 3))
    for row, (i, j) in enumerate(_PAIRS):
        residual[:, row] = np.einsum("nk,nk->n", affine[:, :, i], affine[:, :, j])
        derivative[:, row, :, i], derivative[:, row, :, j] = affine[:, :, j], affine[:, :, i]
    for i in range(3):
        # half of |a|^2 - 1 is the strain itself
        residual[:, 3 + i] = 0.5 * (np.einsum("nk,nk->n", affine[:, :, i], affine[:, :, i]) - 1)
        derivative[:, 3 + i, :, i] = affine[:, :, i]
    return residual, derivative


def _smoothness(graph: Graph, pose: Pose) -> NDArray:
    centres = graph.vertices[graph.nodes]
    a, b = graph.edges.T
    return (
        np.einsum("eij,ej->ei", pose.affine[a], centres[b] - centres[a]) + centres[a] + pose.shift[a] - centres[b] - pose.shift[b]
    )


def _assemble_rigidity(affine, weight, diagonal, matrix, right):
    residual, derivative = _rigidity(affine)
    k = len(affine)
    rows = np.zeros((k, 6, 3, 4))
    rows[..., :3] = derivative
    rows = rows.reshape(k, 6, 12)
    matrix[diagonal] += np.einsum("n,nri,nrj->nij", weight, rows, rows)
    right -= np.einsum("n,nri,nr->ni", weight, rows, residual)


@njit(cache=True)
def _blend(vertices, centres, influence, weights, affine, shift, moved):
    for v in range(len(vertices)):
        for p in range(influence.shape[1]):
            k, w = influence[v, p], weights[v, p]
            if w == 0.0:
                continue
            x, y, z = vertices[v, 0] - centres[k, 0], vertices[v, 1] - centres[k, 1], vertices[v, 2] - centres[k, 2]
            for i in range(3):
                turned = affine[k, i, 0] * x + affine[k, i, 1] * y + affine[k, i, 2] * z
                moved[v, i] += w * (turned + centres[k, i] + shift[k, i])


@njit(cache=True, error_model="numpy")
def _assemble_data(vertices, centres, influence, weights, slots, blocks, right_vertices, matrix, right):
    p = influence.shape[1]
    q = np.zeros((p, 4))
    h = np.zeros((3, 3))
    for v in range(len(vertices)):
        h[0, 0], h[0, 1], h[0, 2] = blocks[v, 0], blocks[v, 1], blocks[v, 2]
        h[1, 0], h[1, 1], h[1, 2] = blocks[v, 1], blocks[v, 3], blocks[v, 4]
        h[2, 0], h[2, 1], h[2, 2] = blocks[v, 2], blocks[v, 4], blocks[v, 5]
        if h[0, 0] + h[1, 1] + h[2, 2] == 0.0:
            continue
        for a in range(p):
            for i in range(3):
                q[a, i] = weights[v, a] * (vertices[v, i] - centres[influence[v, a], i])
            q[a, 3] = weights[v, a]
        for a in range(p):
            if q[a, 3] == 0.0:
                continue
            for r in range(3):
                for i in range(4):
                    right[influence[v, a], 4 * r + i] += q[a, i] * right_vertices[v, r]
            for b in range(p):
                if q[b, 3] == 0.0:
                    continue
                slot = slots[v, a, b]
                for i in range(4):
                    for j in range(4):
                        product = q[a, i] * q[b, j]
                        for r in range(3):
                            for s in range(3):
                                matrix[slot, 4 * r + i, 4 * s + j] += product * h[r, s]


@njit(cache=True, error_model="numpy")
def _assemble_smoothness(centres, affine, shift, edges, weights, target, slots, matrix, right):
    q = np.zeros(4)
    for e in range(len(edges)):
        a, b, w = edges[e, 0], edges[e, 1], weights[e]
        for i in range(3):
            q[i] = centres[b, i] - centres[a, i]
        q[3] = 1.0
        for r in range(3):
            residual = centres[a, r] + shift[a, r] - centres[b, r] - shift[b, r] - target[e, r]
            for i in range(3):
                residual += affine[a, r, i] * q[i]
            for i in range(4):
                right[a, 4 * r + i] -= w * q[i] * residual
                matrix[slots[e, 1], 4 * r + i, 4 * r + 3] -= w * q[i]
                matrix[slots[e, 2], 4 * r + 3, 4 * r + i] -= w * q[i]
                for j in range(4):
                    matrix[slots[e, 0], 4 * r + i, 4 * r + j] += w * q[i] * q[j]
            right[b, 4 * r + 3] += w * residual
            matrix[slots[e, 3], 4 * r + 3, 4 * r + 3] += w
