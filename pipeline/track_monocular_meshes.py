"""The video that came with a mesh subject's take to a base track."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.calibration.result import load_camera
from headcap.heads import HeadModel
from headcap.lips.clips import video_clip
from headcap.lips.monocular.settings import MonocularSettings
from headcap.lips.monocular.stage import person_of, track_clip


def run(
    *,
    base: Path,
    turned: list[Path],
    files: list[Path],
    track: Path,
    camera: Path,
    picture: Path,
    video: Path,
    filmed_by: Path,
    who_alone: bool,
    settings: MonocularSettings,
) -> None:
    figures = track_clip(
        HeadModel.load(base),
        video_clip(video, load_camera(filmed_by)),
        settings,
        track,
        camera,
        picture,
        person=person_of(turned),
        who_alone=who_alone,
    )
    for artifact, kind in ((camera, "rig"), (track, "monocular_track")):
        write_manifest(
            artifact,
            kind=kind,
            stage="track_monocular",
            settings_digest=digest_settings(settings=settings),
            inputs=[base, *turned, *files],
            figures=figures,
        )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
