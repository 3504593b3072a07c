"""Who somebody is, from frames in which the head turns: shape, poses and lens together (lip paper, section 3.2).

One frontal frame leaves a face's depth to the prior and to shading. As a head turns, what lies nearer to the camera moves
farther: places of the skin are followed from the frame that starts the track to others, and the model's shape, the medium-scale
layer beyond it, each frame's pose, jaw and expression are what explains them all (a bundle adjustment whose points lie on a
head model). The paper's base tracker estimates identity over several frames as well (Garrido et al. 2016, section 5) but by its
photometric term alone; correspondences by flow are ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from headcap.cameras import Camera
from headcap.lips.monocular.flow import flow_there_and_back
from headcap.lips.monocular.person import MonocularPerson
from headcap.lips.monocular.pictures import finest_share, resized
from headcap.lips.monocular.problem import Features, FrameProblem, Prior
from headcap.lips.monocular.settings import IdentitySettings, MonocularSettings
from headcap.lips.monocular.surface import JAW, RIGID, Estimate, FaceSurface
from headcap.meshes.rasteriser import rasterise

_LEAST_NEW_DEG = 3.0
"""A frame turned by less from one that is there already tells nothing new."""
_FACING = 0.35
"""Cosine between normal and view from which on skin is followed."""
_CONTRAST_SHARE = 0.06
"""Standard deviation of the window of the local normalisation over the root of the face's area."""
_FLOOR_CODE, _CODE = 9.0, 40.0
"""Variance of grey codes that is noise, and codes per standard deviation of what is normalised."""
_BORDER_PX, _RETURN_PX = 2, 0.7
"""Flow is not read so near to the seen skin's border, and not where its way back misses by so much."""
_HIDDEN_M = 4e-3
_STEPS, _HALVINGS, _ENOUGH = 5, 4, 1e-3


@dataclass(frozen=True, eq=False)
class KeyFrame:
    """One of the frames."""

    picture: NDArray[np.uint8]
    """(height, width, 3)."""
    estimate: Estimate


@dataclass(frozen=True, eq=False)
class Identified:
    """What the frames tell together."""

    person: MonocularPerson
    log_focal: float
    """Logarithm of the focal length's ratio to the given camera's."""
    frames: int
    turn_deg: float
    """The farthest turn of the head from the first frame."""
    flow_left_px: float
    """Median distance of places of the skin from where the last round found them."""
    estimates: tuple[Estimate, ...] = ()
    """Of the frames."""


def key_frames(estimates: Sequence[Estimate | None], settings: IdentitySettings) -> list[int]:
    """Numbers of the frames to use, the first answered one and those that are turned farthest from all before; [] for none.

    None where no frame is turned by `least_turn_deg` from the first.
    """
    answered = [k for k, estimate in enumerate(estimates) if estimate is not None]
    if not answered:
        return []
    turns = Rotation.from_matrix(np.stack([estimates[k].camera_from_head[:3, :3] for k in answered]))
    away_deg = np.degrees((turns * turns[0].inv()).magnitude())
    if away_deg.max() < settings.least_turn_deg:
        return []
    chosen = [0]
    while len(chosen) < settings.key_frames and away_deg.max() >= _LEAST_NEW_DEG:
        chosen.append(int(away_deg.argmax()))
        away_deg = np.minimum(away_deg, np.degrees((turns * turns[chosen[-1]].inv()).magnitude()))
    return [answered[k] for k in chosen]


def identify(
    surface: FaceSurface, camera: Camera, frames: Sequence[KeyFrame], settings: MonocularSettings, *, focal_known: bool = True
) -> Identified:
    """Shape and layer that explain how the skin moves from the first frame to the others.

    `surface` has the medium-scale layer's unknowns (see `identity_surface`); estimates of frames may lack them.
    """
    chosen = settings.identity
    camera, pictures = _sized(surface, camera, frames, chosen)
    estimates = [_with_layer(surface, frame.estimate, frames[0].estimate) for frame in frames]
    left_px = np.nan
    for _ in range(chosen.rounds):
        features, left_px = _followed(surface, camera, pictures, estimates, chosen)
        estimates = _Bundle(*_at_places(surface, features), settings, focal_known).lowered(estimates)
    first = estimates[0]
    turn_deg = max(_turn_deg(first, estimate) for estimate in estimates)
    person = MonocularPerson(surface.model.digest, surface.shape(first), surface.layer(first))
    return Identified(person, first.log_focal, len(frames), turn_deg, left_px, tuple(estimates))


