"""Global alignment of the base head to a scan by geometry alone: many starts, trimmed ICP both ways, the best wins."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from headcap.errors import InputError
from headcap.geometry.transforms import fit_similarity, from_vector, rigid
from headcap.meshes.normals import triangle_normals, vertex_normals


class AlignSettings(BaseModel):
    """Search for the scan's placement."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    starts: int = Field(240, ge=24, description="Rotations tried, spread evenly; each with two translations")
    points: int = Field(300, ge=50, description="Points per mesh in the first pass")
    finalists: int = Field(10, ge=1, description="Best starts that are refined with four times the points")
    kept_share: float = Field(0.7, gt=0, le=1, description="Share of nearest pairs that count (scan and base overlap in part)")
    scale_range: tuple[float, float] = Field((0.82, 1.2), description="Size of the subject against the base head")
    worst_fit_mm: float = Field(8.0, description="Past this trimmed distance a search has found no head, or not how it lies")
    seed: int = Field(11, description="Seed of the sampled points")


@dataclass(frozen=True)
class Samples:
    """Points with normals and a tree."""

    points: NDArray
    normals: NDArray
    tree: cKDTree

    @classmethod
    def of(cls, vertices: NDArray, triangles: NDArray, count: int, seed: int) -> "Samples":
        """Evenly by area, normals of the smooth surface."""
        random = np.random.default_rng(seed)
        area = np.linalg.norm(triangle_normals(vertices, triangles), axis=1)
        chosen = np.searchsorted(np.cumsum(area) / area.sum(), (np.arange(count) + random.random(count)) / count)
        chosen = triangles[np.minimum(chosen, len(triangles) - 1)]
        weights = random.dirichlet(np.ones(3), count)
        normals = np.einsum("nc,nck->nk", weights, vertex_normals(vertices, triangles)[chosen])
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        points = np.einsum("nc,nck->nk", weights, vertices[chosen])
        return cls(points, normals, cKDTree(points))


@dataclass(frozen=True)
class Placement:
    """Similarity that takes the base head onto the scan: scan = R (scale * base) + t."""

    scan_from_base: NDArray
    """(4, 4) rigid part."""
    scale: float
    score_mm: float
    """Trimmed distance both ways plus what normals disagree, millimetres."""

    def apply(self, points: NDArray) -> NDArray:
        """Base points (n, 3) in the scan's frame."""
        return self.scale * points @ self.scan_from_base[:3, :3].T + self.scan_from_base[:3, 3]


def align_base(
    base: tuple[NDArray, NDArray],
    scan: tuple[NDArray, NDArray],
    settings: AlignSettings,
    picks: tuple[NDArray, NDArray] | None = None,
) -> Placement:
    """Place the base's skin (vertices, triangles) on the scan (vertices, triangles), both metres.

    Base frame: y up, z out of the face. `picks` are at least three pairs of points (base (k, 3), scan (k, 3)) that replace
    the search. Raises `InputError` where the search finds nothing that fits.
    """
    if picks is not None and len(picks[0]) >= 3:
        start, scale = fit_similarity(*picks)
        best = [Placement(start, float(np.clip(scale, *settings.scale_range)), 0.0)]
    else:
        best = _search(base, scan, settings)
    dense = [Samples.of(*mesh, settings.points * 14, settings.seed + 1) for mesh in (base, scan)]
    final = [_refine(*dense, placement, 25, settings, reach_m=0.015) for placement in best[:3]]
    winner = min(final, key=lambda placement: placement.score_mm)
    if picks is None and winner.score_mm > settings.worst_fit_mm:
        raise InputError(
            f"the base head fits the scan to {winner.score_mm:.1f} mm at best",
            expected=f"at most {settings.worst_fit_mm:g} mm",
            remedy="Check that the scan shows a head with its face, in its unit; or give picks of at least three landmarks.",
        )
    return winner


def _search(base: tuple, scan: tuple, settings: AlignSettings) -> list[Placement]:
    coarse = [Samples.of(*mesh, settings.points, settings.seed) for mesh in (base, scan)]
    starts = [start for rotation in even_rotations(settings.starts) for start in _starts(*coarse, rotation)]
    rough = sorted((_refine(*coarse, start, 8, settings, reach_m=0.06) for start in starts), key=lambda p: p.score_mm)
    middle = [Samples.of(*mesh, settings.points * 4, settings.seed) for mesh in (base, scan)]
    finalists = _different(rough, settings.finalists)
    better = (_refine(*middle, start, 20, settings, reach_m=0.03) for start in finalists)
    return sorted(better, key=lambda p: p.score_mm)


def even_rotations(count: int) -> NDArray:
    """Rotations (count, 3, 3) spread evenly over SO(3) (super-Fibonacci spiral, Alexa 2022)."""
    s = np.arange(count) + 0.5
    t = s / count
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    r, big = np.sqrt(t), np.sqrt(1 - t)
    alpha, beta = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    return Rotation.from_quat(
        np.stack([r * np.sin(alpha), r * np.cos(alpha), big * np.sin(beta), big * np.cos(beta)], 1)
    ).as_matrix()


def _starts(base: Samples, scan: Samples, rotation: NDArray) -> list[Placement]:
    """Centres together, and tops of the heads together (scans differ in how much of the chest they show)."""
    turned = base.points @ rotation.T
    up = rotation[:, 1]
    offsets = [scan.points.mean(0) - turned.mean(0)]
    tops = []
    for points in (scan.points, turned):
        height = points @ up
        upper = points[height > height.max() - 0.2]
        tops.append(upper.mean(0) + up * (height.max() - (upper @ up).mean()))
    offsets.append(tops[0] - tops[1])
    return [Placement(rigid(rotation, offset), 1.0, np.inf) for offset in offsets]


