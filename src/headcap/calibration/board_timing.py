"""Start times of the board's recordings by the board's motion: what the sound of the same recordings is held against."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from headcap.calibration.board import BoardSettings
from headcap.calibration.detection import CameraDetections
from headcap.calibration.motion import fit_motion
from headcap.calibration.settings import TimingSettings
from headcap.cameras import Rig
from headcap.sync.offsets import TimeOffsets


def refine_timing(
    rig: Rig, detections: Sequence[CameraDetections], offsets: TimeOffsets, board: BoardSettings, settings: TimingSettings
) -> TimeOffsets:
    """Start times that let all cameras of a known rig see the board move along one trajectory."""
    seen = {found.camera: found for found in detections}
    fit = fit_motion(rig, seen, offsets, board.corners, settings, free_cameras=False)
    moved = dict(zip(rig.names, fit.offset_s.tolist(), strict=True))
    start_s = tuple(start + moved.get(camera, 0.0) for camera, start in zip(offsets.cameras, offsets.start_s, strict=True))
    method = tuple("board" if camera in moved else old for camera, old in zip(offsets.cameras, offsets.method, strict=True))
    return replace(offsets, start_s=start_s, method=method)
