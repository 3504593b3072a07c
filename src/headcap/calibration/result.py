"""What calibrate hands on: the rig, how well it is known, and the gate."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_json, save_json
from headcap.calibration.settings import CalibrateLimits
from headcap.cameras import Camera, Rig
from headcap.errors import GateFailure, InputError

Array = NDArray[np.float64]
KIND, SCHEMA = "rig", 1


@dataclass(frozen=True)
class CameraFigures:
    """How well one camera is known; pixels of reprojection are in poses left out of the adjustment."""

    camera: str
    heldout_rms_px: float | None
    """None where no held-out pose was seen."""
    heldout_p95_px: float | None
    coverage: float
    """Share of the image's cells in which board corners were seen, 0 to 1."""
    poses: int
    corners: int
    rejected: int
    """Corners left out as outliers."""
    av_offset_s: float | None = None
    """Visual minus audible time, the mean over cameras taken out; None where the board's motion does not tell."""
    av_offset_sigma_s: float | None = None


@dataclass(frozen=True)
class SolvedPose:
    """One board pose of the final adjustment."""

    time_s: float
    """Common time."""
    world_from_board: Array
    """(4, 4)."""
    frames: dict[str, int]
    """Frame number by camera."""


@dataclass(frozen=True)
class CalibrationResult:
    """The calibrated rig in its canonical frame and its figures."""

    rig: Rig
    cameras: tuple[CameraFigures, ...]
    heldout_rms_px: float
    heldout_p95_px: float
    board_scale_error_mm: float
    heldout_poses: int
    poses: tuple[SolvedPose, ...]

    def figures(self) -> dict[str, float]:
        """Figures by their names in metrics.json; minima and maxima are over cameras."""
        named = {
            "calibrate.heldout_rms_px": self.heldout_rms_px,
            "calibrate.heldout_p95_px": self.heldout_p95_px,
            "calibrate.board_scale_error_mm": self.board_scale_error_mm,
            "calibrate.coverage": min(c.coverage for c in self.cameras),
            "calibrate.poses": float(min(c.poses for c in self.cameras)),
        }
        return {name: float(value) for name, value in named.items() if np.isfinite(value)}

    def av_offset_s(self) -> dict[str, float] | None:
        """Visual minus audible time by camera, None where the board's motion does not tell."""
        if any(camera.av_offset_s is None for camera in self.cameras):
            return None
        return {camera.camera: camera.av_offset_s for camera in self.cameras}

    def save(self, path: Path | str) -> None:
        """Write as JSON artifact `headcap.rig/1`."""
        content = {
            **self.rig.to_json(),
            "figures": self.figures(),
            "camera_figures": [asdict(c) for c in self.cameras],
            "heldout_poses": self.heldout_poses,
            "poses": [
                {"time_s": p.time_s, "world_from_board": p.world_from_board.tolist(), "frames": p.frames} for p in self.poses
            ],
        }
        save_json(path, KIND, SCHEMA, content)

    @classmethod
    def load(cls, path: Path | str) -> CalibrationResult:
        """Read what `save` wrote; raises `ArtifactError`."""
        content = load_json(path, KIND, SCHEMA)
        figures = content["figures"]
        return cls(
            rig=Rig.from_json(content),
            cameras=tuple(CameraFigures(**c) for c in content["camera_figures"]),
            heldout_rms_px=figures.get("calibrate.heldout_rms_px", float("nan")),
            heldout_p95_px=figures.get("calibrate.heldout_p95_px", float("nan")),
            board_scale_error_mm=figures.get("calibrate.board_scale_error_mm", float("nan")),
            heldout_poses=content["heldout_poses"],
            poses=tuple(SolvedPose(p["time_s"], np.array(p["world_from_board"]), p["frames"]) for p in content["poses"]),
        )


def save_cameras(path: Path | str, rig: Rig) -> None:
    """Write cameras of whose calibration nothing is known as JSON artifact `headcap.rig/1`."""
    unknown = {"figures": {}, "camera_figures": [], "heldout_poses": 0, "poses": []}
    save_json(path, KIND, SCHEMA, rig.to_json() | unknown)


def load_camera(path: Path | str, name: str | None = None) -> Camera:
    """A camera of a rig's file, by name where there are several; raises `ArtifactError`, `InputError` for a name it has not."""
    rig = Rig.from_json(load_json(path, KIND, SCHEMA))
    name = name if name or len(rig) > 1 else rig.names[0]
    if name not in rig.names:
        raise InputError(
            f"camera {name}" if name else f"a rig of {len(rig)} cameras without a camera's name",
            expected=f"one of {', '.join(rig.names)}",
            remedy="Give the name of the camera that took the picture.",
        )
    return rig[name]


_REMEDY = {
    "heldout_rms_px": "Check that its focus and zoom were fixed and that the board is flat; record the board again",
    "heldout_p95_px": "Check that its start time is right and that the board was held still; record the board again",
    "coverage": "Hold the board in all parts of this camera's image",
    "poses": "Hold the board still more often where this camera sees it",
    "board_scale_error_mm": "Measure the printed squares and check that the board is flat",
}


def check_gates(result: CalibrationResult, limits: CalibrateLimits, allow: tuple[str, ...] = ()) -> tuple[str, ...]:
    """One line for each camera's figure past its limit; raises `GateFailure` unless `allow` waives it.

    `allow` holds names as in `figures()`, e.g. calibrate.coverage.
    """
    failed: dict[str, list[str]] = {}
    for camera in result.cameras:
        for name in ("heldout_rms_px", "heldout_p95_px", "coverage", "poses"):
            value, limit = getattr(camera, name), getattr(limits, name)
            if _fails(name, value, limit):
                failed.setdefault(name, []).append(_line(camera.camera, name, value, limit))
    if _fails("board_scale_error_mm", result.board_scale_error_mm, limits.board_scale_error_mm):
        line = _line("all cameras", "board_scale_error_mm", result.board_scale_error_mm, limits.board_scale_error_mm)
        failed["board_scale_error_mm"] = [line]
    refused = [line for name, lines in failed.items() if f"calibrate.{name}" not in allow for line in lines]
    if refused:
        raise GateFailure("\n".join(refused))
    return tuple(line for lines in failed.values() for line in lines)


def _fails(name: str, value: float | None, limit: float) -> bool:
    if value is None or not np.isfinite(value):
        # a camera or rig without any held-out view is caught by the number of its poses
        return False
    return value < limit if name in ("coverage", "poses") else value > limit


def _line(who: str, name: str, value: float, limit: float) -> str:
    sense = "at least" if name in ("coverage", "poses") else "at most"
    return f"{who}: calibrate.{name} is {value:.4g}; expected {sense} {limit:g}. {_REMEDY[name]}."
