"""Pictures for the report: corners over a photograph with magnified residuals, and where corners were seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.calibration.board import BoardSettings
from headcap.calibration.detection import CameraDetections
from headcap.calibration.grouping import COVERAGE_CELLS, cell_count, image_cells
from headcap.calibration.result import CalibrationResult, SolvedPose
from headcap.cameras import Camera
from headcap.geometry.transforms import transform

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
GREEN, RED, WHITE = (90, 200, 90), (60, 60, 230), (240, 240, 240)


def seen_corners(detections: CameraDetections, pose: SolvedPose) -> tuple[NDArray[np.int64], Array]:
    """Corner indices (n,) and pixels (n, 2) that one camera contributed to a pose; empty if none."""
    frame = pose.frames.get(detections.camera)
    rows = np.flatnonzero(detections.frame == frame) if frame is not None else []
    if not len(rows):
        return np.empty(0, np.int64), np.empty((0, 2))
    view = detections.view(int(rows[0]))
    return view.corner, view.pixels


def reprojection_overlay(
    image: Image | None,
    camera: Camera,
    detections: CameraDetections,
    pose: SolvedPose,
    board: BoardSettings,
    *,
    magnified: float = 50.0,
) -> Image:
    """BGR (h, w, 3): seen corners as circles, and lines to where the calibrated camera projects them, `magnified` times.

    Without an image the ground is dark. Corners off by more than half a pixel are red.
    """
    picture = np.full((camera.height, camera.width, 3), 30, np.uint8) if image is None else image.copy()
    corner, pixels = seen_corners(detections, pose)
    residual = camera.project(transform(pose.world_from_board, board.corners[corner]))[0] - pixels
    unit = max(1, round(max(camera.size) / 600))
    for place, off in zip(pixels, residual, strict=True):
        colour = RED if np.linalg.norm(off) > 0.5 else GREEN
        cv2.circle(picture, _point(place), 4 * unit, colour, unit, cv2.LINE_AA)
        cv2.line(picture, _point(place), _point(place + magnified * off), colour, unit, cv2.LINE_AA)
    if len(pixels):
        rms = float(np.sqrt((residual**2).sum(1).mean()))
        _write(picture, f"{camera.name}  rms {rms:.2f} px  residuals x{magnified:g}", unit)
    return picture


def coverage_overlay(camera: Camera, detections: CameraDetections, result: CalibrationResult) -> Image:
    """BGR (h, w, 3): every corner used, over cells that are lit where any was seen."""
    picture = np.full((camera.height, camera.width, 3), 30, np.uint8)
    pixels = np.concatenate([np.empty((0, 2)), *(seen_corners(detections, pose)[1] for pose in result.poses)])
    side = min(camera.size) / COVERAGE_CELLS
    columns = int(np.ceil(camera.width / side - 1e-9))
    lit = np.unique(image_cells(pixels, *camera.size))
    for cell in lit:
        x, y = (cell % columns) * side, (cell // columns) * side
        cv2.rectangle(picture, _point((x + 1, y + 1)), _point((x + side - 2, y + side - 2)), (70, 60, 45), -1)
    unit = max(1, round(max(camera.size) / 600))
    for place in pixels:
        cv2.circle(picture, _point(place), unit, GREEN, -1, cv2.LINE_AA)
    _write(picture, f"{camera.name}  {100 * len(lit) / cell_count(*camera.size):.0f} % covered", unit)
    return picture


def contact_sheet(pictures: Sequence[Image], *, columns: int = 8, height: int = 320) -> Image:
    """Pictures of any size side by side, each `height` high, in rows of `columns`."""
    small = [cv2.resize(p, (round(p.shape[1] * height / p.shape[0]), height), interpolation=cv2.INTER_AREA) for p in pictures]
    width = max(p.shape[1] for p in small)
    padded = [cv2.copyMakeBorder(p, 2, 2, 2, width - p.shape[1] + 2, cv2.BORDER_CONSTANT) for p in small]
    blank = np.zeros_like(padded[0])
    rows = [padded[i : i + columns] for i in range(0, len(padded), columns)]
    return np.vstack([np.hstack([*row, *[blank] * (min(columns, len(padded)) - len(row))]) for row in rows])


def best_seen_pose(result: CalibrationResult, detections: CameraDetections) -> SolvedPose | None:
    """The pose of which a camera saw most corners, for its overlay; None if it saw none."""
    counts = [len(seen_corners(detections, pose)[0]) for pose in result.poses]
    return result.poses[int(np.argmax(counts))] if counts and max(counts) else None


def overlays(
    result: CalibrationResult, detections: Sequence[CameraDetections], board: BoardSettings, images: Mapping[str, Image]
) -> dict[str, Image]:
    """Two contact sheets by name: `reprojection` (over `images` by camera, where given) and `coverage`."""
    seen = {d.camera: d for d in detections}
    shown = []
    for camera in result.rig:
        pose = best_seen_pose(result, seen[camera.name])
        if pose is not None:
            shown.append(reprojection_overlay(images.get(camera.name), camera, seen[camera.name], pose, board))
    sheets = {"coverage": contact_sheet([coverage_overlay(c, seen[c.name], result) for c in result.rig])}
    if shown:
        sheets["reprojection"] = contact_sheet(shown)
    return sheets


def _point(place: Array | tuple[float, float]) -> tuple[int, int]:
    # far outside is as good as outside, and cv2 takes no more than 16 bits of it
    x, y = np.clip(np.nan_to_num(np.asarray(place, float)), -20000, 20000)
    return round(float(x)), round(float(y))


def _write(picture: Image, text: str, unit: int) -> None:
    cv2.putText(picture, text, (8 * unit, 20 * unit), cv2.FONT_HERSHEY_SIMPLEX, 0.5 * unit, WHITE, unit, cv2.LINE_AA)
