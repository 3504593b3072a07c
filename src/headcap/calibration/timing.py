"""Time offsets of cameras from the moving board: what each camera's picture says against what its sound said."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.linalg import LinAlgError
from numpy.typing import NDArray

from headcap.calibration.board import BoardSettings
from headcap.calibration.detection import CameraDetections
from headcap.calibration.motion import MotionFit, fit_motion
from headcap.calibration.settings import TimingSettings
from headcap.cameras import Rig
from headcap.sync.offsets import TimeOffsets

Array = NDArray[np.float64]
MOVING_PX_S = 100.0


@dataclass(frozen=True)
class VisualTiming:
    """Visual minus audible time of each camera, seconds, the common mean taken out."""

    cameras: tuple[str, ...]
    av_offset_s: tuple[float, ...]
    """To add to the common times of the pictures."""
    sigma_s: tuple[float, ...]
    still_px: float
    """Median rms residual of slow sightings."""
    moving_px: float
    """Median rms residual of fast sightings."""

    def by_camera(self) -> dict[str, float]:
        """Offsets by camera."""
        return dict(zip(self.cameras, self.av_offset_s, strict=True))

    def apply(self, offsets: TimeOffsets) -> TimeOffsets:
        """Offsets whose common times are those of the pictures."""
        own = self.by_camera()
        start = tuple(s + own.get(c, 0.0) for c, s in zip(offsets.cameras, offsets.start_s, strict=True))
        return TimeOffsets(offsets.take, offsets.cameras, start, offsets.drift_ppm, offsets.confidence, offsets.method)


def refine_timing(
    rig: Rig, detections: Sequence[CameraDetections], offsets: TimeOffsets, board: BoardSettings, settings: TimingSettings
) -> VisualTiming | None:
    """Offset of each camera's pictures from the motion of the board, with the rig known.

    A camera whose pictures come late sees a moving board behind where the others saw it; still frames say nothing. The
    offsets hold for the middle row of a rolling shutter. None where `moving_enough` or `trusted` says that the recording
    does not carry it.
    """
    if not moving_enough(detections, settings):
        return None
    fit = try_motion(rig, detections, offsets, board, settings)
    return visual_timing(fit) if fit is not None and trusted(fit, settings) else None


def try_motion(
    rig: Rig,
    detections: Sequence[CameraDetections],
    offsets: TimeOffsets,
    board: BoardSettings,
    settings: TimingSettings,
    *,
    free_cameras: bool = False,
    constant_lenses: frozenset[str] = frozenset(),
    without_s: Sequence[tuple[float, float]] = (),
) -> MotionFit | None:
    """`fit_motion`, or None where it has no unique answer."""
    try:
        return fit_motion(
            rig,
            {d.camera: d for d in detections},
            offsets,
            board.corners,
            settings,
            free_cameras=free_cameras,
            constant_lenses=constant_lenses,
            without_s=without_s,
        )
    except (LinAlgError, ValueError):
        return None


def moving_enough(detections: Sequence[CameraDetections], settings: TimingSettings) -> bool:
    """Whether every camera saw the board move in `least_moving` sightings, and all together often enough for a spline."""
    moving = [int((~(d.speed_px_s() <= MOVING_PX_S)).sum()) for d in detections]
    times = np.concatenate([d.own_time_s for d in detections])
    dense = len(times) > 1 and np.ptp(times) * settings.sightings_per_knot / len(times) <= settings.coarsest_knot_s
    return dense and min(moving) >= settings.least_moving


def trusted(fit: MotionFit, settings: TimingSettings) -> bool:
    """Whether fast sightings fit about as well as slow ones: rolling shutters, blur or false frame times show here."""
    timing = visual_timing(fit)
    return bool(np.isfinite(timing.moving_px)) and timing.moving_px <= settings.moving_over_still * timing.still_px


def visual_timing(fit: MotionFit) -> VisualTiming:
    """The offsets of a motion fit."""
    slow = fit.speed_px_s <= MOVING_PX_S
    median = lambda values: float(np.median(values)) if len(values) else float("nan")  # noqa: E731
    still_px, moving_px = median(fit.residual_px[slow]), median(fit.residual_px[~slow])
    return VisualTiming(
        cameras=fit.rig.names,
        av_offset_s=tuple(float(v) for v in fit.offset_s),
        sigma_s=tuple(float(v) for v in fit.offset_sigma_s),
        still_px=moving_px if np.isnan(still_px) else still_px,
        moving_px=moving_px,
    )
