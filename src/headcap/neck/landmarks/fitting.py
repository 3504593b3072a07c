"""Pose, expression and identity from sparse landmarks, so that a tracked face drives the neck (section 7.3, figure 13).

All frames are one robust Gauss-Newton problem with analytic derivatives: landmarks, priors of the coefficients, and accelerations
that tie neighbouring frames. What a face does not show, the trunk above all, stays where priors and neighbours put it. Which way
the trunk faces is the weakest of it: it is taken to be where the head faces on average, for what a head's place says of it (its
turns have the neck's joint for a centre) is soon outweighed by a real neck's seven joints.

Measured on two rehearsed people left out of a model of three others, 32 landmarks with 0.5 mm of noise: in pose takes the
neck is off by 1.6 mm, and by 6.0 where it does not follow; by 10 with a trunk held still (`trunk="still"`, for one that is), for
theirs sways. In expression takes it is off by 0.35 and 0.54 mm (at rest 0.25 and 0.41), in speech by 0.8 and 1.2 (0.8 and 0.9):
there the neck hardly moves but for its larynx, which no landmark of a face shows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial.transform import Rotation

from headcap.errors import InputError
from headcap.geometry.transforms import fit_rigid, invert, rigid
from headcap.heads import JOINTS, HeadModel
from headcap.neck.animation.curves import CoefficientCurves
from headcap.neck.landmarks.landmarks import Landmarks
from headcap.neck.landmarks.problem import LandmarkProblem, State

LEAST_3D, LEAST_2D = 4, 6
"""Landmarks that a frame must show to say where the head is, by itself."""


class LandmarkMotion(BaseModel):
    """Standard deviations of accelerations: the temporal prior."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    neck_rad_s2: float = Field(30.0, gt=0, description="Of the neck's rotation vector; a shaken head reaches 100")
    jaw_rad_s2: float = Field(40.0, gt=0, description="Of the jaw's; speech reaches 60")
    expression_s2: float = Field(100.0, gt=0, description="Of expression coefficients, which have unit variance")
    trunk_rad_s2: float = Field(2.0, gt=0, description="Of the trunk's turn")
    trunk_m_s2: float = Field(1.0, gt=0, description="Of the trunk's shift")


