"""What a correction is regressed from: the base tracker's shape and distances of lip contours (lip paper, section 5.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.geometry.transforms import invert
from headcap.heads import HeadCoefficients, HeadModel
from headcap.lips.correction import CanonicalMeshes
from headcap.lips.mouth import Mouth

SAMPLES = 20
"""Places on the outer border: the corners and nine on either lip between them."""
ACROSS = np.array([[0, 10], *([k, 20 - k] for k in range(1, 10))])
"""(10, 2) places between which the outer distances are taken: corner to corner, upper to lower lip."""
BETWEEN = np.arange(1, SAMPLES, 2)
"""(10,) places at which the distance from the outer to the inner contour is taken."""
DISTANCES = len(ACROSS) + len(BETWEEN)

_KEPT = 0.99
"""Share of the blendshapes' variance that the shape vector keeps (the paper)."""
_JAW_RAD = np.radians([12.0, 2.0, 1.0])
"""How far a jaw turns about its axes, standard deviations: what makes a joint comparable to blendshapes of unit variance."""
_ROUNDING = 1e-9
_EYES = (("eye_inner_left", "eye_outer_left"), ("eye_inner_right", "eye_outer_right"))


@dataclass(frozen=True, eq=False)
class LipContours:
    """What one picture shows of the lips, in pixels (integer coordinates are pixel centres)."""

    outer: NDArray[np.float64]
    """(k, 2) ring along the lips' border to the skin; the last point joins the first."""
    inner: NDArray[np.float64]
    """(j, 2) ring along the rims of the mouth's opening, where the lips end for the viewer; flat where the mouth is shut."""

    def __post_init__(self) -> None:
        for name in ("outer", "inner"):
            ring = np.ascontiguousarray(getattr(self, name), np.float64)
            if ring.ndim != 2 or ring.shape[1] != 2 or len(ring) < 3 or not np.isfinite(ring).all():
                raise InputError(
                    f"an {name} lip contour of {ring.shape}",
                    expected="(k, 2) finite pixels, three at least",
                    remedy="Leave out the contours of frames in which they were not found.",
                )
            object.__setattr__(self, name, ring)


@dataclass(frozen=True, eq=False)
class LipFeatures:
    """Features of f frames, NaN where a frame tells none."""

    shape: NDArray[np.float64]
    """psi (f, k): the base tracker's expression in principal components, rms displacement per inter-ocular distance."""
    distances: NDArray[np.float64]
    """(f, 20) in inter-ocular distances: ten across the outer contour, ten from the outer to the inner one."""

    def __len__(self) -> int:
        return len(self.shape)

    def anchored(self, rest: NDArray) -> LipFeatures:
        """With distances as they differ from the person's own at rest (20,), as eq. 1 anchors shapes at the neutral frame.

        Beyond the paper, whose distances are absolute: thick lips then look like open ones to a regressor of other people.
        """
        return LipFeatures(self.shape, self.distances - np.asarray(rest))

    def frames(self, chosen: slice | NDArray) -> LipFeatures:
        """Some frames."""
        return LipFeatures(self.shape[chosen], self.distances[chosen])


@dataclass(frozen=True, eq=False)
class FeatureSpace:
    """Where on a topology features are taken; what psi means."""

    vertices: NDArray[np.int64]
    """(v,) that the blendshapes move."""
    basis: NDArray[np.float32]
    """(k, v, 3) orthonormal principal components of the blendshapes."""
    border: NDArray[np.int64]
    """(20, 2) ends of the edges on which the samples of the outer border lie, from the right corner over the upper lip."""
    share: NDArray[np.float64]
    """(20,) how far along their edge."""
    eyes: NDArray[np.int64]
    """(2, e) vertices whose mean is the middle of the left and of the right eye."""

    @classmethod
    def of(cls, model: HeadModel, mouth: Mouth) -> FeatureSpace:
        """From a head model's blendshapes, its jaw's small turns among them, and the lips' border.

        Principal components about the neutral face, which is psi = 0, keeping 99 % of the variance (section 5.1). Raises
        `InputError` for models that name no corners of the eyes.
        """
        missing = [name for eye in _EYES for name in eye if name not in model.landmarks]
        if missing:
            raise InputError(
                f"{model.name} has no landmark {missing[0]}",
                expected="the corners of both eyes among the model's landmarks",
                remedy="Name their vertices in the model.",
            )
        shapes = tracking_shapes(model)
        vertices = np.flatnonzero(np.abs(shapes).max(axis=(0, 2)) > 1e-9)
        flat = shapes[:, vertices].reshape(len(shapes), -1)
        _, spread, components = np.linalg.svd(flat, full_matrices=False)
        energy = np.cumsum(spread**2)
        kept = int(np.searchsorted(energy, _KEPT * energy[-1])) + 1
        basis = components[:kept].reshape(kept, len(vertices), 3).astype(np.float32)
        border, share = _border_samples(np.asarray(model.vertices, np.float64), mouth)
        return cls(vertices, basis, border, share, np.array([[model.landmarks[name] for name in eye] for eye in _EYES]))

    def shape(self, base: NDArray, neutral: NDArray) -> NDArray[np.float64]:
        """psi (f, k) of canonical meshes (f, n, 3) with their neutral (n, 3)."""
        moved = (base[:, self.vertices] - neutral[self.vertices]).reshape(len(base), -1)
        unit = np.sqrt(len(self.vertices)) * self.eye_distance(neutral[None])[0]
        return moved @ self.basis.reshape(len(self.basis), -1).T / unit

    def samples(self, meshes: NDArray) -> NDArray[np.float64]:
        """Places (f, 20, 3) on the outer border of meshes (f, n, 3)."""
        start, end = meshes[:, self.border[:, 0]], meshes[:, self.border[:, 1]]
        return start + self.share[:, None] * (end - start)

    def eye_distance(self, points: NDArray) -> NDArray[np.float64]:
        """(f,) between the middles of the eyes of meshes (f, n, 3) or of their pixels (f, n, 2)."""
        left, right = (points[:, eye].mean(axis=1) for eye in self.eyes)
        return np.linalg.norm(left - right, axis=1)


