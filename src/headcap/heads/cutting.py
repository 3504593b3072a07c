"""Cut the model's topology out of the sculpted head: `headcap.heads.procedural.build()` rewrites `base_head.npz`.

Half of the surface is flattened (LSCM), filled with points at the wanted density (centroidal relaxation over Delaunay
triangulations, rings of fixed points around mouth and eyes), lifted back and mirrored, so that the mesh is symmetric to
the last bit. The mouth is cut open along the line where the lips meet and a pocket is sewn behind it.
"""

from dataclasses import dataclass

import igl
import numpy as np
from matplotlib.path import Path as Polygon
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import Delaunay, cKDTree

from headcap.heads import sculpt
from headcap.meshes.closest_point import Surface
from headcap.meshes.topology import boundary_loops, submesh, vertex_components

GRID_MM, SLIT_STEP_MM, EYE_STEP_MM = 2.5, 1.7, 1.8
EYE_HALF_WIDTH_MM, EYE_UP_MM, EYE_DOWN_MM = 14.0, 5.4, 4.4


@dataclass(frozen=True)
class Plane:
    """A flattened half head."""

    space: NDArray
    """(n, 3) millimetres."""
    flat: NDArray
    """(n, 2)."""
    triangles: NDArray
    border: NDArray
    """Boundary loop."""

    def scale(self) -> NDArray:
        """(n,) plane units per millimetre."""
        edge = np.roll(self.triangles, 1, axis=1).ravel(), self.triangles.ravel()
        ratio = np.log(_lengths(self.flat, *edge) / np.maximum(_lengths(self.space, *edge), 1e-6))
        count = np.bincount(edge[0], minlength=len(self.flat))
        return np.exp(np.bincount(edge[0], ratio, len(self.flat)) / np.maximum(count, 1))

    def flatten(self, points: NDArray) -> NDArray:
        """Plane coordinates (k, 2) of surface points (k, 3)."""
        found = Surface(self.space, self.triangles).closest(points)
        return found.interpolate(self.triangles, self.flat)


def wanted_edge_mm(points: NDArray) -> NDArray:
    """Edge length (k,) at surface points (k, 3): fine around lips, eyes and nose, coarse on the scalp and shoulders."""
    p = np.abs(points * [1, 0, 0]) + points * [0, 1, 1]
    size = 3.4 + 4.0 * _step(20.0 - p[:, 2], 45.0) + 0.8 * _step(p[:, 1] - 35.0, 40.0)
    size = np.minimum(size, 6.6) + 1.5 * _step(-178.0 - p[:, 1], 25.0)
    for centre, radius, edge in (
        ((0, -67, 98), 24, 2.0), ((22, -67, 90), 18, 2.0), ((30, 0, 82), 24, 2.05), ((8, -38, 108), 20, 2.2),
        ((0, -155, 40), 26, 3.3), ((80, -8, -14), 38, 3.3), ((0, -95, 90), 22, 2.9),
    ):  # fmt: skip
        away = np.linalg.norm(p - np.array(centre), axis=1)
        size = np.minimum(size, edge + 0.16 * np.maximum(away - radius, 0.0))
    return size


def half_surface() -> tuple[NDArray, NDArray]:
    """Marching cubes of the half with x >= 0: vertices (n, 3) and triangles (m, 3)."""
    axes = [np.arange(0.0, 200.0, GRID_MM), np.arange(sculpt.NECK_CUT_MM, 122.0, GRID_MM), np.arange(-120.0, 130.0, GRID_MM)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), -1).transpose(2, 1, 0, 3).reshape(-1, 3)
    vertices, triangles = igl.marching_cubes(sculpt.head_field(grid), grid, *(len(a) for a in axes), 0.0)[:2]
    labels = vertex_components(triangles, len(vertices))
    keep = labels[triangles[:, 0]] == np.bincount(labels).argmax()
    triangles, used = submesh(triangles, keep)
    vertices = vertices[used]
    normal = np.cross(
        vertices[triangles[:, 1]] - vertices[triangles[:, 0]], vertices[triangles[:, 2]] - vertices[triangles[:, 0]]
    )
    if (normal * vertices[triangles[:, 0]]).sum() < 0:
        triangles = triangles[:, ::-1]
    return vertices, np.ascontiguousarray(triangles)


