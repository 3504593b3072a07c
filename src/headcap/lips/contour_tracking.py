"""The model-based baseline: a person's own lip blendshapes, aligned with detected contours (lip paper, section 6).

"Comparison to Model-based Lip Tracking": the base tracker's shapes and those of expressive lips, taken from the rig's
reconstructions, are fitted to the contours of each frame. The inner contour is an occluding one: which of the lips' places it is
depends on their shape, so that finding these places and solving for the shape take turns.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial import cKDTree

from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.geometry.transforms import fit_similarity, transform
from headcap.lips.correction import CanonicalMeshes, canonical_meshes
from headcap.lips.features import LipContours
from headcap.lips.mesh_contours import MeshContours, Opening
from headcap.lips.mouth import Mouth
from headcap.meshes.deformation_transfer import DeformationTransfer

EXPRESSIVE_SHAPES = 30
"""The paper's number, whose shapes a user selected."""
_BLOCK = 64
_HALVINGS = 4
_EVERY_VERTEX = 4
"""Of the mask, by which lips are told apart: they are smooth."""


class ContourTrackingSettings(BaseModel):
    """Fitting lips to contours; the paper gives no numbers."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    rounds: int = Field(12, ge=1, description="Most turns of choosing the inner contour's places and solving")
    settled_share: float = Field(1e-3, gt=0, lt=1, description="A turn that takes less off the sum is the last")
    noise_px: float = Field(1.0, gt=0, description="Standard deviation of a contour's place in the picture")
    independent: float = Field(20.0, gt=0, description="Places of a contour that err on their own; neighbours err together")
    base_deviation: float = Field(
        0.3, gt=0, description="How far the base tracker's coefficients are off, in standard deviations of its shapes"
    )
    lip_deviation: float = Field(
        0.3,
        gt=0,
        description="How far the lips are off, in whole lip shapes: each of b shapes has this over the root of b, so that all of "
        "them together move lips as far whatever their number",
    )


@dataclass(frozen=True, eq=False)
class ContourFit:
    """One frame's lips."""

    mesh: NDArray[np.float64]
    """(n, 3) metres, canonical."""
    weights: NDArray[np.float64]
    """(p,) of the shapes, beside the base-tracked mesh."""
    distances_px: NDArray[np.float64]
    """(turns + 1,) rms distance of outer border and inner rims to their contours, at the start and after each turn."""


class ContourTracker:
    """Fits shapes of one topology (p, n, 3) to contours in one camera's pictures.

    Minimises, beside a base-tracked mesh C_f and for weights x,
        N / |O| sum_O (d_i / noise)^2 + N / |I| sum_I (d_i / noise)^2 + sum_j (x_j / deviation_j)^2,
    d_i the distance, across the contour, of a place on the lips' outer border (O, fixed on the skin) or on the rims that a viewer
    sees (I) of C_f + sum_j x_j S_j, N the number of places that err on their own. By Gauss-Newton steps that are halved until the
    sum falls, with the rims chosen anew for every shape.
    """

    def __init__(
        self,
        shapes: NDArray,
        deviations: NDArray,
        see: MeshContours,
        camera: Camera,
        settings: ContourTrackingSettings | None = None,
    ) -> None:
        """Shapes (p, n, 3) metres in the canonical frame and standard deviations (p,) of their weights.

        Raises `InputError` where the two do not go together.
        """
        if shapes.ndim != 3 or shapes.shape[2] != 3 or deviations.shape != shapes.shape[:1] or not (deviations > 0).all():
            raise InputError(
                f"shapes {shapes.shape} and deviations {deviations.shape}",
                expected="(p, n, 3) and (p,) above zero",
                remedy="Give one deviation per shape.",
            )
        self.settings, self.camera = settings or ContourTrackingSettings(), camera
        self.shapes, self.precision = shapes, 1.0 / np.asarray(deviations, np.float64) ** 2
        self._moved = np.flatnonzero(np.abs(shapes).max(axis=(0, 2)) > 0)
        self._motion = np.ascontiguousarray(shapes[:, self._moved]).reshape(len(shapes), -1)
        self._used, self._see = see.vertices, see.compact()
        self._slopes = np.ascontiguousarray(np.moveaxis(shapes[:, self._used], 0, 2), np.float64)
        border = self._see.outline
        self._border = np.stack([border, border], axis=1), np.zeros(len(border))

    def fit(self, mesh: NDArray, world_from_canonical: NDArray, contours: LipContours) -> ContourFit:
        """One frame: a base-tracked canonical mesh (n, 3), where it is (4, 4), and contours of the camera's picture."""
        problem = _Problem(self, np.asarray(mesh, np.float64)[self._used], world_from_canonical, contours)
        weights = np.zeros(len(self.shapes))
        here = problem.at(weights)
        distances = [here.distance_px]
        for _ in range(self.settings.rounds):
            step = here.step(self.precision, weights)
            found = problem.along(weights, step, here)
            if found is None:
                break
            gain = 1 - found[1].energy / here.energy
            weights, here = found
            distances.append(here.distance_px)
            if gain < self.settings.settled_share:
                break
        out = np.array(mesh, np.float64)
        out[self._moved] += (weights @ self._motion).reshape(-1, 3)
        return ContourFit(out, weights, np.array(distances))

    def track(self, base: CanonicalMeshes, contours: Sequence[LipContours | None]) -> Iterator[ContourFit | None]:
        """Frame by frame; None where a frame was not tracked or shows no contours, which is not made up.

        Raises `InputError` for another number of frames or topology.
        """
        if len(contours) != len(base.meshes) or base.meshes.shape[1:] != self.shapes.shape[1:]:
            raise InputError(
                f"contours of {len(contours)} frames, meshes {base.meshes.shape}",
                expected=f"as many, of {self.shapes.shape[1:]}",
                remedy="Give None for frames without contours, and meshes of the shapes' topology.",
            )
        for mesh, placement, found in zip(base.meshes, base.world_from_canonical, contours, strict=True):
            known = found is not None and bool(np.isfinite(mesh).all() and np.isfinite(placement).all())
            yield self.fit(mesh, placement, found) if known else None


