"""Pictures of the people who train, with the contours that their true meshes show, to a detector of lip contours."""

import logging
from pathlib import Path

import numpy as np

from headcap.artifacts import digest_settings, write_manifest
from headcap.heads import HeadModel
from headcap.lips.contours import LipExample, MouthLocator, train_detector
from headcap.lips.contours.examples import labelled_pictures, spread_frames
from headcap.lips.mesh_contours import MeshContours
from headcap.lips.people import LipPersonFiles
from headcap.lips.takes import MouthSpace
from headcap.lips.training import LipTrainingSettings

PROGRESS = logging.getLogger("headcap.progress")


def run(*, base: Path, files: list[Path], detector: Path, people: list[LipPersonFiles], settings: LipTrainingSettings) -> None:
    space = MouthSpace.of(HeadModel.load(base), settings.mouth)
    examples = [example for person in people for example in _examples(person, space, settings)]
    found = train_detector(examples, settings.contours)
    PROGRESS.info("train_contours: %d pictures of %d people", len(examples), len(people))
    found.save(detector)
    write_manifest(
        detector,
        kind="lip_contour_detector",
        stage="train_contours",
        settings_digest=digest_settings(settings=settings),
        inputs=[base, *files],
        figures={},
    )


def _examples(person: LipPersonFiles, space: MouthSpace, settings: LipTrainingSettings) -> list[LipExample]:
    model, out = space.model, []
    locator = MouthLocator.of(space.mouth, space.features)
    contours = MeshContours.of(np.asarray(model.vertices, float), space.mouth, model.regions)
    loaded = person.load(space, contours=False)
    for take in person.takes:
        clip, own = take.clip.open(), loaded.takes[take.name]
        chosen = spread_frames(len(clip), settings.pictures_per_take)
        base = own.seen.base.world(own.seen.base.meshes)
        out += labelled_pictures(clip.pictures(), base, own.truth(), clip.camera, locator, contours, person.name, chosen)
    return out


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
