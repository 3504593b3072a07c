"""The last adjustment over still poses, with what is known of lenses before any picture: for boards seen in few places.

A board that covers a small part of an image leaves distortion and principal point open, and a free adjustment bends them as
far as the noise asks. Weak priors hold them near what lenses are like; where the board was everywhere they change nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from headcap.calibration.corners import BoardView
from headcap.calibration.grouping import BoardPose
from headcap.calibration.intrinsics import Lens
from headcap.calibration.rig import Adjusted, robust_sigma_px, view_residuals
from headcap.calibration.start import board_pose
from headcap.cameras import Camera, Rig
from headcap.geometry.transforms import from_vector, transform

Array = NDArray[np.float64]
POSE, LENS = slice(0, 6), slice(6, 14)
PER_CAMERA = 14
"""Turn and shift of the camera frame, then fx fy cx cy k1 k2 p1 p2."""


def lens_jacobian(camera: Camera, xy: Array) -> Array:
    """(n, 2, 8) derivative of pixels by fx fy cx cy k1 k2 p1 p2 at ideal image plane points (n, 2)."""
    x, y = xy.T
    r2 = x * x + y * y
    k, one, zero = camera.matrix, np.ones_like(x), np.zeros_like(x)
    plane = (camera.pixels_from_normalised(xy) - k[:2, 2]) / np.diag(k)[:2]
    fx, fy = k[0, 0], k[1, 1]
    u = [plane[:, 0], zero, one, zero, fx * x * r2, fx * x * r2**2, fx * 2 * x * y, fx * (r2 + 2 * x * x)]
    v = [zero, plane[:, 1], zero, one, fy * y * r2, fy * y * r2**2, fy * (r2 + 2 * y * y), fy * 2 * x * y]
    return np.stack([np.stack(u, axis=1), np.stack(v, axis=1)], axis=1)


def lens_prior(camera: Camera) -> tuple[Array, Array]:
    """Normal equations (8, 8), (8,) of the prior on fx fy cx cy k1 k2 p1 p2 at the camera's present values.

    Standard deviations: principal point 2 % of the longer side from the middle, pixels square to 0.5 %, k1 and k2 0.3,
    p1 and p2 0.003.
    """
    k, d = camera.matrix, camera.distortion
    value = np.r_[k[0, 2] - (camera.width - 1) / 2, k[1, 2] - (camera.height - 1) / 2, d[:4]]
    weight = 1 / np.r_[np.full(2, 0.02 * max(camera.size)), 0.3, 0.3, 0.003, 0.003] ** 2
    normal, right = np.zeros((8, 8)), np.zeros(8)
    normal[2:, 2:], right[2:] = np.diag(weight), -weight * value
    square = 1 / (0.005 * k[0, 0]) ** 2
    normal[:2, :2] += square * np.array([[1, -1], [-1, 1]])
    right[:2] -= square * (k[0, 0] - k[1, 1]) * np.array([1, -1])
    return normal, right


def skew(vector: Array) -> Array:
    """(n, 3, 3) matrices of cross products with (n, 3)."""
    x, y, z = vector.T
    o = np.zeros_like(x)
    return np.stack([np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], axis=-2)


def polish(state: Adjusted, corners: Array, constant_lenses: frozenset[str], *, iterations: int = 12) -> Adjusted:
    """Adjust cameras and board poses to the state's corners with `lens_prior` (Levenberg-Marquardt, Cauchy loss).

    The first camera keeps its pose. Known lenses stay.
    """
    free = np.ones((len(state.rig), PER_CAMERA), bool)
    free[0, POSE] = False
    for i, camera in enumerate(state.rig):
        free[i, LENS] = camera.name not in constant_lenses
    mask = np.r_[free.ravel(), np.ones(6 * len(state.poses), bool)]
    damping, cost = 1e-4, _cost(state, corners, sigma := _sigma(state, corners))
    for _ in range(iterations):
        normal, right = _normal(state, corners, sigma)
        for _ in range(6):
            damped = normal + damping * np.diag(np.diag(normal) + 1e-12)
            step = np.zeros(len(mask))
            step[mask] = np.linalg.solve(damped[np.ix_(mask, mask)], right[mask])
            moved = _moved(state, step)
            new_cost = _cost(moved, corners, sigma)
            if new_cost <= cost:
                break
            damping *= 10
        else:
            break
        done = cost - new_cost < 1e-5 * cost
        state, damping = moved, max(damping / 10, 1e-12)
        sigma = _sigma(state, corners)
        cost = _cost(state, corners, sigma)
        if done:
            break
    return state


def lens_alone(name: str, lens: Lens, views: Sequence[BoardView], corners: Array, *, most: int = 40) -> Lens:
    """Lens of one camera from its own views, each with a board pose of its own, and `lens_prior`.

    What cameras disagree on (a bent board, false times) cannot bend this lens: the corners of one view share one moment.
    """
    chosen = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, min(most, len(views))).astype(int))]
    camera = Camera(name, lens.width, lens.height, lens.matrix, lens.distortion, np.eye(4))
    state = Adjusted(
        rig=Rig((camera,)),
        world_from_board=tuple(board_pose(lens, view, corners)[0] for view in chosen),
        poses=tuple(BoardPose(0.0, {name: view}, {}) for view in chosen),
        rejected={name: 0},
    )
    found = polish(state, corners, frozenset(), iterations=30).rig[0]
    return Lens(lens.width, lens.height, found.matrix, found.distortion)


def _sigma(state: Adjusted, corners: Array) -> float:
    lengths = [np.linalg.norm(r, axis=1) for _, _, r in _residuals(state, corners)]
    return float(np.clip(robust_sigma_px(np.nan_to_num(np.concatenate(lengths), nan=1e3)), 0.02, 5.0))


def _residuals(state: Adjusted, corners: Array):
    for j, (pose, world_from_board) in enumerate(zip(state.poses, state.world_from_board, strict=True)):
        for name, view in pose.views.items():
            i = state.rig.names.index(name)
            yield i, j, view_residuals(state.rig[i], world_from_board, view, corners)


def _cost(state: Adjusted, corners: Array, sigma: float) -> float:
    """Cauchy loss of the residuals with a scale of three standard deviations, and the priors."""
    total = 0.0
    for _, _, residual in _residuals(state, corners):
        total += 9 * np.log1p((np.nan_to_num(residual, nan=1e3) ** 2).sum(1) / (9 * sigma**2)).sum()
    for camera in state.rig:
        k, d = camera.matrix, camera.distortion
        off = np.r_[k[0, 2] - (camera.width - 1) / 2, k[1, 2] - (camera.height - 1) / 2] / (0.02 * max(camera.size))
        lens = np.r_[off, d[:2] / 0.3, d[2:4] / 0.003, (k[0, 0] - k[1, 1]) / (0.005 * k[0, 0])]
        total += float(lens @ lens)
    return total


def _normal(state: Adjusted, corners: Array, sigma: float) -> tuple[Array, Array]:
    cameras, size = len(state.rig), PER_CAMERA * len(state.rig) + 6 * len(state.poses)
    normal, right = np.zeros((size, size)), np.zeros(size)
    for i, camera in enumerate(state.rig):
        own = slice(PER_CAMERA * i + 6, PER_CAMERA * (i + 1))
        normal[own, own], right[own] = lens_prior(camera)
    for j, (pose, world_from_board) in enumerate(zip(state.poses, state.world_from_board, strict=True)):
        for name, view in pose.views.items():
            i = state.rig.names.index(name)
            world = transform(world_from_board, corners[view.corner])
            jacobian, residual = view_jacobian(state.rig[i], world, view.pixels)
            trust = 1 / (sigma**2 + (residual**2).sum(1) / 9)
            rows = np.r_[PER_CAMERA * i : PER_CAMERA * (i + 1), PER_CAMERA * cameras + 6 * j : PER_CAMERA * cameras + 6 * (j + 1)]
            normal[np.ix_(rows, rows)] += np.einsum("nri,nrj,n->ij", jacobian, jacobian, trust, optimize=True)
            right[rows] += np.einsum("nri,nr,n->i", jacobian, residual, trust)
    return normal, right


def view_jacobian(camera: Camera, world: Array, pixels: Array) -> tuple[Array, Array]:
    """Derivative (n, 2, 20) by camera pose, lens and board pose (turn about the world's origin), and seen minus projected."""
    projected, by_world = camera.project_with_jacobian(world)
    local = transform(camera.camera_from_world, world)
    by_local = by_world @ camera.camera_from_world[:3, :3].T
    lens = lens_jacobian(camera, local[:, :2] / local[:, 2:])
    parts = [-by_local @ skew(local), by_local, lens, -by_world @ skew(world), by_world]
    return np.concatenate(parts, axis=2), pixels - projected


def changed_camera(camera: Camera, change: Array) -> Camera:
    """The camera after a step (14,) of pose and lens."""
    matrix, distortion = camera.matrix.copy(), camera.distortion.copy()
    matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += change[LENS][:4]
    distortion[:4] += change[LENS][4:]
    pose = from_vector(change[POSE]) @ camera.camera_from_world
    return replace(camera, matrix=matrix, distortion=distortion, camera_from_world=pose)


def _moved(state: Adjusted, step: Array) -> Adjusted:
    count = PER_CAMERA * len(state.rig)
    changes = step[:count].reshape(-1, PER_CAMERA)
    rig = Rig(tuple(changed_camera(c, change) for c, change in zip(state.rig, changes, strict=True)))
    turns = from_vector(step[count:].reshape(-1, 6))
    board = tuple(turn @ pose for turn, pose in zip(turns, state.world_from_board, strict=True))
    return replace(state, rig=rig, world_from_board=board)
