"""Pictures of the people who train, with the contours that their true meshes show, to a detector of lip contours."""

import logging
from pathlib import Path

import numpy as np

from headcap.artifacts import digest_settings, write_manifest
from headcap.heads import HeadModel
from headcap.lips.contours import LipExample, MouthLocator, mesh_examples, train_detector
from headcap.lips.mesh_contours import MeshContours
from headcap.lips.people import LipPersonFiles
from headcap.lips.takes import MouthSpace
from headcap.lips.training import LipTrainingSettings, spread_frames

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
    """A few frames of each take, with the contours that the rig's meshes show there."""
    model, locate = space.model, MouthLocator.of(space.mouth, space.features)
    see = MeshContours.of(np.asarray(model.vertices, float), space.mouth, model.regions)
    loaded, out = person.load(space, contours=False), []
    for take in person.takes:
        clip, truth = take.clip.open(), loaded.takes[take.name].truth()
        chosen = spread_frames(len(clip), settings.pictures_per_take)
        meshes = (np.asarray(mesh, float) if frame in chosen else None for frame, mesh in enumerate(truth))
        out += mesh_examples(person.name, clip.pictures(), meshes, clip.camera, see, locate)
    return out


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
