"""Photographs of a chunk of frames to point clouds."""

import logging
from pathlib import Path
from statistics import median

from headcap.artifacts import digest_settings, write_manifest
from headcap.artifacts.gates import enforce, judge
from headcap.calibration.result import CalibrationResult
from headcap.reconstruction.cloud_sequence import CloudSequence, cloud_file
from headcap.reconstruction.frame import reconstruct_frame
from headcap.reconstruction.settings import ReconstructSettings
from headcap.recordings.silhouettes import read_silhouettes
from headcap.recordings.takes import IngestedTake
from headcap.sync import TimeOffsets
from headcap.sync.timeline import TakeTimeline, open_take

PROGRESS = logging.getLogger("headcap.progress")
# towards a take's end cameras that started early have stopped; the tracker then goes on without a cloud
LEAST_CAMERAS = 3


def run(
    *,
    ingested: Path,
    offsets: Path,
    timeline: Path,
    rig: Path,
    checked: Path,
    clouds: Path,
    chunk: tuple[int, int],
    masks: str | None,
    limits: dict[str, float],
    allow: tuple[str, ...],
    settings: ReconstructSettings,
) -> None:
    calibrated = CalibrationResult.load(rig).rig
    part = TakeTimeline.load(timeline).part(*chunk)
    done, counts = [], []
    with open_take(IngestedTake.load(ingested), TimeOffsets.load(offsets)) as take:
        for frame, time_s in zip(part.frames.tolist(), part.time_s.tolist(), strict=True):
            images = take.images_at(time_s)
            if len(images) < LEAST_CAMERAS:
                PROGRESS.info("reconstruct %s frame %d: only %d cameras saw it", part.take, frame, len(images))
                continue
            cloud = reconstruct_frame(
                calibrated.only(images),
                list(images.values()),
                time_s=time_s,
                settings=settings,
                masks=read_silhouettes(masks, frame, list(images)) if masks else None,
            )
            file = cloud_file(clouds.parent, frame)
            cloud.save(file)
            done.append((frame, time_s, file))
            counts.append(len(cloud))
            PROGRESS.info("reconstruct %s frame %d: %d points", part.take, frame, len(cloud))
    figures = {"reconstruct.points": median(counts)} if counts else {}
    enforce(
        judge(figures, limits, allow),
        f"{part.take}, frames {part.frames[0]} to {part.frames[-1]}: check exposure and focus of the recordings.",
    )
    CloudSequence.of(part.take, done).save(clouds)
    write_manifest(
        clouds,
        kind="cloud_sequence",
        stage="reconstruct",
        settings_digest=digest_settings(settings=settings),
        inputs=[ingested, offsets, timeline, rig],
        figures=figures,
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
