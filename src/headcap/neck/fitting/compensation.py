"""Pose and expression of tracked sequences, and the meshes without them that the speech model is trained on (paper, eq. 7).

Sequences are read in blocks, the only thing that grows with their length is a few hundred bytes of coefficients per frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.linalg import cho_factor, cho_solve

from headcap.errors import InputError
from headcap.heads import HeadCoefficients, HeadModel
from headcap.neck.fitting.pose import PoseEstimator, Poses, PoseSettings

BLOCK = 64
"""Frames at once: 10 MB at 13 thousand vertices, which stay in the cache from one product to the next."""


class FitSettings(BaseModel):
    """Fitting pose and expression."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    pose: PoseSettings = Field(default_factory=PoseSettings)
    expression_region: str | None = Field(
        "face", description="Region that tells the expression; speech must not pass for it. None: the whole head"
    )
    noise_mm: float = Field(0.5, gt=0, description="Standard deviation of what the expression leaves of a vertex (ridge)")


@dataclass(frozen=True, eq=False)
class FittedBlock:
    """Some frames, fitted."""

    frames: NDArray[np.int64]
    """(f,) their numbers; frames that are not finite are left out."""
    poses: Poses
    psi: NDArray[np.float64]
    """(f, e)."""
    displacement: NDArray
    """(f, n, 3) metres at rest: unskinned(mesh) - T_0 - B_P(theta), expression and all."""

    @property
    def coefficients(self) -> HeadCoefficients:
        """Pose, placement and expression, to evaluate the model with."""
        return HeadCoefficients(expression=self.psi, pose=self.poses.theta, placement=self.poses.placement)


class SequenceFitter:
    """Fits pose and expression of one person's model to meshes in its topology."""

    def __init__(self, model: HeadModel, settings: FitSettings | None = None, seen: NDArray[np.bool_] | None = None) -> None:
        """Of a personal model (its `vertices` are the neutral head); `seen` (n,) masks what cameras saw, all of it by default.

        Raises `InputError` for a region the model has not.
        """
        self.model, self.settings = model, settings or FitSettings()
        self.estimator = PoseEstimator(model, self.settings.pose, seen)
        self._joints = model.joints()
        self._solver = ExpressionSolver(model, self.settings, seen)

    def blocks(self, meshes: NDArray) -> Iterator[FittedBlock]:
        """Fit meshes (f, n, 3), which may be memory-mapped, block after block in order of time; each frame starts at the last.

        Raises `InputError` for another topology or where no frame is finite.
        """
        check_topology(self.model, meshes)
        start, any_ = None, False
        for first in range(0, len(meshes), BLOCK):
            chunk = np.asarray(meshes[first : first + BLOCK])
            good = np.isfinite(chunk).all(axis=(1, 2))
            if not good.any():
                continue
            fitted = self._fit(chunk if good.all() else chunk[good], first + np.flatnonzero(good), start)
            start, any_ = (fitted.poses, fitted.psi), True
            yield fitted
        if not any_:
            raise InputError(
                f"none of {len(meshes)} meshes is finite",
                expected="at least one tracked frame",
                remedy="Check the tracker's report of this take.",
            )

    def _fit(self, meshes: NDArray, frames: NDArray, start: tuple[Poses, NDArray] | None) -> FittedBlock:
        poses, psi, _ = self.estimator.estimate(meshes[:, self.estimator.vertices], start)
        theta = poses.theta
        displacement = self.model.unskinned(meshes, self._joints, theta, poses.placement)
        displacement -= self.model.rest(HeadCoefficients(pose=theta)) if self.model.pose_basis.any() else self.model.vertices
        return FittedBlock(frames, poses, self._solver(displacement) if psi.shape[1] else psi, displacement)


