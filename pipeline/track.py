"""A chunk of frames to meshes in the model's topology."""

import logging
from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.calibration.result import CalibrationResult
from headcap.reconstruction.cloud_sequence import CloudSequence
from headcap.recordings.takes import IngestedTake
from headcap.registration.anchors import Anchors
from headcap.registration.residuals import TrackResiduals
from headcap.registration.sequence import save_chunk
from headcap.registration.template import Template
from headcap.registration.track_settings import TrackSettings
from headcap.registration.tracker import track_chunk
from headcap.sync import TimeOffsets
from headcap.sync.timeline import TakeTimeline, open_take

PROGRESS = logging.getLogger("headcap.progress")


def run(
    *,
    start: Path,
    anchors: Path,
    clouds: list[Path],
    ingested: Path,
    offsets: Path,
    timeline: Path,
    rig: Path,
    meshes: Path,
    residuals: Path,
    chunk: tuple[int, int],
    settings: TrackSettings,
) -> None:
    whole, points = TakeTimeline.load(timeline), CloudSequence.load(*clouds)
    first, last = whole.span(*chunk)
    coarse = Anchors.load(anchors, first - 1, last + 1)
    PROGRESS.info("track %s: frames %d to %d", whole.take, whole.frames[first], whole.frames[last])
    with open_take(IngestedTake.load(ingested), TimeOffsets.load(offsets)) as take:
        positions, left = track_chunk(
            Template.load(start), coarse, CalibrationResult.load(rig).rig, take, points.at, first, last, settings
        )
    by_frame = TrackResiduals.of(whole.take, whole.time_s[first : last + 1], left)
    by_frame.save(residuals)
    save_chunk(meshes, positions)
    for artifact, kind, figures in ((residuals, "track_residuals", {}), (meshes, "mesh_chunk", by_frame.worst)):
        write_manifest(
            artifact,
            kind=kind,
            stage="track",
            settings_digest=digest_settings(settings=settings, chunk=chunk),
            inputs=[start, anchors, *clouds, ingested, offsets, timeline, rig],
            figures=figures,
        )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