def flatten_half() -> Plane:
    """The half surface and its conformal map, turned so that the face's midline runs roughly along +y."""
    space, triangles = half_surface()
    border = boundary_loops(triangles)[0]
    on_middle = border[space[border, 0] < 1e-6]
    ends = np.array(
        [on_middle[space[on_middle, 1].argmax()], on_middle[np.argmin(np.abs(space[on_middle, 1] + 120) - space[on_middle, 2])]]
    )
    flat = igl.lscm(space, triangles.astype(np.int64), ends.astype(np.int64), np.array([[0.0, 200.0], [0.0, 0.0]]))
    flat = np.asarray(flat[0] if isinstance(flat, tuple) else flat).reshape(-1, 2)
    return Plane(space, flat, triangles, border)


def _lengths(points: NDArray, i: NDArray, j: NDArray) -> NDArray:
    return np.linalg.norm(points[i] - points[j], axis=1)


def _step(x: NDArray, width: float) -> NDArray:
    t = np.clip(x / width, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def fixed_points(plane: Plane) -> tuple[NDArray, dict[str, NDArray]]:
    """Plane points (k, 2) that must be vertices, and the indices of named chains among them."""
    loop = np.roll(plane.border, -_bottom_back(plane))
    on_middle = plane.space[loop, 0] < 1e-6
    middle = loop[: np.flatnonzero(on_middle).max() + 1] if on_middle[0] else loop
    rest = np.append(loop[len(middle) - 1 :], loop[0])
    slit = plane.flatten(_slit_line())
    cut = int(np.argmin(np.linalg.norm(plane.flat[middle] - slit[0], axis=1)))
    sides = [_resample(plane, middle[: cut + 1]), _resample(plane, middle[cut:])[1:], _resample(plane, rest)[1:-1]]
    slit[0] = sides[0][-1]
    slit = _even(slit)
    border = np.concatenate(sides)
    rim = plane.flatten(_eye_rim())
    rings = [_offset(plane, slit, SLIT_STEP_MM, k, closed=False) for k in (1, 2, 3)]
    rings += [_offset(plane, rim, EYE_STEP_MM, k, closed=True) for k in (-1, 1, 2)]
    parts = {
        "border": border,
        "slit": slit[1:],
        "rim": rim,
        "rings": _apart(_within(np.concatenate(rings), border), np.concatenate([border, slit, rim]), plane),
    }
    points = np.concatenate(list(parts.values()))
    ends = np.cumsum([len(part) for part in parts.values()])
    chains = {name: np.arange(end - len(part), end) for (name, part), end in zip(parts.items(), ends, strict=True)}
    chains["slit"] = np.insert(chains["slit"], 0, len(sides[0]) - 1)
    return points, chains


def triangulate(plane: Plane, rounds: int = 120) -> tuple[NDArray, NDArray, dict[str, NDArray]]:
    """Plane points (k, 2), triangles (m, 3) and chains: fixed points and relaxed free ones at the wanted density."""
    fixed, chains = fixed_points(plane)
    size = wanted_edge_mm(plane.space) * plane.scale()
    size_at = LinearNDInterpolator(plane.flat, size, fill_value=float(size.min()))
    free = _scatter(plane, size, fixed)
    polygon = Polygon(fixed[chains["border"]])
    for _ in range(rounds):
        points = np.concatenate([fixed, free])
        triangles = Delaunay(points).simplices
        centroids = points[triangles].mean(1)
        inside = polygon.contains_points(centroids)
        triangles, centroids = triangles[inside], centroids[inside]
        weight = _area(points, triangles) / size_at(centroids) ** 4
        total = np.bincount(triangles.ravel(), np.repeat(weight, 3), len(points))
        moved = [np.bincount(triangles.ravel(), np.repeat(weight * centroids[:, axis], 3), len(points)) for axis in range(2)]
        goal = np.stack(moved, axis=1) / np.maximum(total, 1e-30)[:, None]
        free = np.where(total[len(fixed) :, None] > 0, goal[len(fixed) :], free)
    points = np.concatenate([fixed, free])
    triangles = Delaunay(points).simplices
    triangles = triangles[polygon.contains_points(points[triangles].mean(1))]
    flip = np.sign(_signed_area(points, triangles)) < 0
    triangles[flip] = triangles[flip][:, ::-1]
    return points, triangles.astype(np.int32), chains


def _even(chain: NDArray) -> NDArray:
    run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(chain, axis=0), axis=1))])
    at = np.linspace(0.0, run[-1], len(chain))
    return np.stack([np.interp(at, run, chain[:, axis]) for axis in range(2)], axis=1)