def _different(placements: list[Placement], count: int) -> list[Placement]:
    """The best that differ by 15 degrees or 2 cm from each better one."""
    chosen: list[Placement] = []
    for placement in placements:
        if all(_apart(placement, other) for other in chosen):
            chosen.append(placement)
        if len(chosen) == count:
            break
    return chosen


def _apart(a: Placement, b: Placement) -> bool:
    angle = np.arccos(np.clip((np.trace(a.scan_from_base[:3, :3].T @ b.scan_from_base[:3, :3]) - 1) / 2, -1, 1))
    return bool(angle > np.radians(15) or np.linalg.norm(a.scan_from_base[:3, 3] - b.scan_from_base[:3, 3]) > 0.02)


def _refine(base: Samples, scan: Samples, start: Placement, rounds: int, settings: AlignSettings, reach_m: float) -> Placement:
    pose, scale = start.scan_from_base, start.scale
    for turn in range(rounds):
        pairs = _pairs(base, scan, pose, scale)
        weight = _weights(pairs, settings.kept_share, reach_m * (1.0 + 2.0 * (1 - turn / rounds)))
        free_scale = turn >= rounds // 3
        pose, growth = _step(pairs, weight, pose, free_scale)
        scale = float(np.clip(scale * growth, *settings.scale_range))
    return Placement(pose, scale, _score(_pairs(base, scan, pose, scale), settings.kept_share))


@dataclass(frozen=True)
class _Pairs:
    moving: NDArray
    target: NDArray
    normal: NDArray
    agree: NDArray
    both: int


def _pairs(base: Samples, scan: Samples, pose: NDArray, scale: float) -> _Pairs:
    """Base points to their nearest scan points, and scan points to their nearest base points."""
    points = scale * base.points @ pose[:3, :3].T + pose[:3, 3]
    normals = base.normals @ pose[:3, :3].T
    there = scan.tree.query(points)[1]
    back = base.tree.query((scan.points - pose[:3, 3]) @ pose[:3, :3] / scale)[1]
    return _Pairs(
        moving=np.concatenate([points, points[back]]),
        target=np.concatenate([scan.points[there], scan.points]),
        normal=np.concatenate([scan.normals[there], scan.normals]),
        agree=np.concatenate(
            [np.einsum("nk,nk->n", normals, scan.normals[there]), np.einsum("nk,nk->n", normals[back], scan.normals)]
        ),
        both=len(points),
    )


def _weights(pairs: _Pairs, kept_share: float, reach_m: float) -> NDArray:
    distance = np.linalg.norm(pairs.moving - pairs.target, axis=1)
    weight = np.maximum(pairs.agree, 0.0) / (1.0 + (distance / reach_m) ** 2) ** 2
    for half in (slice(None, pairs.both), slice(pairs.both, None)):
        weight[half] *= distance[half] <= np.quantile(distance[half], kept_share)
    return weight


def _step(pairs: _Pairs, weight: NDArray, pose: NDArray, free_scale: bool) -> tuple[NDArray, float]:
    """Weighted point-to-plane with a tenth of point-to-point, which keeps it from sliding off where all is smooth."""
    centre = (weight @ pairs.target) / max(weight.sum(), 1e-12)
    arm, gap = pairs.moving - centre, pairs.target - pairs.moving
    rows = np.concatenate([np.cross(arm, pairs.normal), pairs.normal, np.einsum("nk,nk->n", arm, pairs.normal)[:, None]], axis=1)
    rows[:, [0, 1, 2, 6]] *= 10.0
    right = np.einsum("nk,nk->n", gap, pairs.normal)
    matrix, vector = (rows * weight[:, None]).T @ rows, (rows * weight[:, None]).T @ right
    for axis in range(3):
        unit = np.zeros(3)
        unit[axis] = 1.0
        row = np.concatenate([np.cross(arm, unit) * 10.0, np.tile(unit, (len(arm), 1)), arm[:, [axis]] * 10.0], axis=1)
        matrix += 0.1 * (row * weight[:, None]).T @ row
        vector += 0.1 * (row * weight[:, None]).T @ gap[:, axis]
    size = 7 if free_scale else 6
    solution = np.zeros(7)
    solution[:size] = np.linalg.solve(matrix[:size, :size] + 1e-9 * np.eye(size), vector[:size])
    turn = from_vector(np.concatenate([10.0 * solution[:3], np.zeros(3)]))[:3, :3]
    growth = float(np.clip(1.0 + 10.0 * solution[6], 0.9, 1.1))
    rotation = turn @ pose[:3, :3]
    translation = centre + growth * turn @ (pose[:3, 3] - centre) + solution[3:6]
    return rigid(rotation, translation), growth


def _score(pairs: _Pairs, kept_share: float) -> float:
    """Mean over the nearest share both ways of distance plus 10 mm times one minus the normals' cosine."""
    distance = 1e3 * np.linalg.norm(pairs.moving - pairs.target, axis=1) + 10.0 * (1.0 - pairs.agree)
    halves = [np.sort(distance[: pairs.both]), np.sort(distance[pairs.both :])]
    return float(np.mean([half[: int(kept_share * len(half))].mean() for half in halves]))


def skin_triangles(triangles: NDArray, hidden: NDArray[np.bool_]) -> NDArray:
    """Triangles (k, 3) with no hidden vertex (n,)."""
    return triangles[~hidden[triangles].any(1)]
