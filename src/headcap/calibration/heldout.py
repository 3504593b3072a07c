"""The error that counts: board poses that the adjustment never saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from headcap.calibration.grouping import BoardPose
from headcap.calibration.intrinsics import Lens
from headcap.calibration.rig import view_residuals
from headcap.calibration.start import joined_board_pose
from headcap.cameras import Rig
from headcap.geometry.transforms import from_vector

Array = NDArray[np.float64]


@dataclass(frozen=True)
class HeldOut:
    """Residuals of held-out poses, of which only the board's pose was solved."""

    residuals_px: dict[str, Array]
    """(n,) length of every corner's residual, by camera."""
    length_errors_m: Array
    """(k,) distance between two triangulated corners minus their distance on the board."""

    def rms_px(self, camera: str | None = None) -> float:
        """Root mean square over corners of one camera or of all; NaN without any."""
        values = self._values(camera)
        return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")

    def p95_px(self, camera: str | None = None) -> float:
        """95th percentile over corners of one camera or of all; NaN without any."""
        values = self._values(camera)
        return float(np.percentile(values, 95)) if len(values) else float("nan")

    def board_scale_error_mm(self) -> float:
        """Rms of `length_errors_m`; NaN where no held-out corner was seen by two cameras."""
        return float(1e3 * np.sqrt(np.mean(self.length_errors_m**2))) if len(self.length_errors_m) else float("nan")

    def _values(self, camera: str | None) -> Array:
        parts = list(self.residuals_px.values()) if camera is None else [self.residuals_px.get(camera, np.empty(0))]
        return np.concatenate(parts) if parts else np.empty(0)


def split_poses(poses: Sequence[BoardPose], share: float) -> tuple[list[int], list[int]]:
    """Indices of poses to fit and to hold out, the latter spread evenly over the recording."""
    count = max(1, round(share * len(poses)))
    held = sorted({int(i) for i in (np.arange(count) + 0.5) * len(poses) / count})
    return [i for i in range(len(poses)) if i not in held], held


def measure_heldout(rig: Rig, poses: Sequence[BoardPose], corners: Array) -> HeldOut:
    """Solve each pose of the board alone and collect what remains, corners that stand far out included."""
    residuals: dict[str, list[Array]] = {name: [] for name in rig.names}
    lengths = []
    for pose in poses:
        if not pose.views:
            continue
        world_from_board = solve_board_pose(rig, pose, corners)
        for name, view in pose.views.items():
            residuals[name].append(np.linalg.norm(view_residuals(rig[name], world_from_board, view, corners), axis=1))
        lengths.append(_length_errors(rig, pose, corners))
    packed = {name: np.concatenate(parts) if parts else np.empty(0) for name, parts in residuals.items()}
    return HeldOut(packed, np.concatenate(lengths) if lengths else np.empty(0))


def solve_board_pose(rig: Rig, pose: BoardPose, corners: Array, *, loss_px: float = 0.5) -> Array:
    """world_from_board (4, 4) of one pose from all its views (soft L1 loss at `loss_px`)."""
    lenses = {c.name: Lens(c.width, c.height, c.matrix, c.distortion) for c in rig}
    start = joined_board_pose(pose, lenses, {c.name: c.camera_from_world for c in rig}, corners)

    def residual(step: Array) -> Array:
        world_from_board = from_vector(step) @ start
        parts = [view_residuals(rig[name], world_from_board, view, corners).ravel() for name, view in pose.views.items()]
        return np.nan_to_num(np.concatenate(parts), nan=1e3)

    # the step turns about the world's origin, so angles and metres are of like size in pixels
    solved = least_squares(residual, np.zeros(6), loss="soft_l1", f_scale=loss_px, x_scale="jac", max_nfev=50)
    return from_vector(solved.x) @ start


def triangulate(rig: Rig, seen: Sequence[tuple[str, Array]]) -> Array:
    """(3,) point nearest to the rays of one feature seen at `(camera, pixel)`, each weighted by its nearness."""
    centres = np.array([rig[name].centre for name, _ in seen])
    rays = np.array([rig[name].rays(np.asarray(pixel)[None])[0] for name, pixel in seen])
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    point = _nearest(across, centres, np.ones(len(seen)))
    return _nearest(across, centres, 1 / np.sum((centres - point) ** 2, axis=1))


def _nearest(across: Array, centres: Array, weights: Array) -> Array:
    normal = np.einsum("n,nij->ij", weights, across)
    return np.linalg.solve(normal, np.einsum("n,nij,nj->i", weights, across, centres))


def _length_errors(rig: Rig, pose: BoardPose, corners: Array) -> Array:
    """Errors of all distances between the pose's triangulated corners, metres."""
    found = {}
    for index in range(len(corners)):
        seen = [(name, view.pixels[row]) for name, view in pose.views.items() for row in np.flatnonzero(view.corner == index)]
        if len({name for name, _ in seen}) >= 2:
            found[index] = triangulate(rig, seen)
    if len(found) < 2:
        return np.empty(0)
    points, true = np.array(list(found.values())), corners[list(found)]
    i, j = np.triu_indices(len(points), 1)
    return np.linalg.norm(points[i] - points[j], axis=1) - np.linalg.norm(true[i] - true[j], axis=1)
