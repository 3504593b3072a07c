"""Tracked pose and expression takes of several people to a head model that knows how necks follow (section 5.1)."""

import logging
from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.heads import HeadModel
from headcap.neck.subjects import SubjectFiles
from headcap.neck.training.pose_expression import PoseExpressionSettings, train_pose_expression

PROGRESS = logging.getLogger("headcap.progress")


def run(*, base: Path, files: list[Path], head: Path, people: list[SubjectFiles], settings: PoseExpressionSettings) -> None:
    model = HeadModel.load(base)
    subjects = [person.load(model).training_subject() for person in people]
    if any(subject.trains for subject in subjects):
        model = train_pose_expression(model, subjects, settings, progress=_tell)
    else:
        _tell("no pose and no expression takes: pose correctives and expressions stay generic")
    model.save(head)
    write_manifest(
        head,
        kind="head_model",
        stage="train_expressions",
        settings_digest=digest_settings(settings=settings),
        inputs=[base, *files],
        figures={},
    )


def _tell(message: str) -> None:
    PROGRESS.info("train_expressions: %s", message)


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
