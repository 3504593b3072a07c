"""Markers tied once to the neutral mesh: by given vertices, or by where they lie after a search for the rigid placement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial.transform import Rotation

from headcap.errors import InputError
from headcap.expressions.head_motion import fit_rigid_frames, moved_frames
from headcap.expressions.markers.settings import MarkerSettings
from headcap.geometry.transforms import fit_rigid, from_vector, invert, rigid, transform
from headcap.meshes.closest_point import Surface
from headcap.meshes.files import read_vertex_numbers
from headcap.meshes.normals import vertex_normals
from headcap.meshes.topology import submesh

_ROUGH_STEPS, _FINE_STEPS, _FINALISTS = 20, 30, 8
_SIZE_M, _DAMPING = 0.1, 1e-4
_RIVAL, _RIVAL_M, _APART_M = 1.2, 2e-4, 0.01
"""A second placement whose residual is less than so many times the best one's, or no more than markers' noise above it, with a
marker this far from where the best one has it, is as good: the markers do not say where they sit."""


@dataclass(frozen=True, eq=False)
class Ties:
    """Where k markers sit on a mesh of n vertices."""

    mesh_from_head: NDArray[np.float64]
    """(4, 4) from the markers' frame at rest."""
    marker_from_vertex: sparse.csr_array
    """(k, n) barycentric weights."""
    distance_mm: NDArray[np.float64]
    """(k,) from the marker to its place."""


def tie_markers(
    names: tuple[str, ...],
    positions: NDArray,
    vertices: NDArray,
    triangles: NDArray,
    settings: MarkerSettings,
    *,
    given: Mapping[str, int] | Path | None = None,
    region: NDArray[np.bool_] | None = None,
) -> Ties:
    """Tie markers at rest (k, 3) to the neutral mesh (n, 3), (m, 3); both metres.

    `given` names vertices of at least three markers (or a JSON file does): those are tied there, they place the others, which are
    tied to the nearest point of the skin. Without it the placement is searched: closest-point alignment from 60 rotations, the
    skin being the `region` (n,) that markers may sit on, or all of the mesh. Markers stand off the skin by their radius: the
    search finds how far, one figure for all, for else it would press them into the face. At lips that meet, a marker on the seam
    is tied to the lip it lies nearer to: give such markers' vertices.
    Raises `InputError` for unknown names or vertices, a placement that is ambiguous or does not fit, and markers off the skin.
    """
    skin = _skin(vertices, triangles, region)
    vertex_of = _given(given, names, len(vertices))
    placement = _by_given(names, positions, vertices, vertex_of) if vertex_of else _searched(positions, skin.surface)
    found = skin.surface.closest(transform(placement, positions))
    rows = np.repeat(np.arange(len(names)), 3)
    columns = skin.used[skin.surface.triangles[found.triangle]]
    shares, distance = found.barycentric.copy(), found.distance.copy()
    for name, vertex in vertex_of.items():
        marker = names.index(name)
        columns[marker], shares[marker] = vertex, (1, 0, 0)
        distance[marker] = np.linalg.norm(transform(placement, positions[marker]) - vertices[vertex])
    _refuse_far(names, 1e3 * distance, settings.farthest_tie_mm)
    weights = sparse.csr_array((shares.ravel(), (rows, columns.ravel())), shape=(len(names), len(vertices)))
    _refuse_doubled(names, weights)
    return Ties(placement, weights, 1e3 * distance)


@dataclass(frozen=True, eq=False)
class _Skin:
    surface: Surface
    used: NDArray[np.int32]


def _skin(vertices: NDArray, triangles: NDArray, region: NDArray[np.bool_] | None) -> _Skin:
    inside = np.ones(len(triangles), bool) if region is None else region[triangles].all(axis=1)
    compact, used = submesh(triangles, inside)
    return _Skin(Surface(vertices[used], compact), used)


def _given(given: Mapping[str, int] | Path | None, names: tuple[str, ...], count: int) -> dict[str, int]:
    if given is None:
        return {}
    if isinstance(given, str | Path):
        given = read_vertex_numbers(given, count, of="marker")
    unknown = sorted(set(given) - set(names))
    beyond = sorted(name for name, vertex in given.items() if not 0 <= vertex < count)
    if unknown or beyond or len(given) < 3:
        raise InputError(
            f"vertices of {len(given)} markers"
            + (f", of which {', '.join(unknown)} are not in the take" if unknown else "")
            + (f", of which {', '.join(beyond)} lie beyond the mesh's {count} vertices" if beyond else ""),
            expected="three markers of the take at least, vertices counted from zero",
            remedy="Mend the names and numbers, or give none and let the placement be searched.",
        )
    return dict(given)


