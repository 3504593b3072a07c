"""Board poses: what all cameras saw of the board at nearly one moment of the common clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.calibration.corners import BoardView
from headcap.calibration.detection import CameraDetections
from headcap.calibration.settings import GroupSettings
from headcap.sync.offsets import TimeOffsets

Array = NDArray[np.float64]
COVERAGE_CELLS = 6
"""Cells along the shorter side of an image in which corners are counted."""
LEAST_CORNERS = 6
"""A view of fewer tells no pose: as many as a frame must show to be kept at all (`DetectSettings.min_corners`)."""
_LEAST_BREADTH = 0.02
"""Of their length: corners in a line are bent by the lens and by noise no more than this."""


@dataclass(frozen=True)
class BoardPose:
    """Views of the board at one moment, corners moved along their velocity to that moment."""

    time_s: float
    """Common time."""
    views: Mapping[str, BoardView]
    """By camera."""
    frames: Mapping[str, int]
    """Frame number of each camera's view."""


@dataclass(frozen=True)
class _Candidate:
    camera: str
    sighting: int
    time_s: float
    speed_px_s: float


def group_poses(detections: Mapping[str, CameraDetections], offsets: TimeOffsets, settings: GroupSettings) -> list[BoardPose]:
    """Choose moments at which the board is slow and collect every camera's view of it, in order of time.

    A view serves a moment if it lies within `window_s` of it and its corners would move by less than `max_shift_px` until
    then; they are moved by their own measured velocity, so that cameras that do not fire together still see one pose.
    """
    candidates = _slow_candidates(detections, offsets, settings)
    times = np.array([c.time_s for c in candidates])
    free = np.ones(len(candidates), bool)
    poses = []
    for centre in _moments(candidates, times, settings):
        if any(abs(pose.time_s - centre) < 1.5 * settings.window_s for pose in poses):
            continue
        near = np.flatnonzero(free & (np.abs(times - centre) <= settings.window_s))
        members = [candidates[i] for i in near]
        chosen = _best_per_camera(members, centre, settings)
        if len(chosen) >= settings.min_cameras:
            free[near] = False
            poses.append(_pose(chosen, centre, detections))
    return sorted(_covering(poses, detections, settings.max_poses), key=lambda pose: pose.time_s)


def _slow_candidates(
    detections: Mapping[str, CameraDetections], offsets: TimeOffsets, settings: GroupSettings
) -> list[_Candidate]:
    found = []
    for camera, seen in detections.items():
        speeds, times = seen.speed_px_s(), offsets.common_time(camera, seen.own_time_s)
        for i in np.flatnonzero(speeds <= settings.max_speed_px_s):
            if not _tells_a_pose(_followed(seen, int(i)).pixels):
                continue
            found.append(_Candidate(camera, int(i), float(times[i]), float(speeds[i])))
    return sorted(found, key=lambda c: c.time_s)


def _moments(candidates: list[_Candidate], times: Array, settings: GroupSettings) -> Array:
    """Times of candidates, those with most cameras and least motion around them first."""
    scores = np.zeros(len(times))
    for i, time in enumerate(times):
        low, high = np.searchsorted(times, [time - settings.window_s, time + settings.window_s])
        members = candidates[low:high]
        shift = np.mean([min(c.speed_px_s * abs(c.time_s - time), 10.0) for c in members])
        # among moments with equally many cameras the still one, and of those the one in the middle, is taken
        spread = np.abs(times[low:high] - time).mean() / settings.window_s
        scores[i] = len({c.camera for c in members}) - shift - 0.5 * spread
    return times[np.argsort(-scores, kind="stable")]


def _best_per_camera(members: list[_Candidate], centre: float, settings: GroupSettings) -> list[_Candidate]:
    best: dict[str, tuple[float, _Candidate]] = {}
    for c in members:
        shift = c.speed_px_s * abs(c.time_s - centre)
        if shift > settings.max_shift_px:
            continue
        # a hundredth of a window decides between two still frames
        cost = shift + 0.01 * abs(c.time_s - centre) / settings.window_s
        if c.camera not in best or cost < best[c.camera][0]:
            best[c.camera] = (cost, c)
    return [c for _, c in best.values()]


def _pose(chosen: list[_Candidate], centre: float, detections: Mapping[str, CameraDetections]) -> BoardPose:
    views, frames = {}, {}
    for c in sorted(chosen, key=lambda c: list(detections).index(c.camera)):
        seen = detections[c.camera]
        views[c.camera] = _followed(seen, c.sighting, centre - c.time_s)
        frames[c.camera] = int(seen.frame[c.sighting])
    return BoardPose(centre, views, frames)


def _followed(seen: CameraDetections, sighting: int, later_s: float = 0.0) -> BoardView:
    """The corners of a view whose motion is known, moved on for so long."""
    view, velocity = seen.view(sighting), seen.velocity(sighting)
    known = np.isfinite(velocity).all(1)
    return BoardView(view.corner[known], view.pixels[known] + velocity[known] * later_s)


def _tells_a_pose(pixels: Array) -> bool:
    """Whether corners (n, 2) are enough for a pose, and in no line: straight lines of the board are straight in pictures too."""
    if len(pixels) < LEAST_CORNERS:
        return False
    length, breadth = np.linalg.svd(pixels - pixels.mean(axis=0), compute_uv=False)
    return breadth > _LEAST_BREADTH * length


def image_cells(pixels: Array, width: int, height: int) -> NDArray[np.int64]:
    """(n,) cell index of pixels (n, 2) in a grid of square cells, `COVERAGE_CELLS` along the shorter side."""
    side = min(width, height) / COVERAGE_CELLS
    columns = int(np.ceil(width / side - 1e-9))
    rows = int(np.ceil(height / side - 1e-9))
    column = np.clip((pixels[:, 0] + 0.5) // side, 0, columns - 1).astype(int)
    row = np.clip((pixels[:, 1] + 0.5) // side, 0, rows - 1).astype(int)
    return row * columns + column


def cell_count(width: int, height: int) -> int:
    """Number of cells of `image_cells`."""
    side = min(width, height) / COVERAGE_CELLS
    return int(np.ceil(width / side - 1e-9)) * int(np.ceil(height / side - 1e-9))


def _covering(poses: list[BoardPose], detections: Mapping[str, CameraDetections], count: int) -> list[BoardPose]:
    """Up to `count` poses, greedily those that add most to what the cameras have seen so far."""
    if len(poses) <= count:
        return poses
    cells = []
    for pose in poses:
        parts = [
            (camera, int(cell))
            for camera, view in pose.views.items()
            for cell in np.unique(image_cells(view.pixels, detections[camera].width, detections[camera].height))
        ]
        cells.append(parts)
    seen: dict[tuple[str, int], int] = {}
    rest, chosen = list(range(len(poses))), []
    while len(chosen) < count:
        best = max(rest, key=lambda i: sum(1 / (1 + seen.get(cell, 0)) for cell in cells[i]))
        rest.remove(best)
        chosen.append(poses[best])
        for cell in cells[best]:
            seen[cell] = seen.get(cell, 0) + 1
    return chosen