def identity_surface(surface: FaceSurface, settings: MonocularSettings) -> FaceSurface:
    """The same face with the unknowns of a medium-scale layer behind the model's shapes."""
    chosen = settings.identity
    return FaceSurface(
        surface.model, settings.expressions, settings.shapes, harmonics=chosen.harmonics, harmonic_m=1e-3 * chosen.harmonic_mm
    )


def _turn_deg(one: Estimate, other: Estimate) -> float:
    turn = Rotation.from_matrix(one.camera_from_head[:3, :3].T @ other.camera_from_head[:3, :3])
    return float(np.degrees(turn.magnitude()))


def _sized(
    surface: FaceSurface, camera: Camera, frames: Sequence[KeyFrame], settings: IdentitySettings
) -> tuple[Camera, list[NDArray[np.float32]]]:
    """Camera, in its own axes, and grey pictures at a resolution that the mesh can follow."""
    first = replace(frames[0].estimate, shape=frames[0].estimate.shape[: surface.model_shapes])
    share = finest_share(surface, camera, _with_layer(surface, first, first), settings.edge_px)
    small = resized(camera, round(camera.width * share), round(camera.height * share))
    grey = [cv2.cvtColor(frame.picture, cv2.COLOR_BGR2GRAY).astype(np.float32) for frame in frames]
    return small, [cv2.resize(picture, small.size, interpolation=cv2.INTER_AREA) for picture in grey]


def _with_layer(surface: FaceSurface, estimate: Estimate, first: Estimate) -> Estimate:
    """An estimate with the first frame's shape, and no layer where it has none."""
    shape = np.zeros(surface.shapes)
    shape[: len(first.shape)] = first.shape
    return replace(estimate, shape=shape)


# -- what is followed ----------------------------------------------------------------------------------------------------------


