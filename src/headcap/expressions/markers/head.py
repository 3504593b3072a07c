"""The head's motion by markers that do not move with the face (section 5.1: seven of them), named or found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.expressions.head_motion import fit_rigid_frames, moved_frames
from headcap.expressions.markers.settings import MarkerSettings
from headcap.expressions.markers.take import MarkerTake
from headcap.expressions.mesh_frames import frame_runs
from headcap.geometry.transforms import fit_rigid, transform

_ROUNDS = 3
_LEAST_WIDTH_M = 0.01
"""Spread of rigid markers across the line they lie along: below it the turn about that line is not told."""
_NAMED_OFF, _LEAST_SEEN = 3.0, 0.5


def rigid_markers(take: MarkerTake, names: Sequence[str] | None, settings: MarkerSettings) -> NDArray[np.int64]:
    """Places (r,) of the markers named, or of the largest set found whose mutual distances stay constant.

    Grown from each pair by the marker whose distances to the set vary least. Raises `InputError` where there are less than three.
    """
    if names is not None:
        chosen = take.numbers(names)
    else:
        chosen = _constant_distances(take.positions_m, 1e-3 * settings.rigid_tolerance_mm)
    if len(chosen) < 3:
        raise InputError(
            f"{take.source} has {len(chosen)} markers "
            + ("named as rigid" if names is not None else f"whose distances stay within {settings.rigid_tolerance_mm:g} mm"),
            expected="three at least, not in a line",
            remedy="Name the markers on the skull or headband.",
        )
    return chosen


def _constant_distances(positions: NDArray, tolerance_m: float) -> NDArray[np.int64]:
    spread = _distance_spread(positions)
    fits = spread < tolerance_m
    best = np.zeros(0, np.int64)
    for seed in np.argsort(-fits.sum(axis=1), kind="stable"):
        if fits[seed].sum() + 1 <= len(best):
            break
        members, worst = [int(seed)], spread[seed].copy()
        while True:
            worst[members] = np.inf
            following = int(worst.argmin())
            if worst[following] >= tolerance_m:
                break
            members.append(following)
            worst = np.maximum(worst, spread[following])
        if len(members) > len(best):
            best = np.sort(members)
    return best


def _distance_spread(positions: NDArray) -> NDArray[np.float64]:
    """(k, k) standard deviation of distances over the frames that show both; infinite for pairs that are seldom seen together."""
    count = positions.shape[1]
    spread = np.full((count, count), np.inf)
    for one in range(count):
        apart = np.linalg.norm(positions - positions[:, one : one + 1], axis=2)
        known = np.isfinite(apart)
        enough = known.sum(axis=0) >= max(2, _LEAST_SEEN * len(positions))
        if enough.any():
            spread[one, enough] = np.nanstd(apart[:, enough], axis=0)
    np.fill_diagonal(spread, np.inf)
    return spread


def head_motion(
    take: MarkerTake, rigid: NDArray[np.int64], neutral_frame: int, settings: MarkerSettings
) -> tuple[NDArray[np.float64], float]:
    """head_from_capture (f, 4, 4), the identity at the neutral frame but for noise; rms residual of the rigid markers, mm.

    The markers' common shape is their mean over all frames, aligned (generalised Procrustes); frames take what they see of it.
    Raises `InputError` where a frame shows too few of them, and for a marker that does not hold still with the others.
    """
    points, seen = take.positions_m[:, rigid], take.seen[:, rigid]
    start = points[neutral_frame]
    _refuse_too_few(take, seen, start)
    shape = start
    for _ in range(_ROUNDS):
        aligned = moved_frames(fit_rigid_frames(points, shape, seen), points)
        shape = np.nanmean(aligned, axis=0)
        shape = transform(fit_rigid(shape, start), shape)
    motion = fit_rigid_frames(points, shape, seen)
    squared = ((moved_frames(motion, points) - shape) ** 2).sum(axis=2)
    if 1e3 * np.sqrt(np.nanmean(squared, axis=0)).max() > _NAMED_OFF * settings.rigid_tolerance_mm:
        _refuse_loose(take, rigid, points, shape, settings)
    return motion, float(1e3 * np.sqrt(np.nanmean(squared)))


def _refuse_loose(take: MarkerTake, rigid: NDArray, points: NDArray, shape: NDArray, settings: MarkerSettings) -> None:
    """Name the marker that the others agree best without; in a common fit its motion would show as theirs."""
    off_mm, others_mm = np.zeros(len(rigid)), np.zeros(len(rigid))
    for marker in range(len(rigid)):
        weights = np.isfinite(points[:, :, 0]) & (np.arange(len(rigid)) != marker)
        told = weights.sum(axis=1) >= 3
        if not told.any():
            continue
        aligned = moved_frames(fit_rigid_frames(points[told], shape, weights[told]), points[told])
        squared = ((aligned - shape) ** 2).sum(axis=2)
        off_mm[marker] = 1e3 * np.sqrt(np.nanmean(squared[:, marker]))
        others_mm[marker] = 1e3 * np.sqrt(np.nanmean(np.delete(squared, marker, axis=1)))
    worst = int(np.where(off_mm > 0, others_mm, np.inf).argmin())
    told = f"marker {take.names[rigid[worst]]} lies {off_mm[worst]:.1f} mm rms off the others' motion"
    raise InputError(
        f"{take.source}: rigid {told if off_mm.any() else 'markers change their distances'}",
        expected=f"{_NAMED_OFF * settings.rigid_tolerance_mm:g} mm at most",
        remedy="Name rigid markers that sit on the skull or on one band, and leave this one out.",
    )


def _refuse_too_few(take: MarkerTake, seen: NDArray[np.bool_], start: NDArray) -> None:
    patterns, which = np.unique(seen, axis=0, return_inverse=True)
    told = np.array([_width(start[pattern]) > _LEAST_WIDTH_M for pattern in patterns])
    poor = np.flatnonzero(~told[which.ravel()])
    if len(poor):
        raise InputError(
            f"{take.source} shows less than three rigid markers, or three in a line, in frames {frame_runs(poor)}",
            expected="three at least, spread over the head, in every frame",
            remedy="Fill them where they were captured, cut these frames, or name more rigid markers.",
        )


def _width(points: NDArray) -> float:
    if len(points) < 3:
        return 0.0
    return float(np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1])
