"""Board sightings while it moves: cameras, their time offsets and the board's trajectory in one adjustment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from headcap.calibration.detection import CameraDetections
from headcap.calibration.intrinsics import Lens
from headcap.calibration.polish import changed_camera, lens_jacobian, lens_prior, skew
from headcap.calibration.settings import TimingSettings
from headcap.calibration.start import board_pose
from headcap.calibration.trajectory import (
    BAND,
    WIDTH,
    BandedNormal,
    Trajectory,
    empty_trajectory,
    fit_poses,
    motion_jacobian,
    spread,
)
from headcap.cameras import Camera, Rig
from headcap.geometry.transforms import invert
from headcap.sync.offsets import TimeOffsets

Array = NDArray[np.float64]
POSE, LENS, CLOCK = slice(0, 6), slice(6, 14), slice(14, 15)
PARAMETERS = 15
"""Per camera: turn and shift of the camera frame, fx fy cx cy k1 k2 p1 p2, time offset."""


@dataclass(frozen=True)
class MotionFit:
    """Result of `fit_motion`."""

    rig: Rig
    offset_s: Array
    """(cameras,) to add to each camera's common times; their mean is zero."""
    offset_sigma_s: Array
    """(cameras,) standard deviations."""
    residual_px: Array
    """(sightings,) rms of each sighting, pixels."""
    speed_px_s: Array
    """(sightings,) median corner speed."""
    camera: NDArray[np.int64]
    """(sightings,) camera of each sighting."""
    trajectory: Trajectory


@dataclass(frozen=True)
class _CameraData:
    """Sightings of one camera, corners stacked."""

    time_s: Array
    first: NDArray[np.int64]
    board: Array
    pixels: Array
    sighting: NDArray[np.int64]
    kind: NDArray[np.int64]
    """(sightings,) 0 where three frames of a slow board were averaged, 1 elsewhere: their noise differs."""


@dataclass(frozen=True)
class _Sums:
    """Normal equations of one camera's sightings."""

    jacobian: Array
    """(n, 7 + 15, 7 + 15) sums over corners, by state and camera parameters."""
    gradient: Array
    """(n, 7 + 15)."""
    first: NDArray[np.int64]
    weights: Array
    residual_px: Array
    speed_px_s: Array


def fit_motion(
    rig: Rig,
    detections: Mapping[str, CameraDetections],
    offsets: TimeOffsets,
    corners: Array,
    settings: TimingSettings,
    *,
    free_cameras: bool,
    constant_lenses: frozenset[str] = frozenset(),
    without_s: Sequence[tuple[float, float]] = (),
) -> MotionFit:
    """Fit the board's trajectory and each camera's time offset to all sightings, moving ones above all.

    Gauss-Newton over a cubic spline of the board's pose (banded), bordered by 15 parameters per camera; corners are weighed
    by a Cauchy loss. With `free_cameras` poses and lenses are refined too (the first camera's pose stays). Sightings within
    the common-time ranges `without_s` are left out. A rolling shutter shows as an offset of the image's middle row.
    """
    data = [_camera_data(detections[c.name], offsets, corners, without_s) for c in rig]
    trajectory = _start(rig, detections, offsets, corners, settings, without_s)
    state = _State(rig, trajectory, np.zeros(len(rig)))
    free = _free_parameters(rig, free_cameras, constant_lenses)
    sigma_px = np.ones(2)
    for _ in range(settings.iterations):
        sums = [_sums(c, d, state.trajectory, o, sigma_px) for c, d, o in zip(state.rig, data, state.offset_s, strict=True)]
        sigma_px = _noise(data, sums)
        state, _ = _step(state, sums, free, settings.max_offset_s)
    sums = [_sums(c, d, state.trajectory, o, sigma_px) for c, d, o in zip(state.rig, data, state.offset_s, strict=True)]
    _, sigma_s = _step(state, sums, free, settings.max_offset_s)
    mean = state.offset_s.mean()
    return MotionFit(
        rig=state.rig,
        offset_s=state.offset_s - mean,
        offset_sigma_s=sigma_s,
        residual_px=np.concatenate([s.residual_px for s in sums]),
        speed_px_s=np.concatenate([s.speed_px_s for s in sums]),
        camera=np.repeat(np.arange(len(sums)), [len(s.first) for s in sums]),
        trajectory=replace(state.trajectory, start_s=state.trajectory.start_s - mean),
    )


