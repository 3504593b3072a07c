"""The error that counts: board poses that the adjustment never saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from headcap.calibration.grouping import BoardPose
from headcap.calibration.intrinsics import Lens
from headcap.calibration.rig import view_residuals
from headcap.calibration.start import joined_board_pose
from headcap.cameras import Rig
from headcap.geometry.transforms import from_vector, transform

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
    """Solve each pose of the board alone and collect what remains, false corners included.

    A view of another pose than the others (`without_strange_views`) is left out: there the poses were joined wrongly.
    """
    residuals: dict[str, list[Array]] = {name: [] for name in rig.names}
    lengths = []
    for pose in poses:
        if not pose.views:
            continue
        pose = without_strange_views(rig, pose, corners)
        world_from_board = solve_board_pose(rig, pose, corners)
        for name, view in pose.views.items():
            residuals[name].append(np.linalg.norm(view_residuals(rig[name], world_from_board, view, corners), axis=1))
        lengths.append(_length_errors(rig, pose, corners))
    packed = {name: np.concatenate(parts) if parts else np.empty(0) for name, parts in residuals.items()}
    return HeldOut(packed, np.concatenate(lengths) if lengths else np.empty(0))


def without_strange_views(rig: Rig, pose: BoardPose, corners: Array, *, times: float = 20.0, floor_px: float = 2.0) -> BoardPose:
    """The pose without views that show the board elsewhere: it moved unseen between their frames.

    A view goes, worst first, while its median residual exceeds `floor_px` and `times` the median of all corners.
    """
    while len(pose.views) > 2:
        world_from_board = solve_board_pose(rig, pose, corners)
        lengths = {
            name: np.linalg.norm(view_residuals(rig[name], world_from_board, view, corners), axis=1)
            for name, view in pose.views.items()
        }
        median = {name: float(np.median(np.nan_to_num(values, nan=np.inf))) for name, values in lengths.items()}
        worst = max(median, key=median.get)
        if median[worst] <= max(floor_px, times * float(np.median(list(median.values())))):
            break
        pose = replace(pose, views={name: view for name, view in pose.views.items() if name != worst})
    return pose


def solve_board_pose(rig: Rig, pose: BoardPose, corners: Array, *, loss_px: float = 0.5) -> Array:
    """world_from_board (4, 4) of one pose from all its views (Gauss-Newton, Cauchy loss at `loss_px`); NaN where none is told."""
    lenses = {c.name: Lens(c.width, c.height, c.matrix, c.distortion) for c in rig}
    world_from_board = joined_board_pose(pose, lenses, {c.name: c.camera_from_world for c in rig}, corners)
    # a wide loss first: the start is good to some pixels only
    for loss in (*np.geomspace(16 * loss_px, loss_px, 4), *[loss_px] * 6):
        step = _pose_step(rig, pose, corners, world_from_board, loss)
        if not np.isfinite(step).all():
            return np.full((4, 4), np.nan)
        world_from_board = from_vector(step) @ world_from_board
        if loss == loss_px and np.abs(step).max() < 1e-10:
            break
    return world_from_board


def _pose_step(rig: Rig, pose: BoardPose, corners: Array, world_from_board: Array, loss_px: float) -> Array:
    """(6,) rotation vector about the world's origin and shift that lessen the residuals of all views."""
    normal, right = 1e-9 * np.eye(6), np.zeros(6)
    for name, view in pose.views.items():
        world = transform(world_from_board, corners[view.corner])
        pixels, by_world = rig[name].project_with_jacobian(world)
        x, y, z = world.T
        zero = np.zeros_like(x)
        turn = np.stack([np.stack([zero, z, -y], -1), np.stack([-z, zero, x], -1), np.stack([y, -x, zero], -1)], axis=1)
        jacobian = np.concatenate([by_world @ turn, by_world], axis=2)
        residual = view.pixels - pixels
        trust = 1 / (1 + (residual**2).sum(1) / loss_px**2)
        normal += np.einsum("nri,nrj,n->ij", jacobian, jacobian, trust)
        right += np.einsum("nri,nr,n->i", jacobian, residual, trust)
    return np.linalg.solve(normal, right)


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
