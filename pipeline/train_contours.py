"""Pictures of the people who train, with the contours that their true meshes show, to a detector of lip contours."""

import logging
from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.heads import HeadModel
from headcap.lips.contours import train_detector
from headcap.lips.people import LipPersonFiles
from headcap.lips.takes import MouthSpace
from headcap.lips.training import LipTrainingSettings, contour_examples

PROGRESS = logging.getLogger("headcap.progress")


def run(
    *,
    base: Path,
    files: list[Path],
    labels: list[Path],
    detector: Path,
    people: list[LipPersonFiles],
    settings: LipTrainingSettings,
) -> None:
    space = MouthSpace.of(HeadModel.load(base), settings.mouth)
    examples = [example for person in people for example in contour_examples(person, space, settings)]
    found = train_detector(examples, settings.contours)
    PROGRESS.info("train_contours: %d pictures of %d people", len(examples), len(people))
    found.save(detector)
    write_manifest(
        detector,
        kind="lip_contour_detector",
        stage="train_contours",
        settings_digest=digest_settings(settings=settings),
        inputs=[base, *files, *labels],
        figures={},
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
