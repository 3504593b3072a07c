"""Who touches whom in a triangle mesh: edges, boundaries, neighbours, components, defects."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components


@dataclass(frozen=True)
class Edges:
    """Undirected edges of a mesh and the triangles on both sides."""

    vertices: NDArray[np.int32]
    """(e, 2), lower index first, sorted."""
    triangles: NDArray[np.int32]
    """(e, 2) triangles at the edge, -1 where there is only one (boundary)."""
    count: NDArray[np.int32]
    """(e,) how many triangles meet here: 1 on a boundary, 2 inside, more where the mesh is not manifold."""

    @property
    def boundary(self) -> NDArray[np.bool_]:
        """(e,) true on edges of one triangle."""
        return self.count == 1


def mesh_edges(triangles: NDArray) -> Edges:
    """Edges of triangles (m, 3), each once."""
    n = int(np.max(triangles, initial=0)) + 1
    keys, inverse, count = np.unique(_edge_keys(triangles, n), return_inverse=True, return_counts=True)
    vertices = np.stack([keys // n, keys % n], axis=1)
    owner = np.tile(np.arange(len(triangles), dtype=np.int32), 3)
    order = np.argsort(inverse.ravel(), kind="stable")
    first = np.concatenate([[0], np.cumsum(count)[:-1]]).astype(int) if len(count) else np.zeros(0, int)
    sides = np.full((len(vertices), 2), -1, np.int32)
    sides[:, 0] = owner[order[first]]
    shared = count >= 2
    sides[shared, 1] = owner[order[first[shared] + 1]]
    return Edges(vertices.astype(np.int32), sides, count.astype(np.int32))


def boundary_edges(triangles: NDArray) -> NDArray[np.int32]:
    """Directed boundary edges (b, 2), in the direction their triangle runs through them."""
    n = int(np.max(triangles, initial=0)) + 1
    _, inverse, count = np.unique(_edge_keys(triangles, n), return_inverse=True, return_counts=True)
    return _directed_edges(triangles)[count[inverse.ravel()] == 1].astype(np.int32)


def boundary_mask(triangles: NDArray, n_vertices: int) -> NDArray[np.bool_]:
    """(n,) true for vertices on a boundary."""
    mask = np.zeros(n_vertices, bool)
    mask[boundary_edges(triangles).ravel()] = True
    return mask


def boundary_loops(triangles: NDArray) -> list[NDArray[np.int32]]:
    """Boundary loops, longest first, each a ring of vertices (k,) without repetition of the first."""
    following: dict[int, list[int]] = {}
    for a, b in boundary_edges(triangles).tolist():
        following.setdefault(a, []).append(b)
    loops = []
    while following:
        start = next(iter(following))
        loop, current = [], start
        while current in following:
            loop.append(current)
            ahead = following[current]
            current = ahead.pop()
            if not ahead:
                del following[loop[-1]]
        loops.append(np.array(loop, np.int32))
    return sorted(loops, key=len, reverse=True)


def vertex_adjacency(triangles: NDArray, n_vertices: int) -> sparse.csr_array:
    """Symmetric (n, n) matrix of ones where an edge joins two vertices."""
    pairs = mesh_edges(triangles).vertices
    both = np.concatenate([pairs, pairs[:, ::-1]])
    return sparse.csr_array((np.ones(len(both)), (both[:, 0], both[:, 1])), shape=(n_vertices, n_vertices))


def vertex_components(triangles: NDArray, n_vertices: int) -> NDArray[np.int32]:
    """(n,) label of the connected piece each vertex belongs to; vertices without a triangle are pieces of their own."""
    return connected_components(vertex_adjacency(triangles, n_vertices), directed=False)[1]


def grow(mask: NDArray[np.bool_], adjacency: sparse.csr_array, rings: int) -> NDArray[np.bool_]:
    """The mask (n,) widened by so many rings of neighbours."""
    for _ in range(rings):
        mask = mask | (adjacency @ mask.astype(float) > 0)
    return mask


def submesh(triangles: NDArray, keep_triangles: NDArray[np.bool_]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Chosen triangles renumbered (k, 3), and the old indices of the vertices they use (u,)."""
    used, compact = np.unique(triangles[keep_triangles], return_inverse=True)
    return compact.reshape(-1, 3).astype(np.int32), used.astype(np.int32)