def lip_features(
    space: FeatureSpace,
    base: CanonicalMeshes,
    neutral: NDArray,
    camera: Camera,
    contours: Sequence[LipContours | None],
    *,
    compensate_rotation: bool = True,
) -> LipFeatures:
    """Features of f frames: a base tracker's meshes with their neutral (n, 3), canonical, and contours in a camera's picture.

    From samples of the border as the base tracker sees it the contours are searched along the border's normal in the picture.
    With `compensate_rotation` (section 7) every found pixel is cast back onto a plane of the tracked head, parallel to its face
    through the sample, and distances are taken there, per inter-ocular distance of the head; without (section 5.1), in the
    picture, per inter-ocular distance as the picture shows it, and a turned head is another mouth. Frames without contours, or
    that were not tracked, give NaN distances. Raises `InputError` for another number of frames or topology.
    """
    if len(contours) != len(base.meshes) or base.meshes.shape[1:] != neutral.shape:
        raise InputError(
            f"contours of {len(contours)} frames, meshes {base.meshes.shape}, a neutral {neutral.shape}",
            expected="one of each per frame in one topology",
            remedy="Give None for frames without contours.",
        )
    distances = np.full((len(contours), DISTANCES), np.nan)
    tracked = np.isfinite(base.world_from_canonical).all(axis=(1, 2))
    told = np.flatnonzero([seen and found is not None for seen, found in zip(tracked, contours, strict=True)])
    if len(told):
        chosen = CanonicalMeshes(base.meshes[told], base.world_from_canonical[told])
        found = [contours[f] for f in told]
        distances[told] = _distances(space, chosen, neutral, camera, found, compensate_rotation)
    return LipFeatures(space.shape(base.meshes, neutral), distances)


def tracking_shapes(model: HeadModel) -> NDArray[np.float64]:
    """(e + 3, n, 3) metres: what a tracker fits, the expression basis and the jaw's small turns, each in standard deviations."""
    slopes = np.asarray(model.pose_derivative(HeadCoefficients()), np.float64)[..., -3:] * _JAW_RAD
    return np.concatenate([np.asarray(model.expression_basis, np.float64), np.moveaxis(slopes, -1, 0)])


