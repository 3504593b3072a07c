"""What one camera of the rig shows of a take to a base track: the tracker that anybody with a single video has."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.calibration.result import CalibrationResult
from headcap.heads import HeadModel
from headcap.lips.clips import frontal_camera, rig_clip
from headcap.lips.monocular.settings import MonocularSettings
from headcap.lips.monocular.stage import person_of, track_clip
from headcap.recordings.takes import IngestedTake
from headcap.registration.template import Template
from headcap.sync import TimeOffsets
from headcap.sync.timeline import TakeTimeline


def run(
    *,
    base: Path,
    turned: list[Path],
    rig: Path,
    start: Path,
    ingested: Path,
    offsets: Path,
    timeline: Path,
    track: Path,
    camera: Path,
    picture: Path,
    name: str | None,
    who_alone: bool,
    settings: MonocularSettings,
) -> None:
    cameras = CalibrationResult.load(rig).rig
    chosen = cameras[name or frontal_camera(cameras, Template.load(start))]
    clip = rig_clip(chosen, IngestedTake.load(ingested), TimeOffsets.load(offsets), TakeTimeline.load(timeline))
    figures = track_clip(
        HeadModel.load(base), clip, settings, track, camera, picture, person=person_of(turned), who_alone=who_alone
    )
    for artifact, kind in ((camera, "rig"), (track, "monocular_track")):
        write_manifest(
            artifact,
            kind=kind,
            stage="track_monocular",
            settings_digest=digest_settings(settings=settings, name=name),
            inputs=[base, *turned, rig, start, ingested, offsets, timeline],
            figures=figures,
        )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