@dataclass(frozen=True)
class _State:
    rig: Rig
    trajectory: Trajectory
    offset_s: Array


def _noise(data: Sequence[_CameraData], sums: Sequence[_Sums]) -> Array:
    """(2,) standard deviation of a pixel coordinate for each kind of sighting, from the median of their rms."""
    kind, residual = np.concatenate([d.kind for d in data]), np.concatenate([s.residual_px for s in sums])
    every = float(np.median(residual))
    return np.array([np.clip(np.median(residual[kind == k]) if (kind == k).any() else every, 0.03, 1.5) for k in (0, 1)]) / 2**0.5


def _kept(time_s: Array, without_s: Sequence[tuple[float, float]]) -> NDArray[np.bool_]:
    keep = np.ones(len(time_s), bool)
    for low, high in without_s:
        keep &= (time_s < low) | (time_s > high)
    return keep


def _camera_data(
    seen: CameraDetections, offsets: TimeOffsets, corners: Array, without_s: Sequence[tuple[float, float]]
) -> _CameraData:
    time_s = offsets.common_time(seen.camera, seen.own_time_s)
    chosen = np.flatnonzero(_kept(time_s, without_s))
    counts = np.diff(seen.first)[chosen]
    rows = np.concatenate([np.arange(seen.first[i], seen.first[i + 1]) for i in chosen] or [np.empty(0, int)]).astype(int)
    first = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(int) if len(counts) else np.empty(0, int)
    sighting = np.repeat(np.arange(len(chosen)), counts)
    kind = np.isnan(seen.speed_px_s()[chosen]).astype(int)
    return _CameraData(time_s[chosen], first, corners[seen.corner[rows]], seen.pixels[rows], sighting, kind)


def _start(
    rig: Rig,
    detections: Mapping[str, CameraDetections],
    offsets: TimeOffsets,
    corners: Array,
    settings: TimingSettings,
    without_s: Sequence[tuple[float, float]],
) -> Trajectory:
    times, poses = [], []
    for camera in rig:
        seen, lens = detections[camera.name], Lens(camera.width, camera.height, camera.matrix, camera.distortion)
        time_s = offsets.common_time(camera.name, seen.own_time_s)
        world_from_camera = invert(camera.camera_from_world)
        for i in np.flatnonzero(_kept(time_s, without_s)):
            times.append(time_s[i])
            poses.append(world_from_camera @ board_pose(lens, seen.view(i), corners)[0])
    time_s = np.array(times)
    margin = settings.max_offset_s
    knot_s = max(settings.knot_s, settings.sightings_per_knot * np.ptp(time_s) / len(time_s))
    return fit_poses(empty_trajectory(time_s.min() - margin, time_s.max() + margin, knot_s), time_s, np.array(poses))


def _free_parameters(rig: Rig, free_cameras: bool, constant_lenses: frozenset[str]) -> NDArray[np.bool_]:
    free = np.zeros((len(rig), PARAMETERS), bool)
    free[:, CLOCK] = True
    if free_cameras:
        free[:, :14] = True
        free[0, POSE] = False
        for i, camera in enumerate(rig):
            free[i, LENS] &= camera.name not in constant_lenses
    return free.ravel()


def _sums(camera: Camera, data: _CameraData, trajectory: Trajectory, offset_s: float, sigma_px: Array) -> _Sums:
    """Residuals and derivatives of one camera, summed over the corners of each sighting."""
    first, weights, _ = trajectory.basis(data.time_s + offset_s)
    state, rate = trajectory.states(data.time_s + offset_s)
    motion = motion_jacobian(state)
    turned = np.einsum("nij,nj->ni", Rotation.from_quat(state[:, :4]).as_matrix()[data.sighting], data.board)
    world = turned + state[data.sighting, 4:]
    pixels, by_world = camera.project_with_jacobian(world)
    by_pose = np.concatenate([-by_world @ skew(turned), by_world], axis=2)
    by_state = by_pose @ motion[data.sighting]
    velocity = np.einsum("nrd,nd->nr", by_state, rate[data.sighting])
    local = world @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    by_local = by_world @ camera.camera_from_world[:3, :3].T
    by_camera = [-by_local @ skew(local), by_local, lens_jacobian(camera, local[:, :2] / local[:, 2:]), velocity[..., None]]
    jacobian = np.concatenate([by_state, *by_camera], axis=2)
    residual = data.pixels - pixels
    length2 = (residual**2).sum(1)
    trust = 1 / ((sigma_px**2)[data.kind][data.sighting] + length2 / 9)
    normal = np.einsum("nri,nrj,n->nij", jacobian, jacobian, trust, optimize=True)
    gradient = np.einsum("nri,nr,n->ni", jacobian, residual, trust)
    count = np.diff(np.append(data.first, len(data.board)))
    speed = np.linalg.norm(velocity, axis=1)
    return _Sums(
        jacobian=np.add.reduceat(normal, data.first),
        gradient=np.add.reduceat(gradient, data.first),
        first=first,
        weights=weights,
        residual_px=np.sqrt(np.add.reduceat(length2, data.first) / count),
        speed_px_s=np.add.reduceat(speed, data.first) / count,
    )