def contour_points(samples: NDArray, contours: LipContours) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points (20, 2) of the outer and (10, 2) of the inner contour that belong to samples (20, 2) of a border, pixels.

    The outer contour nearest along the border's normal; from there inwards, the first of the inner contour. Where a normal
    misses a contour its nearest point is taken.
    """
    inward = _inward(samples)
    outer = _crossings(samples, inward, contours.outer, one_sided=False)
    return outer, _crossings(outer[BETWEEN], inward[BETWEEN], contours.inner, one_sided=True)


def _distances(
    space: FeatureSpace, base: CanonicalMeshes, neutral: NDArray, camera: Camera, contours: list[LipContours], flat: bool
) -> NDArray[np.float64]:
    world = base.world(base.meshes)
    samples = space.samples(base.meshes)
    pixels = camera.project(space.samples(world))[0]
    found = [np.concatenate(contour_points(at, rings)) for at, rings in zip(pixels, contours, strict=True)]
    points = np.array(found)
    if flat:
        depth = np.concatenate([samples[..., 2], samples[:, BETWEEN, 2]], axis=1)
        points = cast_back(points, depth, camera, base.world_from_canonical)
        unit = np.full(len(points), space.eye_distance(neutral[None])[0])
    else:
        unit = space.eye_distance(camera.project(world)[0])
    outer, inner = points[:, :SAMPLES], points[:, SAMPLES:]
    across = np.linalg.norm(outer[:, ACROSS[:, 0]] - outer[:, ACROSS[:, 1]], axis=2)
    between = np.linalg.norm(outer[:, BETWEEN] - inner, axis=2)
    return np.concatenate([across, between], axis=1) / unit[:, None]


def cast_back(pixels: NDArray, depth: NDArray, camera: Camera, world_from_canonical: NDArray) -> NDArray[np.float64]:
    """x, y (f, p, 2) in the head's frame of pixels (f, p, 2) at depth z (f, p) there."""
    canonical_from_world = invert(world_from_canonical)
    rays = camera.rays(pixels.reshape(-1, 2)).reshape(*pixels.shape[:-1], 3)
    rays = rays @ np.swapaxes(canonical_from_world[:, :3, :3], 1, 2)
    origin = canonical_from_world[:, :3, :3] @ camera.centre + canonical_from_world[:, :3, 3]
    length = (depth - origin[:, None, 2]) / rays[..., 2]
    return origin[:, None, :2] + length[..., None] * rays[..., :2]


def _inward(ring: NDArray) -> NDArray[np.float64]:
    """(k, 2) unit normals of a ring (k, 2), towards its inside."""
    along = np.roll(ring, -1, axis=0) - np.roll(ring, 1, axis=0)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    ahead = np.roll(ring, -1, axis=0)
    area = (ring[:, 0] * ahead[:, 1] - ring[:, 1] * ahead[:, 0]).sum()
    return normal if area > 0 else -normal


def _crossings(origins: NDArray, ways: NDArray, ring: NDArray, *, one_sided: bool) -> NDArray[np.float64]:
    """(k, 2) nearest crossings of lines from origins (k, 2) along unit ways (k, 2) with a ring (j, 2); behind counts unless
    `one_sided`; the ring's nearest point where there is none."""
    start, side = ring[None], (np.roll(ring, -1, axis=0) - ring)[None]
    to_start = start - origins[:, None]
    across = np.stack([-ways[:, 1], ways[:, 0]], axis=1)[:, None]
    height, rise = (to_start * across).sum(axis=2), (side * across).sum(axis=2)
    # a side along the way is never crossed: its share is not finite and counts as no hit
    with np.errstate(divide="ignore", invalid="ignore"):
        share = -height / rise
        along = ((to_start + share[..., None] * side) * ways[:, None]).sum(axis=2)
    # a crossing at a corner of the ring must not fall between its two sides by a rounding error
    hit = (share >= -_ROUNDING) & (share <= 1 + _ROUNDING) & np.isfinite(share) & ((along >= -_ROUNDING) | (not one_sided))
    reach = np.where(hit, np.abs(along), np.inf)
    best = reach.argmin(axis=1)
    rows = np.arange(len(origins))
    found = origins + along[rows, best][:, None] * ways
    missed = ~np.isfinite(reach[rows, best])
    if missed.any():
        found[missed] = _nearest(origins[missed], start, side)
    return found


def _nearest(origins: NDArray, start: NDArray, side: NDArray) -> NDArray[np.float64]:
    share = ((origins[:, None] - start) * side).sum(axis=2) / np.maximum((side**2).sum(axis=2), 1e-30)
    points = start + np.clip(share, 0, 1)[..., None] * side
    best = ((points - origins[:, None]) ** 2).sum(axis=2).argmin(axis=1)
    return points[np.arange(len(origins)), best]


def _border_samples(vertices: NDArray, mouth: Mouth) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Edges (20, 2) and shares (20,) of places that part either lip's border into ten equal lengths."""
    ring = np.append(mouth.outline, mouth.outline[0])
    half = SAMPLES // 2
    edges, shares = [], []
    for part in (ring[: mouth.left + 1], ring[mouth.left :]):
        run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(vertices[part], axis=0), axis=1))])
        wanted = np.arange(half) / half * run[-1]
        at = np.clip(np.searchsorted(run, wanted, side="right") - 1, 0, len(part) - 2)
        edges.append(np.stack([part[at], part[at + 1]], axis=1))
        shares.append((wanted - run[at]) / (run[at + 1] - run[at]))
    return np.concatenate(edges), np.concatenate(shares)
