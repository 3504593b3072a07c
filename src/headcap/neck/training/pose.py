"""Pose correctives P from pose takes of several subjects (paper, section 5.1; FLAME, Li et al. 2017, section 4.2).

Poses and correctives are found in turn: poses with the correctives there are, then all correctives at once from what the meshes
show at rest. These enter only through sums of 18 x 18 and 18 x 3 n numbers, so that memory does not grow with the frames.

The weight of the ridge was chosen on held-out persons of `headcap.synthetic` with a tracker's noise of 0.1 mm, mean error of two
necks, 1.94 mm without correctives: 1e-5, 3e-5, 1e-4, 3e-4 leave 0.352, 0.354, 0.365, 0.380 mm, noise itself 0.16 mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy import sparse

from headcap.heads import JOINTS, HeadModel
from headcap.heads.model import POSE_FEATURES
from headcap.heads.skinning import pose_features
from headcap.meshes.extension import SmoothExtension
from headcap.meshes.laplacian import Factor, bilaplacian, cotangent_laplacian, vertex_areas
from headcap.neck.fitting.compensation import FitSettings, SequenceFitter, without_expressions
from headcap.neck.fitting.pose import PoseSettings
from headcap.neck.training_subject import TrainingSubject, seen_by_all

_UNSEEN = 1e-9
"""Share of the largest feature energy below which a combination of features did not occur."""


class PoseTrainingSettings(BaseModel):
    """Training the pose correctives."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    rounds: int = Field(3, ge=1, description="Most times that poses and correctives are found in turn")
    shrink: float = Field(3e-5, gt=0, description="Weight per frame of |P - P_before|^2 against squared residuals")
    smooth_mm: float = Field(8.0, ge=0, description="Changes over less than this count as much again as their size")
    least_turn_deg: float = Field(
        4.0, ge=0, description="A joint that turns less than this (rms over all takes) keeps the correctives the model has"
    )
    pose: PoseSettings = Field(default_factory=PoseSettings)


@dataclass(frozen=True, eq=False)
class PoseTraining:
    """Result of training the pose correctives."""

    basis: NDArray
    """P (18, n, 3), metres per unit of R(theta) - I."""
    residual_mm: tuple[float, ...]
    """Root mean square of what the correctives of each round leave at the poses they were found with."""
    objective: tuple[float, ...]
    """Each round's minimum of squared residuals plus penalties, square metres per frame."""
    frames: int
    """Frames used."""