def _within(points: NDArray, border: NDArray) -> NDArray:
    return points[Polygon(border).contains_points(points)]


def _apart(points: NDArray, others: NDArray, plane: Plane) -> NDArray:
    """Those points (k, 2) that crowd neither the others nor an earlier one."""
    least = 0.62 * SLIT_STEP_MM * plane.scale()[cKDTree(plane.flat).query(points)[1]]
    points, least = points[cKDTree(others).query(points)[0] > least], least[cKDTree(others).query(points)[0] > least]
    close = cKDTree(points).query_pairs(float(least.max()), output_type="ndarray")
    close = close[np.linalg.norm(points[close[:, 0]] - points[close[:, 1]], axis=1) < least[close[:, 0]]]
    keep = np.ones(len(points), bool)
    for early, late in close:
        if keep[early]:
            keep[late] = False
    return points[keep]


def _scatter(plane: Plane, size: NDArray, fixed: NDArray) -> NDArray:
    random = np.random.default_rng(7)
    density = _area(plane.flat, plane.triangles) / (0.866 * size[plane.triangles].mean(1) ** 2)
    chosen = random.choice(len(density), int(density.sum()), p=density / density.sum())
    weights = random.dirichlet(np.ones(3), len(chosen))
    points = np.einsum("nc,nck->nk", weights, plane.flat[plane.triangles[chosen]])
    local = np.einsum("nc,nc->n", weights, size[plane.triangles[chosen]])
    away = cKDTree(fixed).query(points)[0]
    return points[away > 0.6 * local]


def _resample(plane: Plane, chain: NDArray) -> NDArray:
    """Points (k, 2) along a chain of border vertices, spaced as wanted, both ends kept."""
    space, flat = plane.space[chain], plane.flat[chain]
    steps = np.linalg.norm(np.diff(space, axis=0), axis=1) / wanted_edge_mm(0.5 * (space[1:] + space[:-1]))
    run = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.linspace(0.0, run[-1], round(run[-1]) + 1)
    return np.stack([np.interp(at, run, flat[:, axis]) for axis in range(2)], axis=1)


def _bottom_back(plane: Plane) -> int:
    """Position in the border loop where the midline begins (loop runs along the whole midline from here)."""
    on_middle = plane.space[plane.border, 0] < 1e-6
    return int(np.flatnonzero(on_middle & ~np.roll(on_middle, 1))[0])


def _slit_line() -> NDArray:
    """Lip line (k, 3) from the midline to the corner, evenly spaced."""
    x = np.linspace(0.0, sculpt.MOUTH_HALF_WIDTH_MM, 400)
    line = _on_front(np.stack([x, sculpt.mouth_line(x), np.full(400, 130.0)], axis=1))
    run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.linspace(0.0, run[-1], round(run[-1] / SLIT_STEP_MM) + 1)
    return np.stack([np.interp(at, run, line[:, axis]) for axis in range(3)], axis=1)


