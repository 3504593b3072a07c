"""What a report is made of."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import Manifest
from headcap.calibration.detection import CameraDetections
from headcap.calibration.result import CalibrationResult
from headcap.cameras import Camera
from headcap.evaluation.metrics import Figure
from headcap.evaluation.tracking import TrackingErrors
from headcap.reconstruction.points import PointCloud
from headcap.registration.residuals import TrackResiduals
from headcap.registration.template import Template
from headcap.sync.offsets import TimeOffsets


@dataclass(frozen=True)
class FrameView:
    """One camera's photograph of a sampled frame, with what was made of it."""

    frame: int
    time_s: float
    camera: Camera
    photograph: NDArray[np.uint8]
    """(height, width, 3) RGB."""
    vertices: NDArray[np.float32]
    """(n, 3) tracked mesh, rig's world."""
    cloud: PointCloud | None
    error_mm: NDArray[np.float32] | None
    """(n,) distance to the true surface, NaN where there is none; None without truth."""


@dataclass(frozen=True)
class CloudGaps:
    """Distance of reconstructed points to the tracked mesh, per frame that has both."""

    frames: NDArray[np.int64]
    median_mm: NDArray[np.float64]
    p95_mm: NDArray[np.float64]


@dataclass(frozen=True)
class TakeReport:
    """One take."""

    take: str
    kind: str
    frames: int
    offsets: TimeOffsets
    true_start_s: dict[str, float] | None
    views: tuple[FrameView, ...]
    gaps: CloudGaps | None
    errors: TrackingErrors | None
    neutral: NDArray[np.float32]
    """(n, 3) the first tracked mesh, on which errors over time are shown."""
    residuals: TrackResiduals | None = None
    """What the tracker was left with in each frame."""
    sync_figure: NDArray[np.uint8] | None = None
    """(height, width, 3) RGB: what sync drew of the clap."""


@dataclass(frozen=True)
class BoardPicture:
    """A photograph of the board with what the calibration makes of it."""

    camera: str
    frame: int
    photograph: NDArray[np.uint8]
    """(height, width, 3) RGB."""
    detected_px: NDArray[np.float64]
    """(n, 2) corners found."""
    predicted_px: NDArray[np.float64]
    """(n, 2) the same corners by the calibrated camera and the board's pose."""


@dataclass(frozen=True)
class CalibrationReport:
    """The rig, its figures and pictures."""

    result: CalibrationResult
    detections: tuple[CameraDetections, ...] = ()
    pictures: tuple[BoardPicture, ...] = ()


@dataclass(frozen=True)
class RegisterReport:
    """The registered template beside the scan, both in metres in one frame."""

    template: Template
    scan_vertices: NDArray[np.float64] | None = None
    scan_triangles: NDArray[np.int32] | None = None
    error_mm: NDArray[np.float64] | None = None
    """(n,) template vertices to the scan's surface, NaN where it has none."""


@dataclass(frozen=True)
class ReportInputs:
    """Everything a session's report shows; parts that a run has not made are left out."""

    session: str
    subject: str
    rate_hz: float
    figures: tuple[Figure, ...]
    calibration: CalibrationReport | None = None
    register: RegisterReport | None = None
    takes: tuple[TakeReport, ...] = ()
    neck_pictures: tuple[NDArray[np.uint8], ...] = ()
    """(height, width, 3) RGB: coefficients of the neck model over the takes; the same predicted from the voice."""
    allowed: tuple[str, ...] = ()
    """Gates the session waives by name."""
    rehearsed: bool = False
    """True where the recordings were rendered: the figures then tell what to expect from such a rig."""
    manifests: tuple[tuple[str, Manifest], ...] = ()
    """Path of each artifact from the results folder, and its manifest."""
    versions: dict[str, str] = field(default_factory=dict)
    settings: dict = field(default_factory=dict)