def person_tracker(
    base_shapes: NDArray, lip_shapes: NDArray, see: MeshContours, camera: Camera, settings: ContourTrackingSettings | None = None
) -> ContourTracker:
    """A tracker with a base tracker's shapes (e, n, 3) and a person's lip blendshapes (b, n, 3) appended.

    The base's are in standard deviations, as `features.tracking_shapes` gives a head model's.
    """
    settings = settings or ContourTrackingSettings()
    lip_deviation = settings.lip_deviation / np.sqrt(max(len(lip_shapes), 1))
    deviations = np.repeat([settings.base_deviation, lip_deviation], [len(base_shapes), len(lip_shapes)])
    return ContourTracker(np.concatenate([base_shapes, lip_shapes]), deviations, see, camera, settings)


def expressive_shapes(
    takes: Sequence[NDArray], neutral: NDArray, mouth: Mouth, count: int = EXPRESSIVE_SHAPES
) -> NDArray[np.float64]:
    """(b, n, 3) canonical meshes with the most different lips of a person's training takes (f, n, 3), memory maps or arrays.

    Farthest-point sampling (Gonzalez 1985) of the lips' displacements from rest (n, 3), each shape the farthest from those before
    it and from rest: what the paper has a user select. Frames that are not finite are passed over. Fewer than `count` where takes
    have fewer frames. Raises `InputError` where no frame was tracked.
    """
    sampled = np.unique(mouth.triangles[mouth.layer[mouth.fade == 1.0]])[::_EVERY_VERTEX]
    moved = [
        (meshes[:, sampled] - neutral[sampled]).reshape(len(meshes), -1).astype(np.float32)
        for take in takes
        for meshes in _canonical_blocks(take, neutral, mouth)
    ]
    moved = np.concatenate([*moved, np.zeros((0, 3 * len(sampled)), np.float32)])
    known = np.flatnonzero(np.isfinite(moved).all(axis=1))
    if not len(known):
        raise InputError(
            f"no tracked frame in {len(takes)} training takes", expected="one at least", remedy="Give takes that were tracked."
        )
    index = [(take, frame) for take in takes for frame in range(len(take))]
    chosen = [index[known[k]] for k in _farthest(moved[known], count)]
    return np.concatenate([canonical_meshes(take[frame][None], neutral, mouth.steady).meshes for take, frame in chosen])