def _eye_rim() -> NDArray:
    """Closed outline (k, 3) of the opening between the lids."""
    turn = np.linspace(0.0, 2 * np.pi, 400, endpoint=False)
    x = EYE_HALF_WIDTH_MM * np.cos(turn)
    height = np.where(np.sin(turn) > 0, EYE_UP_MM, EYE_DOWN_MM) * np.sign(np.sin(turn)) * np.abs(np.sin(turn)) ** 1.35
    tilt = 0.07 * x
    line = _on_front(np.stack([sculpt.PUPIL_MM[0] + x, sculpt.PUPIL_MM[1] + height + tilt, np.full(400, 130.0)], axis=1))
    ring = np.concatenate([line, line[:1]])
    run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ring, axis=0), axis=1))])
    at = np.linspace(0.0, run[-1], round(run[-1] / EYE_STEP_MM), endpoint=False)
    return np.stack([np.interp(at, run, ring[:, axis]) for axis in range(3)], axis=1)


def _on_front(points: NDArray) -> NDArray:
    """Points moved along -z until they meet the surface (bisection after a march)."""
    points = np.array(points, float)
    for _ in range(120):
        points[:, 2] -= np.clip(sculpt.head_field(points) * 0.7, 0.0, 4.0)
    return points


def _offset(plane: Plane, chain: NDArray, step_mm: float, k: int, *, closed: bool) -> NDArray:
    """Points (n, 2) on the k-th parallel of a chain at 0.87 edge lengths each; negative k lies inside a closed chain."""
    tree = cKDTree(plane.flat)
    step = step_mm * plane.scale()[tree.query(chain)[1]].mean()
    distance = 0.87 * step * abs(k)
    curve = _parallel(chain, distance, closed=closed, inside=k < 0)
    run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(curve, axis=0), axis=1))])
    count = round(run[-1] / (step * (1.0 + 0.08 * abs(k))))
    at = (np.arange(count) + (0.5 if k % 2 else 0.0)) * run[-1] / count if closed else np.linspace(0, run[-1], count + 1)[1:-1]
    points = np.stack([np.interp(at, run, curve[:, axis]) for axis in range(2)], axis=1)
    near = cKDTree(_dense(chain, closed=closed)).query(points)[0]
    return points[near > 0.8 * distance]


def _parallel(chain: NDArray, distance: float, *, closed: bool, inside: bool) -> NDArray:
    dense = _dense(chain, closed=closed)
    tangent = np.gradient(dense, axis=0)
    if closed:
        tangent = np.roll(dense, -1, axis=0) - np.roll(dense, 1, axis=0)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    if closed:
        outward = np.sign(np.einsum("nk,nk->", normal, dense - dense.mean(0)))
        curve = dense + (-1.0 if inside else 1.0) * outward * distance * normal
        return np.concatenate([curve, curve[:1]])
    turn = np.linspace(np.pi / 2, -np.pi / 2, 60)[1:-1]
    ahead = np.array([normal[-1, 1], -normal[-1, 0]])
    cap = dense[-1] + distance * (np.sin(turn)[:, None] * normal[-1] + np.cos(turn)[:, None] * ahead)
    return np.concatenate([dense + distance * normal, cap, (dense - distance * normal)[::-1]])


def _dense(chain: NDArray, *, closed: bool) -> NDArray:
    ring = np.concatenate([chain, chain[:1]]) if closed else chain
    at = np.linspace(0, len(ring) - 1, 12 * len(ring), endpoint=not closed)
    return np.stack([np.interp(at, np.arange(len(ring)), ring[:, axis]) for axis in range(2)], axis=1)


def _signed_area(points: NDArray, triangles: NDArray) -> NDArray:
    a, b, c = points[triangles].transpose(1, 0, 2)
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def _area(points: NDArray, triangles: NDArray) -> NDArray:
    return np.abs(_signed_area(points, triangles))
