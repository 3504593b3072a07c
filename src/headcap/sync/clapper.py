"""Where the clapper was, from cameras whose pictures and sound disagree about their start."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.sync.settings import SyncSettings

Array = NDArray[np.float64]

LEAST_CAMERAS = 5
ITERATIONS = 50


@dataclass(frozen=True)
class ClapperEstimate:
    """The clapper's place and what is left over as each camera's own delay between picture and sound."""

    clapper_m: Array
    """(3,) in the frame of the camera centres."""
    clapper_std_m: Array
    """(3,) standard deviation of each coordinate."""
    av_offset_s: dict[str, float]
    """By how much a camera's pictures are later on the common clock than its sound says; 0 where not significant."""
    residual_rms_s: float
    """Of picture minus sound, over cameras without a delay of their own, after the fit."""


def flight_sensitivity_s_per_m(
    camera_centres: Mapping[str, Array], clapper_m: Array, settings: SyncSettings | None = None
) -> Array:
    """(3,) rms over cameras of the start times' error, seconds per metre that the clapper is off along x, y and z.

    The common part of the error is taken out: it moves all cameras alike. With cameras all around a face it is 1 to 2 ms
    per metre.
    """
    speed = (settings or SyncSettings()).speed_of_sound
    away = np.asarray(clapper_m, float) - np.array([np.asarray(centre, float) for centre in camera_centres.values()])
    slope = away / np.linalg.norm(away, axis=1, keepdims=True) / speed
    return slope.std(axis=0)


def refine_clapper(
    camera_centres: Mapping[str, Array],
    picture_minus_sound_s: Mapping[str, float],
    clapper_m: Array,
    *,
    clapper_std_m: float = 0.15,
    picture_std_s: Mapping[str, float] | float = 5e-5,
    significance: float = 4.0,
    settings: SyncSettings | None = None,
) -> ClapperEstimate:
    """Place the clapper by the difference of two start times per camera: from pictures and from sound.

    `picture_minus_sound_s` is, per camera and up to one constant for all, the start time from its pictures (the board's
    motion) minus `synchronise`'s, which took off the flight from `clapper_m`. That difference is
    (|centre - place| - |centre - clapper_m|) / speed of sound + constant + the camera's own delay. Place and constant are
    solved for (Gauss-Newton), with the rough place as a prior of `clapper_std_m` and a Cauchy loss, so a few cameras
    with delays of their own do not pull the place. The differences count by `picture_std_s` or by their own scatter about
    the solution, whichever is larger, so start times worse than stated fall back on the rough place. What remains beyond
    `significance` standard deviations (likewise) is taken for a delay between picture and sound.

    With fewer than five cameras the place stays as it was and nothing is called a delay.
    """
    cameras = [camera for camera in picture_minus_sound_s if camera in camera_centres]
    rough = np.asarray(clapper_m, float)
    if len(cameras) < LEAST_CAMERAS:
        return ClapperEstimate(rough, np.full(3, clapper_std_m), dict.fromkeys(cameras, 0.0), float("nan"))
    speed = (settings or SyncSettings()).speed_of_sound
    centres = np.array([camera_centres[camera] for camera in cameras], float)
    difference = np.array([picture_minus_sound_s[camera] for camera in cameras], float)
    std = np.array([picture_std_s[c] if isinstance(picture_std_s, Mapping) else picture_std_s for c in cameras], float)
    place, constant, covariance = _solve(centres, difference, std, rough, clapper_std_m, speed)
    residual = difference - constant - _flight_change_s(centres, place, rough, speed)
    scatter = 1.4826 * float(np.median(np.abs(residual - np.median(residual))))
    delayed = np.abs(residual) > significance * np.maximum(std, scatter)
    kept = residual[~delayed]
    offsets = {camera: float(r) if late else 0.0 for camera, r, late in zip(cameras, residual, delayed, strict=True)}
    rms_s = float(np.sqrt(np.mean(kept**2))) if len(kept) else float("nan")
    return ClapperEstimate(place, np.sqrt(np.diag(covariance)[:3]), offsets, rms_s)


def _flight_change_s(centres: Array, place: Array, rough: Array, speed: float) -> Array:
    """(cameras,) time of flight from a place minus that from the rough one."""
    return (np.linalg.norm(centres - place, axis=1) - np.linalg.norm(centres - rough, axis=1)) / speed


def _solve(
    centres: Array, difference: Array, std: Array, rough: Array, prior_std_m: float, speed: float
) -> tuple[Array, float, Array]:
    """Place (3,), constant and their covariance (4, 4)."""
    place, constant = rough.copy(), float(np.median(difference))
    prior = np.diag([1 / prior_std_m**2] * 3 + [0.0])
    normal = prior
    for _ in range(ITERATIONS):
        away = place - centres
        jacobian = np.hstack([away / np.linalg.norm(away, axis=1, keepdims=True) / speed, np.ones((len(centres), 1))])
        residual = difference - constant - _flight_change_s(centres, place, rough, speed)
        # stated errors may be too small; four of the residuals' degrees of freedom are spent on place and constant
        scatter = 1.4826 * float(np.median(np.abs(residual))) * np.sqrt(len(std) / (len(std) - 4))
        trusted = np.maximum(std, scatter)
        weight = 1 / trusted**2 / (1 + (residual / (3 * trusted)) ** 2)
        normal = jacobian.T @ (weight[:, None] * jacobian) + prior
        right = jacobian.T @ (weight * residual) + prior @ np.append(rough - place, 0.0)
        step = np.linalg.solve(normal, right)
        place, constant = place + step[:3], constant + float(step[3])
        if np.abs(step[:3]).max() < 1e-7:
            break
    return place, constant, np.linalg.inv(normal)