def lip_blendshapes(shapes: NDArray, neutral: NDArray, base_neutral: NDArray, mouth: Mouth) -> NDArray[np.float64]:
    """(b, n, 3) displacements of a base-tracked neutral head (n, 3): shapes (b, n, 3) of the true neutral one (n, 3) on it.

    By deformation transfer (Sumner & Popovic 2004), placed by the skin above the mouth that holds still; at the rim of the
    mouth's mask they fade to nothing as corrections do, so that they shape lips alone. The true head and its shapes share any
    frame and size.
    """
    anchors = np.zeros(len(neutral), bool)
    anchors[mouth.steady] = True
    placement, scale = fit_similarity(neutral[mouth.steady], base_neutral[mouth.steady])
    source, shapes = (transform(placement, scale * meshes) for meshes in (neutral, shapes))
    moved = DeformationTransfer(source, base_neutral, mouth.triangles, anchors)(shapes) - base_neutral
    return moved * _vertex_fade(np.asarray(base_neutral, np.float64), mouth)[:, None]


def _canonical_blocks(take: NDArray, neutral: NDArray, mouth: Mouth) -> Iterator[NDArray[np.float64]]:
    for first in range(0, len(take), _BLOCK):
        yield canonical_meshes(take[first : first + _BLOCK], neutral, mouth.steady).meshes


def _farthest(points: NDArray, count: int) -> list[int]:
    """Rows of points (f, k), each the farthest from those before it and from the origin."""
    nearest, chosen = np.einsum("fk,fk->f", points, points), []
    while len(chosen) < min(count, len(points)) and (nearest.max() > 0 or not chosen):
        chosen.append(int(nearest.argmax()))
        away = points - points[chosen[-1]]
        nearest = np.minimum(nearest, np.einsum("fk,fk->f", away, away))
    return chosen


def _vertex_fade(vertices: NDArray, mouth: Mouth) -> NDArray[np.float64]:
    """(n,) of a head (n, 3): the mask's fade; what gives way beyond it goes with the nearest of the mask, 0 elsewhere.

    Behind the lips that is the lips themselves, on the collar the mask's rim.
    """
    inside, total = mouth.triangles[mouth.layer], np.zeros(len(vertices))
    np.add.at(total, inside, mouth.fade[:, None])
    fade = total / np.maximum(np.bincount(inside.ravel(), minlength=len(vertices)), 1)
    beyond = np.setdiff1d(mouth.triangles[mouth.patch], inside)
    fade[beyond] = fade[mouth.vertices][cKDTree(vertices[mouth.vertices]).query(vertices[beyond])[1]]
    return fade


class _Problem:
    """One frame: the used vertices as they were tracked, and what the picture shows."""

    def __init__(self, tracker: ContourTracker, tracked: NDArray, world_from_canonical: NDArray, contours: LipContours) -> None:
        self.tracker, self.tracked, self.contours = tracker, tracked, contours
        self.rotation, self.shift = world_from_canonical[:3, :3], world_from_canonical[:3, 3]

    def at(self, weights: NDArray) -> _State:
        """The lips of some weights, with the rims that are seen then."""
        tracker = self.tracker
        canonical = self.tracked + tracker._slopes @ weights
        world = canonical @ self.rotation.T + self.shift
        pixels, slopes = tracker.camera.project_with_jacobian(world)
        depth = world @ tracker.camera.camera_from_world[2, :3] + tracker.camera.camera_from_world[2, 3]
        outer = _nearest(pixels[tracker._see.outline], self.contours.outer)
        inner = _seen_rims(tracker._see.opening(pixels, depth), self.contours.inner)
        return _State(self, weights, pixels, slopes @ self.rotation, (_Pulls(*tracker._border, *outer), inner))

    def along(self, weights: NDArray, step: NDArray, here: _State) -> tuple[NDArray, _State] | None:
        """Weights and lips a step on, halved until the sum falls; None where it does not."""
        for _ in range(1 + _HALVINGS):
            there = self.at(weights + step)
            if there.energy < here.energy:
                return weights + step, there
            step = 0.5 * step
        return None


@dataclass(frozen=True, eq=False)
class _Pulls:
    """Places on edges, drawn to lines in the picture."""

    edges: NDArray[np.int64]
    """(k, 2)"""
    share: NDArray[np.float64]
    targets: NDArray[np.float64]
    """(k, 2) pixels on the contour."""
    normals: NDArray[np.float64]
    """(k, 2) unit, across it."""

    def distances(self, pixels: NDArray) -> NDArray[np.float64]:
        """(k,) pixels across the contour, of the vertices' pixels (u, 2)."""
        start, end = pixels[self.edges[:, 0]], pixels[self.edges[:, 1]]
        return np.einsum("ki,ki->k", self.normals, start + self.share[:, None] * (end - start) - self.targets)


