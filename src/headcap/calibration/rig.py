"""The rig as one bundle adjustment over board poses with known corners (pycolmap; COLMAP's rigs and frames)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pycolmap
from numpy.typing import NDArray

from headcap.calibration.corners import BoardView
from headcap.calibration.grouping import BoardPose
from headcap.calibration.intrinsics import Lens
from headcap.calibration.settings import RigSettings
from headcap.cameras import Camera, Rig
from headcap.geometry.transforms import rigid, transform

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Adjusted:
    """Cameras and board poses after a bundle adjustment."""

    rig: Rig
    world_from_board: tuple[Array, ...]
    """(4, 4) per pose."""
    poses: tuple[BoardPose, ...]
    """The poses with the corners that were kept."""
    rejected: Mapping[str, int]
    """Corners left out as outliers, by camera."""


def adjust_rig(
    poses: Sequence[BoardPose],
    corners: Array,
    lenses: Mapping[str, Lens],
    camera_from_rig: Mapping[str, Array],
    rig_from_board: Sequence[Array],
    settings: RigSettings,
    *,
    constant_lenses: frozenset[str] = frozenset(),
) -> Adjusted:
    """Minimise the reprojection error of all corners over lenses, camera poses and board poses.

    `corners` (n, 3) are constant and fix the scale, the first camera of `camera_from_rig` fixes the frame. A Cauchy loss
    bears false corners; after each round those beyond `outlier_sigmas` robust standard deviations of their camera are left
    out, and the last round ends without a robust loss on what is left.
    """
    cameras = [_camera(name, lenses[name], pose) for name, pose in camera_from_rig.items()]
    state = Adjusted(Rig(tuple(cameras)), tuple(rig_from_board), tuple(poses), dict.fromkeys(camera_from_rig, 0))
    for number in range(settings.rounds):
        loss_px = settings.loss_px if number < settings.rounds - 1 else None
        state = _Problem(state, corners, constant_lenses).solve(loss_px, settings.max_iterations)
        if number < settings.rounds - 1:
            state = _without_outliers(state, corners, settings)
    return state


def _camera(name: str, lens: Lens, camera_from_rig: Array) -> Camera:
    return Camera(name, lens.width, lens.height, lens.matrix, lens.distortion, camera_from_rig)


class _Problem:
    """One COLMAP reconstruction: world = board, frames = board poses, sensor_from_rig = camera poses."""

    def __init__(self, state: Adjusted, corners: Array, constant_lenses: frozenset[str]) -> None:
        self.state, self.constant = state, constant_lenses
        self.reconstruction = pycolmap.Reconstruction()
        self.images: list[tuple[int, BoardView]] = []
        self._add_cameras()
        for number, (pose, rig_from_board) in enumerate(zip(state.poses, state.world_from_board, strict=True)):
            self._add_pose(number, pose, rig_from_board)
        self._add_corners(corners)

    def _add_cameras(self) -> None:
        rig = pycolmap.Rig()
        rig.rig_id = 1
        for number, camera in enumerate(self.state.rig):
            k, d = camera.matrix, camera.distortion
            # COLMAP puts the top-left pixel's centre at (0.5, 0.5)
            params = [k[0, 0], k[1, 1], k[0, 2] + 0.5, k[1, 2] + 0.5, *d[:4]]
            model = "OPENCV"
            if camera.name in self.constant:
                model, params = "FULL_OPENCV", [*params, d[4], 0.0, 0.0, 0.0]
            self.reconstruction.add_camera(
                pycolmap.Camera(model=model, width=camera.width, height=camera.height, params=params, camera_id=number + 1)
            )
            if number == 0:
                rig.add_ref_sensor(_sensor(number))
            else:
                rig.add_sensor(_sensor(number), _rigid3d(camera.camera_from_world))
        self.reconstruction.add_rig(rig)

    def _add_pose(self, number: int, pose: BoardPose, rig_from_board: Array) -> None:
        names = self.state.rig.names
        seen = [(names.index(name), view) for name, view in pose.views.items() if len(view.corner)]
        image_id = {c: number * len(names) + c + 1 for c, _ in seen}
        frame = pycolmap.Frame()
        frame.frame_id, frame.rig_id = number + 1, 1
        for c, _ in seen:
            frame.add_data_id(pycolmap.data_t(_sensor(c), image_id[c]))
        frame.rig_from_world = _rigid3d(rig_from_board)
        self.reconstruction.add_frame(frame)
        for c, view in seen:
            image = pycolmap.Image(name=f"{number}/{names[c]}", camera_id=c + 1, image_id=image_id[c])
            image.frame_id = number + 1
            image.points2D = pycolmap.Point2DList([pycolmap.Point2D(pixel + 0.5) for pixel in view.pixels])
            self.reconstruction.add_image(image)
            self.images.append((image_id[c], view))
        self.reconstruction.register_frame(number + 1)

    def _add_corners(self, corners: Array) -> None:
        for index, corner in enumerate(corners):
            track = pycolmap.Track()
            for image_id, view in self.images:
                for row in np.flatnonzero(view.corner == index):
                    track.add_element(image_id, int(row))
            if track.length():
                self.reconstruction.add_point3D(corner, track)

    def solve(self, loss_px: float | None, max_iterations: int) -> Adjusted:
        """Bundle adjustment with the board's corners held; a robust loss of scale `loss_px` or none."""
        config = pycolmap.BundleAdjustmentConfig()
        for image_id, _ in self.images:
            config.add_image(image_id)
        for point_id in self.reconstruction.point3D_ids():
            config.add_constant_point(point_id)
        for number, name in enumerate(self.state.rig.names):
            if name in self.constant:
                config.set_constant_cam_intrinsics(number + 1)
        pycolmap.create_default_bundle_adjuster(_options(loss_px, max_iterations), config, self.reconstruction).solve()
        return self._read_back()

    def _read_back(self) -> Adjusted:
        rig = self.reconstruction.rig(1)
        cameras = []
        for number, camera in enumerate(self.state.rig):
            pose = np.eye(4) if number == 0 else _matrix(rig.sensor_from_rig(_sensor(number)))
            p = self.reconstruction.camera(number + 1).params
            matrix = np.array([[p[0], 0, p[2] - 0.5], [0, p[1], p[3] - 0.5], [0, 0, 1.0]])
            distortion = np.array([*p[4:8], p[8] if len(p) > 8 else 0.0])
            cameras.append(replace(camera, matrix=matrix, distortion=distortion, camera_from_world=pose))
        board = tuple(_matrix(self.reconstruction.frame(n + 1).rig_from_world) for n in range(len(self.state.poses)))
        return replace(self.state, rig=Rig(tuple(cameras)), world_from_board=board)


