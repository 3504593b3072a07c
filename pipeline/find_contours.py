"""Lip contours in what one camera saw of a take."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.heads import HeadModel
from headcap.lips.clips import ClipFiles
from headcap.lips.contours import ContourDetector, ContourFinder, MouthLocator, find_contours
from headcap.lips.monocular import MonocularTrack
from headcap.lips.takes import MouthSpace
from headcap.lips.training import LipTrainingSettings


def run(
    *,
    base: Path,
    detector: Path,
    track: Path,
    files: list[Path],
    contours: Path,
    clip: ClipFiles,
    settings: LipTrainingSettings,
) -> None:
    space, opened = MouthSpace.of(HeadModel.load(base), settings.mouth), clip.open()
    finder = ContourFinder(ContourDetector.load(detector), MouthLocator.of(space.mouth, space.features), settings.search)
    found = find_contours(finder, opened.pictures(), MonocularTrack.load(track).meshes(space.model), opened.camera)
    found.save(contours)
    write_manifest(
        contours,
        kind="lip_contours",
        stage="find_contours",
        settings_digest=digest_settings(settings=settings),
        inputs=[base, detector, track, *files],
        figures={"lips.contours_found": float(found.found.mean())},
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