class _State:
    """The lips of some weights against the contours."""

    def __init__(self, problem: _Problem, weights: NDArray, pixels: NDArray, slopes: NDArray, pulls: tuple[_Pulls, ...]) -> None:
        self.slopes, self.pulls, self.tracker = slopes, pulls, problem.tracker
        self.residuals = [part.distances(pixels) for part in pulls]
        precision = problem.tracker.precision
        self.energy = sum(w * float(r @ r) for w, r in zip(self._weights(), self.residuals, strict=True))
        self.energy += float(precision @ weights**2)

    @property
    def distance_px(self) -> float:
        """Root of the mean over both contours' mean squares: neither counts more for having more places."""
        return float(np.sqrt(np.mean([np.mean(part**2) for part in self.residuals if len(part)])))

    def step(self, precision: NDArray, weights: NDArray) -> NDArray[np.float64]:
        """Gauss-Newton step (p,)."""
        matrix, right = np.diag(precision), -precision * weights
        for weight, part, residual in zip(self._weights(), self.pulls, self.residuals, strict=True):
            rows = self._rows(part)
            matrix, right = matrix + weight * (rows.T @ rows), right - weight * (rows.T @ residual)
        return cho_solve(cho_factor(matrix), right)

    def _weights(self) -> list[float]:
        settings = self.tracker.settings
        return [settings.independent / max(len(part), 1) / settings.noise_px**2 for part in self.residuals]

    def _rows(self, part: _Pulls) -> NDArray[np.float64]:
        """(k, p) derivative of the distances by the weights; rims and contour lines stay where they are."""
        total = np.zeros((len(part.edges), len(self.tracker.shapes)))
        for end, share in ((0, 1 - part.share), (1, part.share)):
            vertex = part.edges[:, end]
            across = share[:, None] * np.einsum("ki,kij->kj", part.normals, self.slopes[vertex])
            total += np.einsum("kj,kjp->kp", across, self.tracker._slopes[vertex])
        return total


def _nearest(points: NDArray, ring: NDArray) -> tuple[NDArray, NDArray]:
    """Nearest places (k, 2) on a ring (j, 2) of points (k, 2), and unit normals (k, 2) of its sides there."""
    side = np.roll(ring, -1, axis=0) - ring
    length = np.maximum(np.linalg.norm(side, axis=1), 1e-12)
    share = np.clip(np.einsum("kji,ji->kj", points[:, None] - ring, side) / length**2, 0, 1)
    places = ring + share[..., None] * side
    best = ((places - points[:, None]) ** 2).sum(axis=2).argmin(axis=1)
    normals = np.stack([-side[:, 1], side[:, 0]], axis=1) / length[:, None]
    return places[np.arange(len(points)), best], normals[best]


def _seen_rims(opening: Opening, ring: NDArray) -> _Pulls:
    """The rims that a viewer sees, drawn to the upper and the lower side of a contour's ring (j, 2) straight above or below."""
    flat = np.stack([(ring - opening.right) @ opening.along, (ring - opening.right) @ opening.down], axis=1)
    side = np.roll(flat, -1, axis=0) - flat
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (opening.stations - flat[:, :1]) / side[:, :1]
    crossed = (share >= 0) & (share <= 1)
    height = np.where(crossed, flat[:, 1:] + np.where(crossed, share, 0.0) * side[:, 1:], np.nan)
    met = crossed.any(axis=0)
    parts = []
    for rim, hidden, sign in (
        (opening.upper, ~opening.upper_in_front, 1.0),
        (opening.lower, opening.upper_in_front, -1.0),
    ):
        best = np.where(crossed, sign * height, np.inf).argmin(axis=0)
        kept = np.flatnonzero(met & np.isfinite(rim.height) & ~(opening.overlap & hidden))
        down = height[best, np.arange(len(best))][kept]
        targets = opening.right + opening.stations[kept, None] * opening.along + down[:, None] * opening.down
        normal = np.stack([-side[best[kept], 1], side[best[kept], 0]], axis=1)
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        parts.append((rim.edges[kept], rim.share[kept], targets, normal @ np.stack([opening.along, opening.down])))
    return _Pulls(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
