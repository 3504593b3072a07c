"""Tracked speech takes to the person's neck model."""

import logging
from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.calibration.result import CalibrationResult
from headcap.neck.figure import save_neck_figure
from headcap.neck.person_training import NeckTrainingSettings, train_person
from headcap.registration.sequence import MeshSequence
from headcap.registration.template import Template

PROGRESS = logging.getLogger("headcap.progress")


def run(
    *,
    template: Path,
    rig: Path,
    sequences: list[Path],
    model: Path,
    fits: Path,
    figure: Path,
    person: str,
    settings: NeckTrainingSettings,
) -> None:
    loaded = {sequence.take: sequence for sequence in map(MeshSequence.load, sequences)}
    PROGRESS.info("train_neck: %d frames of %s", sum(map(len, loaded.values())), ", ".join(loaded))
    neutral = Template.load(template)
    training, fitted = train_person(person, neutral, loaded, settings, rig=CalibrationResult.load(rig).rig)
    save_neck_figure(figure, training, fitted)
    fitted.save(fits)
    training.model.save(model)
    for artifact, kind, figures in ((fits, "neck_fits", fitted.figures()), (model, "neck_model", {})):
        write_manifest(
            artifact,
            kind=kind,
            stage="train_neck",
            settings_digest=digest_settings(settings=settings),
            inputs=[template, rig, *sequences],
            figures=figures,
        )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
