"""Sightings of the board to the rig, with each camera's time offset by the board's motion."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.calibration.board import BoardSettings
from headcap.calibration.detection import CameraDetections
from headcap.calibration.known import known_lenses
from headcap.calibration.result import check_gates
from headcap.calibration.settings import CalibrateSettings
from headcap.calibration.solve import calibrate
from headcap.cameras.formats import write_rig
from headcap.sync import TimeOffsets


def run(
    *,
    detections: list[Path],
    offsets: Path,
    rig: Path,
    colmap_cameras: Path,
    opencv: Path,
    board: BoardSettings,
    intrinsics: dict[str, dict],
    allow: tuple[str, ...],
    settings: CalibrateSettings,
) -> None:
    seen, heard = [CameraDetections.load(path) for path in detections], TimeOffsets.load(offsets)
    result = calibrate(seen, heard, board, settings, known_lenses=known_lenses(intrinsics, seen))
    check_gates(result, settings.limits, allow)
    for name, target in (("colmap", colmap_cameras.parent), ("opencv_yaml", opencv)):
        write_rig(result.rig, target, name)
    result.save(rig)
    write_manifest(
        rig,
        kind="rig",
        stage="calibrate",
        settings_digest=digest_settings(settings=settings, board=board, intrinsics=intrinsics),
        inputs=[*detections, offsets],
        figures=result.figures(),
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