def _followed(
    surface: FaceSurface, camera: Camera, pictures: Sequence[NDArray], estimates: Sequence[Estimate], settings: IdentitySettings
) -> tuple[list[list[Features]], float]:
    """Features of each frame, the first one's places among them, and the median flow that the estimates leave, px."""
    first = _Seen(surface, camera, estimates[0])
    places = np.flatnonzero(first.facing > _FACING)
    places = places[:: max(1, len(places) // settings.places)]
    features = [[Features(places, first.pixels[places], settings.flow_noise_px, camera)]]
    left_px = []
    for picture, estimate in zip(pictures[1:], estimates[1:], strict=True):
        there = _Seen(surface, camera, estimate)
        kept, moved = _flow_at(surface, first, pictures[0], there, picture, places)
        features.append([Features(kept, there.pixels[kept] + moved, settings.flow_noise_px, camera)])
        left_px.append(np.linalg.norm(moved, axis=1))
    moved = np.concatenate(left_px)
    return features, float(np.median(moved)) if len(moved) else np.nan


def _at_places(surface: FaceSurface, features: list[list[Features]]) -> tuple[FaceSurface, list[list[Features]]]:
    """The surface at the places that are followed alone, and the features numbered as there."""
    places = features[0][0].vertices
    own = [[replace(one, vertices=np.searchsorted(places, one.vertices)) for one in given] for given in features]
    return surface.at(places), own


class _Seen:
    """A surface as one frame sees it."""

    def __init__(self, surface: FaceSurface, camera: Camera, estimate: Estimate) -> None:
        self.camera, self.vertices = estimate.camera(camera), surface.in_camera(estimate)
        self.pixels = self.camera.project(self.vertices)[0]
        rays = self.vertices / np.linalg.norm(self.vertices, axis=1, keepdims=True)
        self.facing = np.where(surface.blind, -1.0, -np.einsum("ni,ni->n", surface.normals(self.vertices), rays))


def _flow_at(
    surface: FaceSurface, first: _Seen, start: NDArray, there: _Seen, picture: NDArray, places: NDArray
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Which of the places a frame shows, and the flow (k, 2) px from where they should be, seen as in the first frame."""
    raster = rasterise(there.camera, there.vertices, surface.triangles, cull_back_faces=True)
    source = raster.interpolate(surface.triangles, first.pixels)
    known = raster.interpolate(surface.triangles, first.facing[:, None])[..., 0]
    hit = raster.hit & np.isfinite(source).all(axis=2) & (np.nan_to_num(known, nan=-1.0) > _FACING)
    turned = cv2.remap(start, np.where(hit[..., None], source, -1.0).astype(np.float32), None, cv2.INTER_LINEAR)
    flow, missed_px = flow_there_and_back(*_normalised(turned, picture, hit), finest_scale=0)
    sound = hit & (missed_px < _RETURN_PX) & (cv2.erode(hit.astype(np.uint8), np.ones((2 * _BORDER_PX + 1,) * 2)) > 0)
    pixel = np.rint(there.pixels[places]).astype(int)
    inside = ((pixel >= 0) & (pixel < picture.shape[::-1])).all(axis=1) & (there.facing[places] > _FACING)
    places, (column, row) = places[inside], pixel[inside].T
    # behind a nose that has turned before it, a place is not where the picture shows the nose
    good = sound[row, column] & (there.vertices[places, 2] < raster.depth[row, column] + _HIDDEN_M)
    return places[good], flow[row[good], column[good]].astype(np.float64)


def _normalised(turned: NDArray, picture: NDArray, hit: NDArray[np.bool_]) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Both pictures with their local mean and contrast taken off: a turned head is lit in another way."""
    mask, window_px = hit.astype(np.float32), _CONTRAST_SHARE * np.sqrt(hit.sum())
    share = cv2.GaussianBlur(mask, (0, 0), window_px) + 1e-3
    codes = []
    for image in (turned, picture):
        mean = cv2.GaussianBlur(image * mask, (0, 0), window_px) / share
        variance = cv2.GaussianBlur(image * image * mask, (0, 0), window_px) / share - mean**2
        standard = (image - mean) / np.sqrt(np.maximum(variance, 0.0) + _FLOOR_CODE)
        codes.append(np.clip(127 + _CODE * standard, 0, 255).astype(np.uint8))
    return np.where(hit, codes[0], codes[1]), codes[1]


# -- what explains it ----------------------------------------------------------------------------------------------------------


class _Bundle:
    """The energy of all frames together: features, priors of each frame's jaw and expression, one prior of the person."""

    def __init__(
        self, surface: FaceSurface, features: Sequence[Sequence[Features]], settings: MonocularSettings, focal_known: bool
    ) -> None:
        self.surface = surface
        prior = Prior.of(surface, settings).precision
        shared = np.zeros(surface.unknowns, bool)
        shared[surface.shape_columns] = True
        shared[-1] = not focal_known
        self.shared, self.focal = np.flatnonzero(shared), not focal_known
        self.precision = prior[self.shared]
        own = np.where(shared, 0.0, prior)
        # who somebody is must not be taken for what each frame's face does
        own[surface.expression_columns] *= settings.identity.expression_spread**-2
        own[JAW] *= settings.identity.expression_spread**-2
        own[-1] = 0.0
        self.frames = [FrameProblem(surface, (), Prior(own, np.zeros(len(own))), settings, given) for given in features]

    def lowered(self, estimates: list[Estimate]) -> list[Estimate]:
        """Gauss-Newton steps, halved where they do not lower the energy."""
        energy = self._energy(estimates)
        for _ in range(_STEPS):
            steps = self._steps(estimates)
            for halving in range(_HALVINGS):
                ahead = [self.surface.moved(e, 0.5**halving * step) for e, step in zip(estimates, steps, strict=True)]
                value = self._energy(ahead)
                if value < energy:
                    break
            else:
                return estimates
            estimates, before, energy = ahead, energy, value
            if before - energy < _ENOUGH * energy:
                break
        return estimates

    def _energy(self, estimates: list[Estimate]) -> float:
        person = estimates[0].coordinates[self.shared]
        apart = (frame.sparse_energy(e, self.surface.in_camera(e)) for frame, e in zip(self.frames, estimates, strict=True))
        return float(person**2 @ self.precision) + sum(apart)

    def _steps(self, estimates: list[Estimate]) -> list[NDArray[np.float64]]:
        """Steps (unknowns,) of all frames; each frame's own unknowns are eliminated from the person's equations."""
        person = estimates[0].coordinates[self.shared]
        matrix, right, own = np.diag(self.precision), -self.precision * person, []
        for frame, estimate in zip(self.frames, estimates, strict=True):
            slopes = self.surface.slopes(estimate, shape=True, focal=self.focal, normals=False)
            whole, pulls = frame.sparse_normal(estimate, self.surface.in_camera(estimate), slopes)
            whole[RIGID, RIGID] += np.eye(RIGID.stop)
            mine = np.isin(slopes.columns, self.shared)
            answer = np.linalg.solve(whole[np.ix_(~mine, ~mine)], np.c_[whole[np.ix_(~mine, mine)], pulls[~mine]])
            matrix += whole[np.ix_(mine, mine)] - whole[np.ix_(mine, ~mine)] @ answer[:, :-1]
            right += pulls[mine] - whole[np.ix_(mine, ~mine)] @ answer[:, -1]
            own.append((slopes.columns[~mine], answer))
        shared = np.linalg.solve(matrix, right)
        steps = []
        for columns, answer in own:
            step = np.zeros(self.surface.unknowns)
            step[self.shared], step[columns] = shared, answer[:, -1] - answer[:, :-1] @ shared
            steps.append(step)
        return steps
