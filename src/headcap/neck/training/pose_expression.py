"""Refining pose correctives and expressions of a head model, and what a person it has not seen gains (section 5.1, table 1)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from headcap.errors import InputError
from headcap.heads import HeadModel
from headcap.neck.fitting.compensation import FitSettings, fitting_error_mm, without_expressions
from headcap.neck.training.expression import ExpressionTrainingSettings, train_expressions
from headcap.neck.training.pose import PoseTrainingSettings, train_pose
from headcap.neck.training_subject import TrainingSubject


class PoseExpressionSettings(BaseModel):
    """Training pose correctives and expressions."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    pose: PoseTrainingSettings = Field(default_factory=PoseTrainingSettings)
    expression: ExpressionTrainingSettings = Field(default_factory=ExpressionTrainingSettings)


@dataclass(frozen=True)
class ErrorDrops:
    """One held-out person's rows of table 1: mean 3D error over the neck region, millimetres, before and after training."""

    name: str
    pose_before_mm: float
    pose_after_mm: float
    expression_before_mm: float
    expression_after_mm: float
    skipped: int
    """Frames that were not finite."""

    @property
    def pose_drop_mm(self) -> float:
        """`neck.pose_error_drop_mm`."""
        return self.pose_before_mm - self.pose_after_mm

    @property
    def expression_drop_mm(self) -> float:
        """`neck.expression_error_drop_mm`."""
        return self.expression_before_mm - self.expression_after_mm


def train_pose_expression(
    model: HeadModel,
    subjects: Sequence[TrainingSubject],
    settings: PoseExpressionSettings | None = None,
    *,
    progress: Callable[[str], None] | None = None,
) -> HeadModel:
    """The model with pose correctives and expressions refined on several subjects' takes (section 5.1).

    First P from pose takes, then E from expression takes with P taken off. A subject without pose or without expression takes
    serves the other alone; what no subject serves stays as it is. One subject is enough to compute, though what it learns is then
    that person's. Raises `InputError` where no subject has any take, and as `TrainingSubject.check`.
    """
    settings = settings or PoseExpressionSettings()
    posed = [subject for subject in subjects if len(subject.pose)]
    expressive = [subject for subject in subjects if len(subject.expression)]
    if not posed and not expressive:
        raise InputError(
            f"{len(subjects)} subjects without pose and expression takes",
            expected="at least one subject with frames",
            remedy="Name training subjects with pose or expression takes in the study.",
        )
    if posed:
        found = train_pose(model, posed, settings.pose)
        model = replace(model, pose_basis=found.basis)
        _tell(progress, f"pose correctives: {found.frames} frames of {len(posed)} subjects, {found.residual_mm[-1]:.3f} mm left")
    if expressive:
        trained = train_expressions(model, expressive, settings.expression)
        model = replace(model, expression_basis=trained.basis, expression_names=())
        _tell(
            progress,
            f"expressions: {trained.frames} frames of {len(expressive)} subjects and {trained.identities} random identities, "
            f"{len(trained.basis)} explain {100 * trained.explained[-1]:.2f} %",
        )
    return model


def error_drops(
    base: HeadModel, trained: HeadModel, subject: TrainingSubject, settings: FitSettings | None = None, *, region: str = "neck"
) -> ErrorDrops:
    """Fit a held-out subject's takes with both models: table 1's pose and expression columns (section 7.1, 7.2).

    Pose takes are fitted by pose alone, expression takes by pose and expression on the whole head (`settings` may say otherwise).
    What was not seen of the person is not judged. A take
    without frames gives NaN. Raises `InputError` as `TrainingSubject.check`.
    """
    settings = settings or FitSettings(expression_region=None)
    takes = {"pose": subject.pose, "expression": subject.expression}
    subject.check(base, takes=tuple(name for name, meshes in takes.items() if len(meshes)))
    judged = base.regions[region] if subject.seen is None else base.regions[region] & subject.seen
    figures, skipped = {}, 0
    for stage, model in (("before", base), ("after", trained)):
        personal = subject.personal(model)
        for name, meshes in takes.items():
            chosen = without_expressions(personal) if name == "pose" else personal
            error = fitting_error_mm(chosen, meshes, judged, settings, subject.seen) if len(meshes) else np.zeros(0)
            kept = np.isfinite(error)
            figures[f"{name}_{stage}_mm"] = float(error[kept].mean()) if kept.any() else float("nan")
            skipped += int((~kept).sum()) if stage == "after" else 0
    return ErrorDrops(subject.name, **figures, skipped=skipped)


def _tell(progress: Callable[[str], None] | None, message: str) -> None:
    if progress is not None:
        progress(message)