@dataclass
class PoseSums:
    """All that the least-squares problem needs to know of the frames."""

    gram: NDArray[np.float64]
    """(18, 18) sum of F^T F, F = R(theta) - I."""
    moment: NDArray[np.float64]
    """(18, 3 n) sum of F^T d, d the displacement at rest."""
    squared: float = 0.0
    turned: NDArray[np.float64] = field(default_factory=lambda: np.zeros(len(JOINTS)))
    """(2,) sum of squared angles of neck and jaw."""
    frames: int = 0

    @classmethod
    def of(cls, n: int) -> PoseSums:
        """Empty sums for n vertices."""
        return cls(np.zeros((POSE_FEATURES, POSE_FEATURES)), np.zeros((POSE_FEATURES, 3 * n)))

    def add(self, theta: NDArray, displacement: NDArray) -> None:
        """Frames of poses (f, 2, 3) that show displacements (f, n, 3) at rest."""
        features = pose_features(theta)
        flat = displacement.reshape(len(displacement), -1)
        self.gram += features.T @ features
        self.moment += features.T.astype(flat.dtype) @ flat
        self.squared += float(np.einsum("fc,fc->", flat, flat, dtype=np.float64))
        self.turned += (theta**2).sum(axis=(0, 2))
        self.frames += len(flat)

    def exercised(self, least_turn_deg: float) -> NDArray[np.bool_]:
        """(18,) features of the joints that turned enough to learn from."""
        turn_deg = np.degrees(np.sqrt(self.turned / max(self.frames, 1)))
        return np.repeat(turn_deg >= least_turn_deg, POSE_FEATURES // len(JOINTS))


def train_pose(
    model: HeadModel, subjects: Sequence[TrainingSubject], settings: PoseTrainingSettings | None = None
) -> PoseTraining:
    """Pose correctives shared by several subjects' pose takes.

    P minimises sum_j |d_j - P F(theta_j)|^2 + shrink * frames * (|P - P_0|^2 + smooth^4 |Laplacian (P - P_0)|^2), with d_j what
    frame j shows at rest and P_0 the model's own: the change is drawn to zero, as FLAME's training draws P, so that what takes do
    not show keeps what the model had. A joint that hardly turns is left out: the few tenths of a degree that a shut jaw seems to
    turn follow the neck's misfit, and correctives learnt from them would be wrong by centimetres for an open one.

    Poses are found where the skin tells of a bone and nothing else, P over the whole head. They do not minimise one energy
    together: a round that raises the objective ends the search, and the one before is kept. Where some subject was not seen the
    change of P is continued smoothly. Raises `InputError` as `TrainingSubject.check`.
    """
    settings = settings or PoseTrainingSettings()
    for subject in subjects:
        subject.check(model, takes=("pose",))
    solver, seen = PoseSolver(model, settings), seen_by_all(model, subjects)
    extension = SmoothExtension(model.vertices, model.triangles, seen)
    basis, kept, residuals, objectives = model.pose_basis, model.pose_basis, [], []
    for _ in range(settings.rounds):
        sums = PoseSums.of(len(model.vertices))
        for subject in subjects:
            personal = replace(without_expressions(subject.personal(model)), pose_basis=basis)
            fitter = SequenceFitter(personal, FitSettings(pose=settings.pose), subject.seen)
            _gather(fitter, subject.pose, seen, sums)
        change, left, penalty = solver(sums)
        basis, objective = (model.pose_basis + extension(change)).astype(model.vertices.dtype), (left + penalty) / sums.frames
        if objectives and objective >= objectives[-1]:
            break
        kept = basis
        residuals.append(1e3 * np.sqrt(left / (sums.frames * len(model.vertices))))
        objectives.append(objective)
    return PoseTraining(kept, tuple(residuals), tuple(objectives), sums.frames)


def _gather(fitter: SequenceFitter, meshes: NDArray, seen: NDArray[np.bool_], sums: PoseSums) -> None:
    for block in fitter.blocks(meshes):
        theta, whole = block.poses.theta, block.displacement.reshape(len(block.frames), -1)
        whole += pose_features(theta).astype(whole.dtype) @ fitter.model.pose_basis.reshape(POSE_FEATURES, -1)
        sums.add(theta, whole.reshape(len(theta), -1, 3) * seen[:, None])


class PoseSolver:
    """Solves for the change of P from sums: the features' Gram matrix decouples the problem into 18 of one field each."""

    def __init__(self, model: HeadModel, settings: PoseTrainingSettings) -> None:
        vertices = model.vertices.astype(np.float64)
        self._before = model.pose_basis.reshape(POSE_FEATURES, -1).astype(np.float64)
        self._settings, n = settings, len(vertices)
        self.prior = sparse.eye_array(n)
        if settings.smooth_mm:
            areas = vertex_areas(vertices, model.triangles)
            laplacian = cotangent_laplacian(vertices, model.triangles, least_weight=0.0)
            # per vertex: |Laplacian p|^2 integrated over the surface, over the mean area
            rough = bilaplacian(laplacian, areas) * ((1e-3 * settings.smooth_mm) ** 4 / areas.mean())
            self.prior = sparse.csr_array(self.prior + rough)

    def __call__(self, sums: PoseSums) -> tuple[NDArray[np.float64], float, float]:
        """Change of P (18, n, 3), squared residuals and penalty."""
        right = sums.moment - sums.gram @ self._before
        used = sums.exercised(self._settings.least_turn_deg)
        energy, vectors = np.linalg.eigh(sums.gram[np.ix_(used, used)])
        turn = np.zeros((POSE_FEATURES, len(energy)))
        turn[used] = vectors
        turned, weight = turn.T @ right, self._settings.shrink * sums.frames
        change, penalty = np.zeros_like(turned), 0.0
        for k in np.flatnonzero(energy > _UNSEEN * max(energy.max(initial=0.0), 1e-300)):
            system = energy[k] * sparse.eye_array(self.prior.shape[0]) + weight * self.prior
            solved = Factor(system).solve(turned[k].reshape(-1, 3))
            penalty += weight * float((solved * (self.prior @ solved)).sum())
            change[k] = solved.ravel()
        change = turn @ change
        whole = self._before + change
        left = sums.squared - 2 * float((whole * sums.moment).sum()) + float((whole * (sums.gram @ whole)).sum())
        return change.reshape(POSE_FEATURES, -1, 3), max(left, 0.0), penalty