class ExpressionSolver:
    """psi of displacements at rest by ridge: least |d - B_E(psi)|^2 / noise^2 + |psi|^2 over the vertices that tell it.

    Expression bases are scaled to the spread of people's expressions, so that psi has unit variance and the ridge is its prior.
    """

    def __init__(self, model: HeadModel, settings: FitSettings, seen: NDArray[np.bool_] | None = None) -> None:
        self._vertices = _region(model, settings.expression_region)
        if seen is not None:
            self._vertices = self._vertices[seen[self._vertices]]
        basis = model.expression_basis[:, self._vertices].reshape(len(model.expression_basis), 3 * len(self._vertices))
        self._basis = np.ascontiguousarray(basis.T)
        gram = (basis @ basis.T).astype(np.float64)
        self._factor = cho_factor(gram + (1e-3 * settings.noise_mm) ** 2 * np.eye(len(gram))) if len(gram) else None

    def __call__(self, displacement: NDArray) -> NDArray[np.float64]:
        """psi (f, e) of displacements (f, n, 3), metres."""
        chosen = displacement[:, self._vertices].reshape(len(displacement), -1)
        return cho_solve(self._factor, (chosen @ self._basis).T.astype(np.float64)).T


@dataclass(frozen=True, eq=False)
class Compensation:
    """A take without pose and expression; a frame that was not finite is NaN everywhere."""

    meshes: NDArray
    """M_j of eq. 7, (f, n, 3) metres at rest."""
    theta: NDArray[np.float64]
    """(f, 2, 3) rotation vectors of neck and jaw, radians."""
    psi: NDArray[np.float64]
    """(f, e)."""
    placement: NDArray[np.float64]
    """world_from_head (f, 4, 4)."""
    skipped: int
    """Frames that were not finite."""

    @property
    def coefficients(self) -> HeadCoefficients:
        """What poses the meshes as they were tracked."""
        return HeadCoefficients(expression=self.psi, pose=self.theta, placement=self.placement)


def compensate(
    model: HeadModel,
    meshes: NDArray,
    settings: FitSettings | None = None,
    *,
    seen: NDArray[np.bool_] | None = None,
    out: NDArray | None = None,
) -> Compensation:
    """Take pose and expression off tracked meshes (f, n, 3) of one person: M_j = unskinned(M'_j) - B_P(theta) - B_E(psi) (eq. 7).

    `model` is the person's (`HeadModel.personal`). `seen` (n,) masks the vertices that cameras saw; the others tell nothing.
    `out` (f, n, 3), a memory map for long takes, receives the meshes. Frames keep their numbers. Raises `InputError` for another
    topology or where no frame is finite.
    """
    fitter, f = SequenceFitter(model, settings, seen), len(meshes)
    out = np.empty((f, *model.vertices.shape), model.vertices.dtype) if out is None else out
    theta, placement = np.full((f, 2, 3), np.nan), np.full((f, 4, 4), np.nan)
    psi, done = np.full((f, len(model.expression_basis)), np.nan), np.zeros(f, bool)
    basis = model.expression_basis.reshape(len(model.expression_basis), model.vertices.size)
    for block in fitter.blocks(meshes):
        theta[block.frames], placement[block.frames] = block.poses.theta, block.poses.placement
        psi[block.frames], done[block.frames] = block.psi, True
        shown = (block.psi.astype(basis.dtype) @ basis).reshape(block.displacement.shape)
        out[block.frames] = model.vertices + block.displacement - shown
    for first in range(0, f, BLOCK):
        missing = first + np.flatnonzero(~done[first : first + BLOCK])
        if len(missing):
            out[missing] = np.nan
    return Compensation(out, theta, psi, placement, int((~done).sum()))


def without_expressions(model: HeadModel) -> HeadModel:
    """The model with no expression basis: pose takes show none (section 5.1)."""
    return replace(model, expression_basis=model.expression_basis[:0], expression_names=())


def check_topology(model: HeadModel, meshes: NDArray) -> None:
    """Raise `InputError` for meshes that are no (f, n, 3) of the model's n."""
    if np.ndim(meshes) != 3 or np.shape(meshes)[1:] != model.vertices.shape:
        raise InputError(
            f"meshes {np.shape(meshes)}",
            expected=f"(frames, {len(model.vertices)}, 3), the topology of {model.name}",
            remedy="Track the takes with this model's template.",
        )


def _region(model: HeadModel, name: str | None) -> NDArray[np.int64]:
    if name is None:
        return np.arange(len(model.vertices))
    if name not in model.regions or not model.regions[name].any():
        raise InputError(
            f"the head model {model.name} has no region {name}",
            expected=f"one of {', '.join(sorted(model.regions))}, or none for the whole head",
            remedy="Name another region to tell the expression from.",
        )
    return np.flatnonzero(model.regions[name])
