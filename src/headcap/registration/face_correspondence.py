"""Dense correspondence between a base tracker's topology and that of a rig's reconstructions (lip paper, section 4.1).

Once per subject, between two neutral faces, best with the mouth slightly open so that the lips' rims are seen: both sequences
keep their own correspondence over time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy import sparse
from scipy.spatial import cKDTree

from headcap.artifacts import load_arrays, save_arrays
from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.geometry.transforms import fit_similarity, transform
from headcap.meshes.closest_point import Surface, barycentric_weights
from headcap.meshes.laplacian import Factor
from headcap.meshes.normals import triangle_normals, vertex_normals
from headcap.meshes.rasteriser import rasterise
from headcap.meshes.topology import boundary_edges, submesh
from headcap.registration.nonrigid import Lines, NonrigidSettings, Plate, Target, fit_stage
from headcap.registration.scan import Scan

KIND, SCHEMA = "lip_correspondence", 1
_LEAST_COSINE = 0.3
"""Lips that touch face each other: a nearest place whose normal differs more belongs to the other one."""
_CANDIDATES = 64
"""Triangles nearby that are searched for one that faces the right way."""
_LEAST_LANDMARKS = 4
_ON_EDGE = 1e-6
"""Share of a corner below which a point lies on the edge opposite to it."""
_ON_SKIN_M = 5e-3
"""Landmarks farther from the skin (ears, crown) place the face and bend nothing."""
_SKIN, _NO_SKIN = ("face", "lips_outer", "lips_inner"), ("eyes", "mouth_interior")
_ARRAYS = ("triangle", "local", "matched", "of_triangle", "rig_triangles", "registered")


class FaceCorrespondenceSettings(BaseModel):
    """Bending a base tracker's face onto a rig's; the paper gives no numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    landmark_length_mm: float = Field(60.0, gt=0, description="Smoothing length of the first step, which landmarks alone drive")
    lengths_mm: tuple[float, ...] = Field(
        (30.0, 15.0, 8.0, 4.0, 2.0),
        min_length=1,
        description="Smoothing lengths of the second step, in which nearest places pull",
    )
    rounds: int = Field(2, ge=1, description="Rounds of nearest places per length")
    landmark_weight: float = Field(
        15.0,
        gt=0,
        description="Of landmarks beside nearest places, which know no sliding: between two head models with 25 landmarks the "
        "lips' border comes to lie 0.6 mm off (median), without this weight 1.0 mm",
    )
    reach_mm: float = Field(3.0, gt=0, description="Farther from the rig's surface a vertex has no counterpart there")


@dataclass(frozen=True, eq=False)
class NeutralFace:
    """A neutral face in one of the two topologies."""

    vertices: NDArray[np.float64]
    """(n, 3) metres."""
    triangles: NDArray[np.int32]
    """(m, 3)"""
    landmarks: dict[str, NDArray[np.float64]]
    """Points (3,) on its surface by name."""
    skin: NDArray[np.bool_] = field(default=None)
    """(n,) what of it the other face may have too; all by default. Eyes and the mouth's inside do not belong to it."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", np.ascontiguousarray(self.vertices, np.float64))
        if self.skin is None:
            object.__setattr__(self, "skin", np.ones(len(self.vertices), bool))

    @classmethod
    def of(
        cls,
        vertices: NDArray,
        triangles: NDArray[np.int32],
        landmarks: Mapping[str, int],
        regions: Mapping[str, NDArray[np.bool_]],
    ) -> NeutralFace:
        """Vertices (n, 3) metres of a topology that names vertices and regions (n,): its skin is `face_skin`'s."""
        vertices = np.asarray(vertices, np.float64)
        points = {name: vertices[vertex] for name, vertex in landmarks.items()}
        return cls(vertices, triangles, points, face_skin(regions))


