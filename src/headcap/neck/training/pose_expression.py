"""Refining pose correctives and expressions of a head model (section 5.1)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from pydantic import BaseModel, ConfigDict, Field

from headcap.errors import InputError
from headcap.heads import HeadModel
from headcap.neck.training.expression import ExpressionTrainingSettings, train_expressions
from headcap.neck.training.pose import PoseTrainingSettings, train_pose
from headcap.neck.training_subject import TrainingSubject


class PoseExpressionSettings(BaseModel):
    """Training pose correctives and expressions."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    pose: PoseTrainingSettings = Field(default_factory=PoseTrainingSettings)
    expression: ExpressionTrainingSettings = Field(default_factory=ExpressionTrainingSettings)


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


def _tell(progress: Callable[[str], None] | None, message: str) -> None:
    if progress is not None:
        progress(message)
