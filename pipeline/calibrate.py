"""Sightings of the board to the rig, and to start times of the board's recordings by the board's motion."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.calibration.board import BoardSettings
from headcap.calibration.board_timing import refine_timing
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
    timing: Path,
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
    refine_timing(result.rig, seen, heard, board, settings.timing).save(timing)
    for name, target in (("colmap", colmap_cameras.parent), ("opencv_yaml", opencv)):
        write_rig(result.rig, target, name)
    result.save(rig)
    digest = digest_settings(settings=settings, board=board, intrinsics=intrinsics)
    for artifact, kind, figures in ((rig, "rig", result.figures()), (timing, "time_offsets", {})):
        write_manifest(
            artifact,
            kind=kind,
            stage="calibrate",
            settings_digest=digest,
            inputs=[*detections, offsets],
            figures=figures,
        )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