def _by_given(names: tuple[str, ...], positions: NDArray, vertices: NDArray, vertex_of: dict[str, int]) -> NDArray[np.float64]:
    markers = [names.index(name) for name in vertex_of]
    return fit_rigid(positions[markers], vertices[list(vertex_of.values())])


def _searched(positions: NDArray, surface: Surface) -> NDArray[np.float64]:
    """mesh_from_head by alignment to closest points from every attitude."""
    centre, middle = positions.mean(axis=0), surface.vertices.mean(axis=0)
    turns = Rotation.create_group("I").as_matrix()
    rough = _aligned(rigid(turns, middle - turns @ centre), positions, surface)
    distance = np.linalg.norm(_nearest(rough, positions, surface) - moved_frames(rough, positions[None]), axis=2)
    finalists = rough[np.argsort((distance**2).mean(axis=1))[:_FINALISTS]]
    normals = vertex_normals(surface.vertices, surface.triangles)
    refined = [_refined(start, positions, surface, normals) for start in finalists]
    placements, residual = np.array([one[0] for one in refined]), np.array([one[1] for one in refined])
    winner = int(residual.argmin())
    best = placements[winner]
    away = np.linalg.norm(moved_frames(placements, positions[None]) - transform(best, positions), axis=2).max(axis=1)
    rivals = (away > _APART_M) & (residual < max(_RIVAL * residual[winner], residual[winner] + _RIVAL_M))
    if rivals.any():
        raise InputError(
            f"markers fit the mesh in {1 + int(rivals.sum())} places within {1e3 * residual[rivals].max():.1f} mm",
            expected="one placement that fits best by far",
            remedy="Give the vertices of three markers or more, as JSON.",
        )
    return best


def _nearest(placements: NDArray, positions: NDArray, surface: Surface) -> NDArray[np.float64]:
    """(s, k, 3) points of the surface nearest to the markers under each placement."""
    points = moved_frames(placements, positions[None])
    return surface.closest(points.reshape(-1, 3)).points.reshape(points.shape)


def _aligned(starts: NDArray, positions: NDArray, surface: Surface) -> NDArray[np.float64]:
    """Placements (s, 4, 4) after alternating closest points and rigid fits."""
    placements = starts
    for _ in range(_ROUGH_STEPS):
        # fitted from the fixed side: one target for all starts
        placements = invert(fit_rigid_frames(_nearest(placements, positions, surface), positions))
    return placements


def _refined(start: NDArray, positions: NDArray, surface: Surface, normals: NDArray) -> tuple[NDArray, float]:
    """Placement and its rms residual, metres: steps to tangent planes, which slide freely, with one stand-off for all markers.

    A step solves n . (x + w x p + t - q) = s for the turn w, the shift t and the stand-off s; a little damping in units of the
    head's size keeps what a near-round face does not tell.
    """
    placement = start
    for _ in range(_FINE_STEPS):
        points = transform(placement, positions)
        found = surface.closest(points)
        normal = found.interpolate(surface.triangles, normals)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        gap = np.einsum("kc,kc->k", normal, points - found.points)
        centre = points.mean(axis=0)
        arms = np.cross(points - centre, normal) / _SIZE_M
        rows = np.concatenate([arms, normal, -np.ones((len(points), 1))], axis=1)
        solved = np.linalg.solve(rows.T @ rows + _DAMPING * len(points) * np.eye(7), -rows.T @ gap)
        step = from_vector(np.concatenate([solved[:3] / _SIZE_M, np.zeros(3)]))
        placement = rigid(np.eye(3), centre + solved[3:6]) @ step @ rigid(np.eye(3), -centre) @ placement
    return placement, float(np.sqrt(((gap - gap.mean()) ** 2).mean()))


def _refuse_far(names: tuple[str, ...], distance_mm: NDArray, farthest_mm: float) -> None:
    far = np.flatnonzero(distance_mm > farthest_mm)
    if len(far):
        told = ", ".join(f"{names[marker]} {distance_mm[marker]:.0f} mm" for marker in far[:8])
        raise InputError(
            f"{len(far)} markers lie off the neutral mesh: {told}",
            expected=f"{farthest_mm:g} mm at most",
            remedy="Name markers on a band as rigid, give the vertices of three markers or more, or another neutral mesh.",
        )


def _refuse_doubled(names: tuple[str, ...], weights: sparse.csr_array) -> None:
    same = (weights @ weights.T).toarray() > 0.999 * np.sqrt(np.outer(*[(weights.multiply(weights)).sum(axis=1)] * 2))
    pairs = np.argwhere(np.triu(same, 1))
    if len(pairs):
        raise InputError(
            f"markers {names[pairs[0][0]]} and {names[pairs[0][1]]} are tied to one place of the mesh",
            expected="a place of its own for each marker",
            remedy="Leave one of them out by name, or give their vertices.",
        )
