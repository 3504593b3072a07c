"""Tracked speech takes of several people to the neck model that they share."""

import logging
from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.heads.model import HeadModel
from headcap.neck.figure import save_training_figure
from headcap.neck.subjects import SubjectFiles
from headcap.neck.training.study import NeckTrainingSettings, train_neck

PROGRESS = logging.getLogger("headcap.progress")


def run(
    *,
    files: list[Path],
    head: Path,
    model: Path,
    figure: Path,
    people: list[SubjectFiles],
    settings: NeckTrainingSettings,
) -> None:
    base = HeadModel.load(head)
    subjects = [person.load(base) for person in people]
    for subject in subjects:
        PROGRESS.info("train_neck: %d frames of %s", len(subject.meshes("speech")), subject.name)
    training = train_neck(base, subjects, settings, scratch=model.parent)
    save_training_figure(figure, training)
    training.model.save(model)
    write_manifest(
        model,
        kind="neck_model",
        stage="train_neck",
        settings_digest=digest_settings(settings=settings),
        inputs=[head, *files],
        figures={},
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