def _options(loss_px: float | None, max_iterations: int) -> pycolmap.BundleAdjustmentOptions:
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_principal_point = True
    options.print_summary = False
    if loss_px is not None:
        options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
        options.ceres.loss_function_scale = loss_px
    solver = options.ceres.solver_options
    solver.max_num_iterations = max_iterations
    solver.function_tolerance, solver.gradient_tolerance = 1e-10, 1e-12
    # one thread: sums in one order, so that equal input gives equal digests
    solver.num_threads = 1
    return options


def _sensor(number: int) -> pycolmap.sensor_t:
    return pycolmap.sensor_t(pycolmap.SensorType.CAMERA, number + 1)


def _rigid3d(target_from_source: Array) -> pycolmap.Rigid3d:
    rotation = pycolmap.Rotation3d(np.ascontiguousarray(target_from_source[:3, :3]))
    return pycolmap.Rigid3d(rotation, np.ascontiguousarray(target_from_source[:3, 3]))


def _matrix(pose: pycolmap.Rigid3d) -> Array:
    matrix = pose.matrix()
    return rigid(matrix[:, :3], matrix[:, 3])


def view_residuals(camera: Camera, world_from_board: Array, view: BoardView, corners: Array) -> Array:
    """(n, 2) projected minus seen corners of one view, pixels."""
    pixels, _ = camera.project(transform(world_from_board, corners[view.corner]))
    return pixels - view.pixels


def robust_sigma_px(distances: Array) -> float:
    """Standard deviation per axis of 2D residuals whose lengths (n,) may hold outliers (median of a Rayleigh law)."""
    return float(np.median(distances) / 1.1774) if len(distances) else 0.0


def _without_outliers(state: Adjusted, corners: Array, settings: RigSettings) -> Adjusted:
    lengths: dict[str, list[Array]] = {name: [] for name in state.rig.names}
    per_pose = []
    for pose, world_from_board in zip(state.poses, state.world_from_board, strict=True):
        residuals = {
            name: np.linalg.norm(view_residuals(state.rig[name], world_from_board, view, corners), axis=1)
            for name, view in pose.views.items()
        }
        per_pose.append(residuals)
        for name, values in residuals.items():
            lengths[name].append(values)
    limit = {
        name: max(settings.outlier_floor_px, settings.outlier_sigmas * robust_sigma_px(np.concatenate(values or [np.empty(0)])))
        for name, values in lengths.items()
    }
    rejected, poses = dict(state.rejected), []
    for pose, residuals in zip(state.poses, per_pose, strict=True):
        views = {}
        for name, view in pose.views.items():
            keep = residuals[name] <= limit[name]
            # fewer than four corners of a board are no pose: their view goes as a whole
            keep &= keep.sum() >= 4
            rejected[name] += int((~keep).sum())
            views[name] = BoardView(view.corner[keep], view.pixels[keep])
        poses.append(replace(pose, views={name: view for name, view in views.items() if len(view.corner)}))
    kept = [i for i, pose in enumerate(poses) if pose.views]
    return replace(
        state,
        poses=tuple(poses[i] for i in kept),
        world_from_board=tuple(state.world_from_board[i] for i in kept),
        rejected=rejected,
    )
