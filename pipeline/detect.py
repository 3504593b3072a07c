"""One camera's recording of the board to the board's corners."""

from pathlib import Path

from headcap.artifacts import digest_settings, write_manifest
from headcap.calibration.board import BoardSettings
from headcap.calibration.detection import detect_recording
from headcap.calibration.settings import DetectSettings
from headcap.recordings.takes import IngestedTake
from headcap.sync import TimeOffsets


def run(*, ingested: Path, offsets: Path, detections: Path, camera: str, board: BoardSettings, settings: DetectSettings) -> None:
    recording = IngestedTake.load(ingested)[camera]
    start_s = float(TimeOffsets.load(offsets).common_time(camera, 0.0))
    found = detect_recording(recording.path, board, camera, settings=settings, start_s=start_s, times_s=recording.frame_times_s)
    found.save(detections)
    write_manifest(
        detections,
        kind="camera_detections",
        stage="detect",
        settings_digest=digest_settings(settings=settings, board=board),
        inputs=[ingested, offsets],
        figures={},
    )


if "snakemake" in globals():
    from adapter import run_rule

    run_rule(run, snakemake)  # noqa: F821