def _step(state: _State, sums: list[_Sums], free: NDArray[np.bool_], max_offset_s: float) -> tuple[_State, Array]:
    """One Gauss-Newton step: coefficients eliminated by their band, camera parameters by the Schur complement."""
    cameras = len(sums)
    normal = BandedNormal(state.trajectory)
    border = np.zeros((normal.count, cameras * PARAMETERS))
    corner, right = np.zeros((cameras * PARAMETERS,) * 2), np.zeros(cameras * PARAMETERS)
    for c, s in enumerate(sums):
        own = slice(c * PARAMETERS, (c + 1) * PARAMETERS)
        by_state, mixed = s.jacobian[:, :WIDTH, :WIDTH], s.jacobian[:, WIDTH:, :WIDTH]
        both = np.einsum("nk,nab,nl->nkalb", s.weights, by_state, s.weights, optimize=True).reshape(-1, BAND, BAND)
        normal.add(s.first, both, spread(s.gradient[:, None, :WIDTH], s.weights)[:, 0])
        rows = (s.first * WIDTH)[:, None] + np.arange(BAND)
        np.add.at(border[:, own], rows, spread(mixed, s.weights).transpose(0, 2, 1))
        corner[own, own] = s.jacobian[:, WIDTH:, WIDTH:].sum(0)
        right[own] = s.gradient[:, WIDTH:].sum(0)
        lens = slice(own.start + LENS.start, own.start + LENS.stop)
        prior, pull = lens_prior(state.rig[c])
        corner[lens, lens] += prior
        right[lens] += pull
    clock = np.arange(cameras) * PARAMETERS + CLOCK.start
    # the common mean of the clocks is the trajectory's own: a microsecond's prior keeps it where it is
    corner[np.ix_(clock, clock)] += 1 / (cameras * 1e-6) ** 2
    right[clock] -= state.offset_s.sum() / (cameras * 1e-6) ** 2
    border, corner, right = border[:, free], corner[np.ix_(free, free)], right[free]
    solved = normal.solve(np.column_stack([border, normal.right]))
    schur = corner - border.T @ solved[:, :-1]
    # parameters differ in scale by many orders: a relative damping keeps weak directions where they are
    scale = 1 / np.sqrt(np.diag(schur) * (1 + 1e-9) + 1e-12)
    inverse = np.linalg.inv(schur * np.outer(scale, scale) + 1e-9 * np.eye(len(scale))) * np.outer(scale, scale)
    step = np.zeros(cameras * PARAMETERS)
    step[free] = inverse @ (right - border.T @ solved[:, -1])
    coefficients = (solved[:, -1] - solved[:, :-1] @ step[free]).reshape(-1, WIDTH)
    variance = np.zeros(cameras * PARAMETERS)
    variance[free] = np.diag(inverse)
    return _moved(state, coefficients, step.reshape(cameras, PARAMETERS), max_offset_s), np.sqrt(np.abs(variance[clock]))


def _moved(state: _State, coefficients: Array, step: Array, max_offset_s: float) -> _State:
    cameras = [changed_camera(camera, change) for camera, change in zip(state.rig, step, strict=True)]
    offset_s = np.clip(state.offset_s + step[:, CLOCK.start], -max_offset_s, max_offset_s)
    trajectory = replace(state.trajectory, coefficients=state.trajectory.coefficients + coefficients)
    return _State(Rig(tuple(cameras)), trajectory, offset_s)
