"""A take's photographs to its coarse trajectory: where every frame of every chunk starts from."""

import logging
from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.calibration.result import CalibrationResult
from headcap.reconstruction.cloud_sequence import CloudSequence
from headcap.recordings.takes import IngestedTake
from headcap.registration.template import Template
from headcap.registration.track_settings import TrackSettings
from headcap.registration.tracker import track_anchors
from headcap.sync import TimeOffsets
from headcap.sync.timeline import TakeTimeline, open_take

PROGRESS = logging.getLogger("headcap.progress")


def run(
    *,
    start: Path,
    clouds: list[Path],
    ingested: Path,
    offsets: Path,
    timeline: Path,
    rig: Path,
    anchors: Path,
    settings: TrackSettings,
) -> None:
    moments, points = TakeTimeline.load(timeline), CloudSequence.load(*clouds)
    calibrated, template = CalibrationResult.load(rig).rig, Template.load(start)
    PROGRESS.info("track %s: coarse pass over %d frames", moments.take, len(moments))
    with open_take(IngestedTake.load(ingested), TimeOffsets.load(offsets)) as take:
        track_anchors(template, calibrated, take, points.at, moments.time_s, settings).save(anchors)
    write_manifest(
        anchors,
        kind="anchors",
        stage="track_anchors",
        settings_digest=digest_settings(settings=settings),
        inputs=[start, *clouds, ingested, offsets, timeline, rig],
        figures={},
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