def non_manifold_edges(triangles: NDArray) -> NDArray[np.int32]:
    """Edges (k, 2) where more than two triangles meet, or two run the same way (the surface turns inside out)."""
    edges = mesh_edges(triangles)
    directed = _directed_edges(triangles).astype(np.int64)
    n = int(np.max(triangles, initial=0)) + 1
    keys, times = np.unique(directed[:, 0] * n + directed[:, 1], return_counts=True)
    twice = keys[times > 1]
    doubled = np.sort(np.stack([twice // n, twice % n], axis=1), axis=1)
    return np.unique(np.concatenate([edges.vertices[edges.count > 2], doubled]), axis=0).astype(np.int32)


def non_manifold_vertices(triangles: NDArray, n_vertices: int) -> NDArray[np.int32]:
    """Vertices whose triangles do not form one fan (k,): two sheets touch in one point there."""
    corners = np.arange(triangles.size).reshape(-1, 3)
    edges = mesh_edges(triangles)
    inside = edges.count == 2
    first, second = edges.triangles[inside].T
    rows, columns = [], []
    for side in range(2):
        vertex = edges.vertices[inside, side]
        rows.append(corners[first][triangles[first] == vertex[:, None]])
        columns.append(corners[second][triangles[second] == vertex[:, None]])
    links = (np.ones(2 * inside.sum()), (np.concatenate(rows), np.concatenate(columns)))
    labels = connected_components(sparse.coo_array(links, shape=(triangles.size,) * 2), directed=False)[1]
    fans = np.unique(np.stack([triangles.ravel(), labels], axis=1), axis=0)
    return np.flatnonzero(np.bincount(fans[:, 0], minlength=n_vertices) > 1).astype(np.int32)


def polygon_fans(corners: NDArray, counts: NDArray) -> NDArray[np.int32]:
    """Triangles (m, 3) of polygons, fans about first corners: corners (c,) one polygon after another, `counts` (p,) of each."""
    corners, counts = np.asarray(corners, np.int64), np.asarray(counts, np.int64)
    wedges = np.maximum(counts - 2, 0)
    polygon = np.repeat(np.arange(len(counts)), wedges)
    step = np.arange(len(polygon)) - (np.cumsum(wedges) - wedges)[polygon]
    first = (np.cumsum(counts) - counts)[polygon]
    return np.stack([corners[first], corners[first + step + 1], corners[first + step + 2]], axis=-1).astype(np.int32)


def same_triangles(first: NDArray, second: NDArray) -> bool:
    """Whether two lists of triangles (m, 3) tell one surface: in any order, beginning at any corner, but turned alike."""
    return first.shape == second.shape and np.array_equal(_in_order(first), _in_order(second))


def euler_characteristic(triangles: NDArray) -> int:
    """Vertices in use - edges + triangles: 2 for a sphere, 1 for a disc."""
    return int(len(np.unique(triangles)) - len(mesh_edges(triangles).vertices) + len(triangles))


def _directed_edges(triangles: NDArray) -> NDArray:
    triangles = np.asarray(triangles)
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


def _edge_keys(triangles: NDArray, n_vertices: int) -> NDArray[np.int64]:
    """One number per directed edge, equal for both directions (sorting numbers is ten times faster than sorting rows)."""
    directed = np.sort(_directed_edges(triangles), axis=1).astype(np.int64)
    return directed[:, 0] * n_vertices + directed[:, 1]


def _in_order(triangles: NDArray) -> NDArray:
    turned = np.take_along_axis(triangles, (triangles.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    return turned[np.lexsort(turned.T[::-1])]