class LandmarkSettings(BaseModel):
    """Fitting landmarks."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    noise_mm: float = Field(1.0, gt=0, description="Standard deviation of landmarks in 3D, per coordinate")
    noise_px: float = Field(1.5, gt=0, description="Of landmarks in a picture, per coordinate")
    robust_sigmas: float = Field(3.0, gt=0, description="Distances beyond count linearly (Huber)")
    expressions: int = Field(30, ge=0, description="Leading expression coefficients that are solved for; the others rest")
    identity: bool = Field(False, description="Whether the shape is solved for as well, one for all frames")
    trunk: Literal["moving", "still"] = Field(
        "moving", description="Whether the trunk may move; a still one gives all to the neck"
    )
    neck_deg: float = Field(25.0, gt=0, description="Standard deviation of the neck's turn about each axis")
    jaw_deg: tuple[float, float, float] = Field((12.0, 2.0, 1.0), description="Of the jaw's: opening, sideways, rolling")
    trunk_deg: float = Field(2.0, gt=0, description="Of the trunk's turn about its mean, where it moves")
    trunk_mm: float = Field(300.0, gt=0, description="Of the trunk's shift")
    temporal: LandmarkMotion | None = Field(default_factory=LandmarkMotion, description="None: every frame stands for itself")
    iterations: int = Field(40, ge=1, description="Most Gauss-Newton steps")
    settled: float = Field(1e-6, gt=0, description="A step that lowers the energy by a smaller share is the last")


@dataclass(frozen=True, eq=False)
class LandmarkFit:
    """Coefficients of f frames; NaN where a frame showed too little and no temporal prior bridges it."""

    time_s: NDArray[np.float64]
    theta: NDArray[np.float64]
    """(f, 2, 3) rotation vectors of neck and jaw, radians."""
    placement: NDArray[np.float64]
    """world_from_head (f, 4, 4): where the trunk is."""
    psi: NDArray[np.float64]
    """(f, e) of the whole expression basis."""
    beta: NDArray[np.float64] | None
    """(s,) where the identity was solved for."""
    distance: NDArray[np.float64]
    """(f, k) from landmark to model, metres or pixels; NaN where not seen."""
    told: NDArray[np.bool_]
    """(f,) frames that showed enough by themselves."""
    energy: tuple[float, ...]
    """After each step; it never rises."""

    def curves(self, model_version: str, person: str) -> CoefficientCurves:
        """As `headcap animate` reads them: pose, placement and expression; larynx and speech rest."""
        channels = {"psi": self.psi} | {name: self.theta[:, k] for k, name in enumerate(JOINTS)}
        known = np.isfinite(self.placement).all(axis=(1, 2))
        return CoefficientCurves.filled(self.time_s, channels, self.placement, known, model_version, person)


def fit_landmarks(head: HeadModel, landmarks: Landmarks, settings: LandmarkSettings | None = None) -> LandmarkFit:
    """Pose, placement, expression and, if asked for, identity of a person's head model from landmarks over time.

    Minimises sum 2 rho(distance / noise) over the landmarks seen, rho Huber's, plus |psi|^2, |beta|^2, squared turns of neck, jaw
    and trunk over their spreads, plus squared accelerations over theirs. Where only the face is seen, the head's turn is shared
    between neck and trunk as their spreads say (nearly all to the neck), and the trunk's shift is what carries the neck's joint.
    `head` is the person's (`HeadModel.personal`), or one with a shape basis where `identity` is asked for. Memory grows by some
    30 kB per frame at 30 expressions. Raises `InputError` where no frame shows 4 landmarks in 3D or 6 in a picture, or identity
    is asked of a model without a shape basis.
    """
    settings = settings or LandmarkSettings()
    landmarks.points.checked(head)
    if settings.identity and not len(head.shape_basis):
        raise InputError(
            f"the identity of {head.name}, which has no shape basis",
            expected="a model of many people",
            remedy="Give the base model.",
        )
    told = landmarks.visible.sum(axis=1) >= (LEAST_2D if landmarks.flat else LEAST_3D)
    if not told.any():
        least = f"{LEAST_2D} in a picture" if landmarks.flat else f"{LEAST_3D} in 3D"
        raise InputError(
            f"at most {int(landmarks.visible.sum(axis=1).max(initial=0))} landmarks in any frame",
            expected=f"at least {least} in one frame",
            remedy="Track more landmarks, or check their coordinates.",
        )
    reference, start = _start(head, landmarks, told, settings)
    problem = LandmarkProblem(head, landmarks, reference, settings)
    state, energy = _minimised(problem, start, settings)
    kept = told if settings.temporal is None else np.ones(len(told), bool)
    return _result(head, landmarks, problem, state, kept, told, energy, settings)


def _minimised(problem: LandmarkProblem, state: State, settings: LandmarkSettings) -> tuple[State, list[float]]:
    """Levenberg-Marquardt: steps that would raise the energy are damped."""
    damping, energies = 1e-6, [problem.energy(state)]
    for _ in range(settings.iterations):
        normal = problem.normal(state)
        for _ in range(12):
            trial = normal.moved(state, damping)
            energy = problem.energy(trial)
            if energy <= energies[-1]:
                break
            damping = max(1e-4, 10 * damping)
        else:
            break
        fell = energies[-1] - energy
        state, damping = trial, max(1e-9, 0.1 * damping)
        energies.append(energy)
        if fell <= settings.settled * energy:
            break
    return state, energies


def _start(head: HeadModel, landmarks: Landmarks, told: NDArray, settings: LandmarkSettings) -> tuple[NDArray, State]:
    """Placement about which the trunk moves (4, 4), and a start: every frame's head moved rigidly, all of its turn the neck's."""
    own = landmarks.points.at(np.asarray(head.vertices, float))
    neck = np.asarray(head.joints(), float)[0]
    frames = np.flatnonzero(told)
    placed = np.array([_placed(own, landmarks, t) for t in frames])
    mean = Rotation.from_matrix(placed[:, :3, :3]).mean()
    joints = placed[:, :3, :3] @ neck + placed[:, :3, 3]
    reference = rigid(mean.as_matrix(), np.median(joints, axis=0) - mean.apply(neck))
    turns = (mean.inv() * Rotation.from_matrix(placed[:, :3, :3])).as_rotvec()
    shifts = mean.inv().apply(joints - np.median(joints, axis=0))
    state = State.at_rest(len(landmarks), min(settings.expressions, len(head.expression_basis)), len(head.shape_basis))
    every = np.arange(len(landmarks))
    for axis in range(3):
        state.neck[:, axis] = np.interp(every, frames, turns[:, axis])
        if settings.trunk == "moving":
            state.shift[:, axis] = np.interp(every, frames, shifts[:, axis])
    return reference, state


def _placed(own: NDArray, landmarks: Landmarks, frame: int) -> NDArray[np.float64]:
    """world_from_head (4, 4) of a rigid head in one frame."""
    shown = landmarks.visible[frame]
    seen = landmarks.seen[frame, shown]
    if not landmarks.flat:
        return fit_rigid(own[shown], seen)
    camera = landmarks.camera
    flat = camera.undistort_pixels(seen)
    found, turn, shift = cv2.solvePnP(
        np.ascontiguousarray(own[shown]), np.ascontiguousarray(flat), np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP
    )
    if not found or not np.isfinite(turn).all():
        raise InputError(
            f"frame {frame}: {int(shown.sum())} landmarks that no placement explains",
            expected="landmarks of a head in the camera's picture",
            remedy="Check that the landmarks' names, the camera and the pixels go together.",
        )
    camera_from_head = rigid(Rotation.from_rotvec(turn.ravel()).as_matrix(), shift.ravel())
    return invert(camera.camera_from_world) @ camera_from_head


def _result(
    head: HeadModel, landmarks: Landmarks, problem: LandmarkProblem, state: State, kept, told, energy, settings: LandmarkSettings
) -> LandmarkFit:
    f = len(landmarks)
    theta, placement, psi = (
        np.full((f, 2, 3), np.nan),
        np.full((f, 4, 4), np.nan),
        np.full((f, len(head.expression_basis)), np.nan),
    )
    theta[kept] = np.stack([state.neck, state.jaw], axis=1)[kept]
    placement[kept] = problem.placement(state)[kept]
    psi[kept] = 0.0
    psi[kept, : state.psi.shape[1]] = state.psi[kept]
    beta = state.beta.copy() if settings.identity else None
    return LandmarkFit(landmarks.time_s, theta, placement, psi, beta, problem.distances(state), told, tuple(energy))
