"""Texture coordinates: near-isometric charts (SLIM, Rabinovich et al. 2017) of discs, laid out in one square."""

import igl
import numpy as np
from numpy.typing import NDArray

from headcap.meshes.topology import boundary_loops, submesh

SCALP_SHARE = 0.62
"""How long a line on the back of the head is drawn, against one on the face: the face gets most of the texels."""


def unwrap_disc(vertices: NDArray, triangles: NDArray, iterations: int = 40) -> NDArray:
    """Flat positions (n, 2), in the vertices' unit, of a mesh with one boundary; symmetric Dirichlet energy, no flips."""
    f = np.asfortranarray(triangles, np.int32)
    loop = boundary_loops(triangles)[0]
    run = np.linalg.norm(vertices[loop] - np.roll(vertices[loop], 1, axis=0), axis=1).cumsum()
    turn = 2 * np.pi * run / run[-1]
    corners = vertices[triangles]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    circle = np.sqrt(area / np.pi) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    start = _harmonic(vertices, triangles, loop, circle)
    nothing = np.zeros(0, np.int32), np.asfortranarray(np.zeros((0, 2)))
    space, start = np.asfortranarray(vertices), np.asfortranarray(start)
    data = igl.slim_precompute(space, f, start, igl.SYMMETRIC_DIRICHLET, *nothing, 0.0)
    return np.asarray(igl.slim_solve(data, iterations))


def cut_open(triangles: NDArray, chain: NDArray, sides: NDArray[np.bool_], n_vertices: int) -> tuple[NDArray, NDArray]:
    """Triangles (m, 3) with the chain's vertices (all but the first) doubled where `sides` (m,) is true.

    Also gives the old index of each vertex.
    """
    renamed = np.arange(n_vertices)
    renamed[chain[1:]] = n_vertices + np.arange(len(chain) - 1)
    origin = np.concatenate([np.arange(n_vertices), chain[1:]])
    return np.where(sides[:, None], renamed[triangles], triangles), origin


def shrunken_scalp(vertices: NDArray) -> NDArray:
    """Vertices (n, 3) in millimetres with everything behind the face drawn towards it, the chart's rest shape."""
    t = np.clip((30.0 - vertices[:, 2]) / 90.0, 0.0, 1.0)
    high = np.clip((vertices[:, 1] - 55.0) / 60.0, 0.0, 1.0)
    low = np.clip((-110.0 - vertices[:, 1]) / 60.0, 0.0, 1.0)
    share = 1.0 - (1.0 - SCALP_SHARE) * np.maximum(t * t * (3 - 2 * t) * (1.0 - 0.6 * low), 0.6 * high * high * (3 - 2 * high))
    centre = np.array([0.0, -10.0, 35.0]) * [1, 1, 1] + np.outer(low, [0.0, -110.0, -45.0])
    return centre + (vertices - centre) * share[:, None]


def lay_out(skin: NDArray, pocket: NDArray, gap: float = 0.012) -> tuple[NDArray, NDArray]:
    """Both charts in [0, 1]^2, v down, the face upright: the skin above, the pocket in the free corner below."""
    skin = skin - skin.min(0)
    span = skin.max(0)
    scale = (1.0 - 2 * gap) / span.max()
    skin = gap + skin * scale
    skin[:, 0] += 0.5 * (1.0 - 2 * gap - span[0] * scale)
    pocket = (pocket * [1, -1] - (pocket * [1, -1]).min(0)) * scale
    skin[:, 1] = 1.0 - skin[:, 1]
    pocket = _free_corner(skin, pocket, gap)
    return skin, pocket


def _free_corner(skin: NDArray, pocket: NDArray, gap: float) -> NDArray:
    """The pocket's chart in whichever corner keeps it farthest from the skin's chart, made smaller until it fits."""
    best = None
    for size in (1.0, 0.85, 0.7, 0.55, 0.4):
        chart = pocket * size
        span = chart.max(0)
        for corner in ((0, 0), (0, 1), (1, 0), (1, 1)):
            low = np.where(np.array(corner) == 0, gap, 1.0 - gap - span)
            away = np.maximum(np.maximum(low - skin, skin - low - span), 0.0)
            room = np.hypot(*away.T).min()
            if best is None or room > best[0]:
                best = (room, chart + low)
        if best[0] > gap:
            break
    return best[1]


def _harmonic(vertices: NDArray, triangles: NDArray, loop: NDArray, circle: NDArray) -> NDArray:
    """Tutte's embedding: convex weights, so no triangle is turned over at the start."""
    from headcap.meshes.laplacian import Factor, uniform_laplacian

    n = len(vertices)
    laplacian = uniform_laplacian(triangles, n)
    inside = np.setdiff1d(np.arange(n), loop)
    out = np.zeros((n, 2))
    out[loop] = circle
    out[inside] = Factor(laplacian[inside][:, inside]).solve(-(laplacian[inside][:, loop] @ circle))
    return out


def chart_of(vertices: NDArray, triangles: NDArray, keep: NDArray[np.bool_]) -> tuple[NDArray, NDArray]:
    """Flat positions of a part of a mesh (k, 2) and its triangles over them."""
    part, used = submesh(triangles, keep)
    return unwrap_disc(vertices[used], part), part
