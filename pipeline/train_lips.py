"""Base tracks, contours and true meshes of the people who train to the regressors that correct lips."""

import logging
from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.heads import HeadModel
from headcap.lips.contours import ContourDetector
from headcap.lips.kit import LipKit
from headcap.lips.monocular import MonocularSettings
from headcap.lips.people import LipPersonFiles
from headcap.lips.takes import MouthSpace
from headcap.lips.training import GENERIC, LipTrainingSettings, RegressorPlan, train_lips

PROGRESS = logging.getLogger("headcap.progress")


def run(
    *,
    base: Path,
    detector: Path,
    files: list[Path],
    regressors: list[Path],
    kit: Path,
    people: list[LipPersonFiles],
    plans: list[RegressorPlan],
    settings: LipTrainingSettings,
    monocular: MonocularSettings,
) -> None:
    space = MouthSpace.of(HeadModel.load(base), settings.mouth)
    loaded = [person.load(space) for person in people]
    for plan, path in zip(plans, regressors, strict=True):
        regressor = train_lips(space, loaded, plan, settings)
        regressor.save(path)
        figures = regressor.regression.figures
        PROGRESS.info(
            "train_lips: %s on %d frames, %.3f rms left out, %.3f by the mean",
            plan.name,
            figures["frames"],
            figures["cross_validation_rms"],
            figures["predicting_mean_rms"],
        )
        write_manifest(
            path,
            kind="lip_regressor",
            stage="train_lips",
            settings_digest=digest_settings(settings=settings),
            inputs=[base, *files],
            figures=figures,
        )
        if plan.name == GENERIC:
            LipKit(space.model, ContourDetector.load(detector), regressor, monocular, settings.search).save(kit)
    write_manifest(
        kit,
        kind="lip_kit",
        stage="train_lips",
        settings_digest=digest_settings(settings=settings, monocular=monocular),
        inputs=[base, detector, *files],
        figures={},
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
