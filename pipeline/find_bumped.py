"""The still beginning of a take against the calibration: cameras that moved, files that were exchanged."""

from pathlib import Path

from headcap.artifacts import digest_settings, save_json, write_manifest
from headcap.calibration.bump import find_bumped
from headcap.calibration.result import CalibrationResult
from headcap.calibration.settings import BumpSettings
from headcap.recordings.takes import IngestedTake
from headcap.sync import TimeOffsets
from headcap.sync.timeline import TakeTimeline, open_take

GATE = "calibrate.bump_residual_px"


def run(
    *,
    rig: Path,
    ingested: Path,
    offsets: Path,
    timeline: Path,
    checked: Path,
    allow: tuple[str, ...],
    settings: BumpSettings,
) -> None:
    moments = TakeTimeline.load(timeline)
    with open_take(IngestedTake.load(ingested), TimeOffsets.load(offsets)) as take:
        images = take.images_at(float(moments.time_s[0]))
    calibrated = CalibrationResult.load(rig).rig.only(images)
    report = find_bumped(calibrated, list(images.values()), settings)
    if GATE not in allow:
        report.require_unmoved(moments.take)
    save_json(checked, "bump_check", 1, {"take": moments.take, "bumped": list(report.bumped)})
    write_manifest(
        checked,
        kind="bump_check",
        stage="find_bumped",
        settings_digest=digest_settings(settings=settings),
        inputs=[rig, ingested, offsets, timeline],
        figures=report.figures(),
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