@dataclass(frozen=True, eq=False)
class Correspondence:
    """Where each vertex and triangle of a base topology (n, m) lies on a rig's topology (N, M)."""

    triangle: NDArray[np.int64]
    """(n,) the rig's triangle that carries a vertex."""
    local: NDArray[np.float64]
    """(n, 3) its place there: shares of the two edges, and of the normal n / sqrt(|n|), which is zero where it is matched."""
    matched: NDArray[np.bool_]
    """(n,) true where the rig has a surface; others move with the nearest triangle of all."""
    of_triangle: NDArray[np.int64]
    """(m,) the rig's triangle that corresponds to a base triangle."""
    rig_triangles: NDArray[np.int32]
    """(M, 3)"""
    registered: NDArray[np.float64]
    """(n, 3) the base's neutral face on the rig's, in its frame, metres."""
    figures: dict[str, float] = field(default_factory=dict)
    """Median and 95th percentile distance of the registered skin to the rig's surface, mm; share of it that is matched."""

    def carry(self, meshes: NDArray, vertices: NDArray | slice = slice(None)) -> NDArray[np.float64]:
        """Base vertices (..., n, 3), or some of them, where a rig's meshes (..., N, 3) have gone.

        Raises `InputError` for meshes of another topology.
        """
        meshes = np.asarray(meshes)
        if meshes.ndim < 2 or meshes.shape[-1] != 3 or meshes.shape[-2] <= int(self.rig_triangles.max()):
            raise InputError(
                f"meshes of {meshes.shape}",
                expected=f"(..., N, 3) with N above {int(self.rig_triangles.max())}",
                remedy="Give meshes of the rig's topology that the correspondence was found with.",
            )
        corners = self.rig_triangles[self.triangle[vertices]]
        flat = meshes.reshape(-1, *meshes.shape[-2:])
        out = np.stack([_placed(mesh.astype(np.float64), corners, self.local[vertices]) for mesh in flat])
        return out.reshape(*meshes.shape[:-2], *out.shape[1:])

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.lip_correspondence/1`."""
        save_arrays(path, KIND, SCHEMA, {name: getattr(self, name) for name in _ARRAYS}, {"figures": self.figures})

    @classmethod
    def load(cls, path: Path | str) -> Correspondence:
        """Read what `save` wrote; raises `ArtifactError`."""
        arrays, meta = load_arrays(path, KIND, SCHEMA)
        return cls(**arrays, figures=meta["figures"])


def face_skin(regions: Mapping[str, NDArray[np.bool_]]) -> NDArray[np.bool_] | None:
    """(n,) of a head model's regions (n,): face and lips, without eyes and the mouth's inside; None where face or lips lack."""
    if not all(name in regions for name in _SKIN):
        return None
    inside = [regions[name] for name in _NO_SKIN if name in regions]
    return np.any([regions[name] for name in _SKIN], axis=0) & ~np.any(inside, axis=0)


def same_topology(neutral: NDArray, triangles: NDArray) -> Correspondence:
    """The identity, for a rig whose meshes (n, 3), (m, 3) are in the base's topology already."""
    triangles = np.ascontiguousarray(triangles, np.int32)
    first = np.zeros(len(neutral), np.int64)
    # any triangle of a vertex serves; one that is in none stays at a corner of the first and must not be asked for
    first[triangles.ravel()] = np.repeat(np.arange(len(triangles)), 3)
    used = np.zeros(len(neutral), bool)
    used[triangles.ravel()] = True
    place = (triangles[first] == np.arange(len(neutral))[:, None]).astype(float)
    local = np.stack([place[:, 1], place[:, 2], np.zeros(len(neutral))], axis=1)
    figures = {"distance_median_mm": 0.0, "distance_p95_mm": 0.0, "matched_share": 1.0}
    return Correspondence(first, local, used, np.arange(len(triangles)), triangles, np.asarray(neutral, np.float64), figures)


def correspond(base: NeutralFace, rig: NeutralFace, settings: FaceCorrespondenceSettings | None = None) -> Correspondence:
    """Triangle-to-triangle correspondence by Laplacian surface registration (section 4.1).

    1. A similarity on the landmarks that both faces name; 2. Laplacian deformation of the base's face with landmarks as
    constraints; 3. nearest places on the rig's surface whose normals agree, and a second Laplacian registration towards them,
    repeated with less and less stiffness (the paper does it once; `registration.nonrigid` says how); 4. each base triangle
    belongs to the rig's triangle nearest to its middle. Raises `InputError` for fewer than four landmarks in common, and where
    less than half of the skin finds a counterpart.
    """
    settings = settings or FaceCorrespondenceSettings()
    own, theirs = _common_landmarks(base, rig)
    placement, scale = fit_similarity(own, theirs)
    placed = transform(placement, scale * base.vertices)
    lines = _landmark_lines(placed, base.skin, transform(placement, scale * own), theirs)
    triangles, used = submesh(base.triangles, base.skin[base.triangles].all(axis=1))
    number = np.full(len(placed), -1)
    number[used] = np.arange(len(used))
    lines = Lines(number[lines.vertices], lines.targets, alone=True)
    plate = Plate(placed[used], triangles)
    bent = _by_landmarks(plate, lines, settings)
    bent = _by_nearest(plate, bent, lines, rig, settings)
    whole = _carried_along(placed, used, bent)
    return _tied(base, whole, rig, settings)


def landmark_points(camera: Camera, pixels: NDArray, vertices: NDArray, triangles: NDArray) -> NDArray[np.float64]:
    """Points (k, 3) where the rays of a picture's landmarks (k, 2) first meet a mesh (n, 3), (m, 3); NaN where they miss.

    Section 4.1: landmarks that a detector found in the one picture that both reconstructions share, cast back onto each.
    """
    pixels = np.asarray(pixels, np.float64)
    raster, out = rasterise(camera, vertices, triangles), np.full((len(pixels), 3), np.nan)
    column, row = np.rint(np.nan_to_num(pixels, nan=-9.0)).astype(np.int64).T
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    hit = np.full(len(pixels), -1)
    hit[inside] = raster.triangle[row[inside], column[inside]]
    seen = np.flatnonzero(hit >= 0)
    rays, corners = camera.rays(pixels[seen]), np.asarray(vertices, np.float64)[triangles[hit[seen]]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # the plane of the triangle at the nearest pixel: half a pixel beyond its edge at most
    depth = np.einsum("ki,ki->k", normals, corners[:, 0] - camera.centre) / np.einsum("ki,ki->k", normals, rays)
    out[seen] = camera.centre + depth[:, None] * rays
    return out


def _common_landmarks(base: NeutralFace, rig: NeutralFace) -> tuple[NDArray, NDArray]:
    names = [name for name in base.landmarks if name in rig.landmarks]
    pairs = [(np.asarray(base.landmarks[name], float), np.asarray(rig.landmarks[name], float)) for name in names]
    pairs = [pair for pair in pairs if np.isfinite(pair).all()]
    if len(pairs) < _LEAST_LANDMARKS:
        raise InputError(
            f"{len(pairs)} landmarks that both faces have",
            expected=f"{_LEAST_LANDMARKS} at least",
            remedy="Name the same places on both faces: corners of eyes and mouth, tip of the nose, chin.",
        )
    own, theirs = (np.array(points) for points in zip(*pairs, strict=True))
    return own, theirs


def _landmark_lines(placed: NDArray, skin: NDArray, own: NDArray, theirs: NDArray) -> Lines:
    """The skin's vertices nearest to the base's landmarks, and where they belong: as far from the rig's as from the base's."""
    candidates = np.flatnonzero(skin)
    away, nearest = cKDTree(placed[candidates]).query(own)
    vertices, on_skin = candidates[nearest], away <= _ON_SKIN_M
    return Lines(vertices[on_skin], (theirs + placed[vertices] - own)[on_skin], alone=True)


def _by_landmarks(plate: Plate, lines: Lines, settings: FaceCorrespondenceSettings) -> NDArray:
    """The first Laplacian step."""
    length, share = 1e-3 * settings.landmark_length_mm, NonrigidSettings().membrane
    pull = np.zeros(len(plate.rest))
    pull[lines.vertices] = settings.landmark_weight * lines.area(plate, length)
    targets = np.zeros_like(plate.rest)
    targets[lines.vertices] = lines.targets
    factor = Factor(plate.matrix(length, share) + sparse.diags_array(pull))
    bent = plate.rest
    for _ in range(1 + settings.rounds):
        bent = factor.solve(plate.right(plate.rotations(bent), length, share) + pull[:, None] * targets)
    return bent


def _by_nearest(plate: Plate, bent: NDArray, lines: Lines, rig: NeutralFace, settings: FaceCorrespondenceSettings) -> NDArray:
    """The second Laplacian step."""
    stages = NonrigidSettings(
        lengths_mm=settings.lengths_mm, rounds=settings.rounds, line_weight=settings.landmark_weight, reach_mm=(15.0, 3.0)
    )
    triangles, used = submesh(rig.triangles, rig.skin[rig.triangles].all(axis=1))
    target = Target(Scan(rig.vertices[used], triangles), stages)
    pulled = np.ones(len(bent), bool)
    for stage in range(len(settings.lengths_mm)):
        bent = fit_stage(plate, bent, pulled, target, lines, stage, stages)
    return bent


def _carried_along(placed: NDArray, used: NDArray, bent: NDArray) -> NDArray:
    """The whole base: what is no skin is shifted as its nearest skin was."""
    out = placed + (bent - placed[used])[cKDTree(placed[used]).query(placed)[1]]
    out[used] = bent
    return out


def _tied(base: NeutralFace, bent: NDArray, rig: NeutralFace, settings: FaceCorrespondenceSettings) -> Correspondence:
    skin = np.flatnonzero(rig.skin[rig.triangles].all(axis=1))
    corners = rig.triangles[skin]
    triangle, points, distance = _nearest_agreeing(bent, vertex_normals(bent, base.triangles), rig.vertices, corners)
    # what hangs over the rim of the rig's skin, as lips behind the line between them, would be drawn together to a line there
    matched = base.skin & (distance <= 1e-3 * settings.reach_mm) & ~_on_rim(rig.vertices, corners, triangle, points)
    share = float(matched[base.skin].mean())
    if share < 0.5:
        raise InputError(
            f"{100 * share:.0f} % of the base's skin within {settings.reach_mm:g} mm of the rig's",
            expected="half of it at least",
            remedy="Check the landmarks' names and sides, and that both faces are neutral and in metres.",
        )
    registered = np.where(matched[:, None], points, bent)
    frames = _frames(rig.vertices, corners[triangle])
    local = np.linalg.solve(frames, (registered - rig.vertices[corners[triangle, 0]])[..., None])[..., 0]
    local[matched, 2] = 0.0
    middles, normals = registered[base.triangles].mean(axis=1), triangle_normals(registered, base.triangles)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    of_triangle = _nearest_agreeing(middles, normals, rig.vertices, corners)[0]
    figures = {
        "distance_median_mm": 1e3 * float(np.median(distance[base.skin])),
        "distance_p95_mm": 1e3 * float(np.percentile(distance[base.skin], 95)),
        "matched_share": share,
    }
    return Correspondence(skin[triangle], local, matched, skin[of_triangle], rig.triangles, registered, figures)


def _on_rim(vertices: NDArray, triangles: NDArray, triangle: NDArray, points: NDArray) -> NDArray[np.bool_]:
    """(q,) points (q, 3) in their triangles (q,) of (m, 3) that lie on an edge that only one triangle has."""
    rim = np.zeros(len(vertices), bool)
    rim[boundary_edges(triangles).ravel()] = True
    shares = barycentric_weights(vertices[triangles[triangle]], points)
    return ((shares > _ON_EDGE) <= rim[triangles[triangle]]).all(axis=1)


def _nearest_agreeing(
    points: NDArray, normals: NDArray, vertices: NDArray, triangles: NDArray
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Triangles (q,), nearest points (q, 3) and distances (q,) on triangles (m, 3) that face as the normals (q, 3) do.

    The nearest of all triangles first; where it faces away, the nearest of those about it that agree, and infinitely far without.
    """
    unit = triangle_normals(vertices, triangles)
    unit /= np.maximum(np.linalg.norm(unit, axis=1, keepdims=True), 1e-30)
    found = Surface(vertices, triangles).closest(points)
    triangle, nearest, distance = found.triangle.astype(np.int64), found.points.copy(), found.distance.copy()
    away = np.flatnonzero(np.einsum("qi,qi->q", unit[triangle], normals) < _LEAST_COSINE)
    if len(away):
        corners = np.ascontiguousarray(vertices[triangles])
        count = min(_CANDIDATES, len(triangles))
        candidates = cKDTree(corners.mean(axis=1)).query(points[away], count)[1].reshape(len(away), count)
        agree = np.einsum("qci,qi->qc", unit[candidates], normals[away]) >= _LEAST_COSINE
        _search(np.ascontiguousarray(points[away]), corners, candidates, agree, away, triangle, nearest, distance)
    return triangle, nearest, distance


def _frames(vertices: NDArray, corners: NDArray) -> NDArray[np.float64]:
    """(q, 3, 3) two edges and n / sqrt(|n|) of triangles (q, 3), as columns (Sumner & Popovic 2004, eq. 1 to 3)."""
    a, b, c = (vertices[corners[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.sqrt(np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30))
    return np.stack([b - a, c - a, normal], axis=-1)


def _placed(mesh: NDArray, corners: NDArray, local: NDArray) -> NDArray[np.float64]:
    return mesh[corners[:, 0]] + np.einsum("qij,qj->qi", _frames(mesh, corners), local)


@njit(cache=True)
def _search(points, corners, candidates, agree, rows, triangle, nearest, distance):
    here = np.empty(3)
    for k in range(len(points)):
        best = np.inf
        for j in range(candidates.shape[1]):
            if not agree[k, j]:
                continue
            _closest_in_triangle(points[k], corners[candidates[k, j]], here)
            squared = ((here - points[k]) ** 2).sum()
            if squared < best:
                best = squared
                triangle[rows[k]] = candidates[k, j]
                nearest[rows[k]] = here
        distance[rows[k]] = np.sqrt(best)


@njit(cache=True)
def _closest_in_triangle(point, corners, out):
    """The point of a triangle (3, 3) nearest to another (Ericson 2005, section 5.1.5)."""
    a, b, c = corners[0], corners[1], corners[2]
    ab, ac = b - a, c - a
    d1, d2 = (ab * (point - a)).sum(), (ac * (point - a)).sum()
    d3, d4 = (ab * (point - b)).sum(), (ac * (point - b)).sum()
    d5, d6 = (ab * (point - c)).sum(), (ac * (point - c)).sum()
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    if d1 <= 0 and d2 <= 0:
        out[:] = a
    elif d3 >= 0 and d4 <= d3:
        out[:] = b
    elif d6 >= 0 and d5 <= d6:
        out[:] = c
    elif vc <= 0 and d1 >= 0 and d3 <= 0:
        out[:] = a + d1 / (d1 - d3) * ab
    elif vb <= 0 and d2 >= 0 and d6 <= 0:
        out[:] = a + d2 / (d2 - d6) * ac
    elif va <= 0 and d4 >= d3 and d5 >= d6:
        out[:] = b + (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b)
    else:
        out[:] = a + (vb * ab + vc * ac) / (va + vb + vc)
