"""A camera that freezes for a while: its picture rests although the other cameras of the take see motion."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from headcap.recordings.settings import IngestSettings

Array = NDArray[np.float64]

LEAST_FRAMES = 5
LEAST_COMPARED = 3
# share of the frames that must say so
MOST = 0.8


@dataclass(frozen=True)
class Freeze:
    """A stretch in which a camera shows one picture while others see motion."""

    camera: str
    from_s: float
    """Own time of the first frame that repeats the one before."""
    until_s: float
    """Own time of the last one."""
    frames: int
    cameras_moving: int
    cameras_compared: int


@dataclass(frozen=True)
class _Profile:
    """One camera's motion on a regular grid of its own clock."""

    first: int
    """Number of the first grid point."""
    motion: Array
    """(n,) log2 of the change over the still level, at least 0: 0 is still, 1 and more is motion."""


def find_freezes(
    changes: Mapping[str, tuple[Array, Array]],
    rate_hz: float,
    settings: IngestSettings,
    *,
    start_s: Mapping[str, float] | None = None,
) -> list[Freeze]:
    """The longest freeze of each camera of a take; `changes` are, per camera, own times (n,) and changes (n,) of frames.

    For a stretch in which one camera is still, each other camera is laid beside it. It testifies to a freeze if it moves
    there for `frozen_min_s`, and if elsewhere the first camera moves where the other moves no more than it does in the
    stretch (a camera behind the head sees no lips). More than half of the cameras must testify. So a pause of the subject,
    which all cameras see, is no freeze, nor is a camera that sees less than others.

    `start_s` is the common time of each camera's own zero. Where it is not known yet, the others are laid beside the camera
    at every shift up to `start_spread_s` and must move at all of them: what might be a pause of the subject is let pass.
    """
    starts = dict(start_s) if start_s is not None else dict.fromkeys(changes, 0.0)
    profiles = {
        camera: _profile(np.asarray(time_s) + starts[camera], change, rate_hz, settings)
        for camera, (time_s, change) in changes.items()
        if len(time_s) > 1
    }
    # frames of different cameras are up to half a frame off each other
    spread = round(settings.start_spread_s * rate_hz) if start_s is None else 1
    least = max(LEAST_FRAMES, round(settings.frozen_min_s * rate_hz))
    found = []
    for camera, profile in profiles.items():
        others = [other for name, other in profiles.items() if name != camera]
        for begin, end in _still_stretches(profile, least):
            if start_s is None and not profile.motion[:begin].any():
                continue  # it may have started before the others, in a pause that they saw less of
            seen = _witnessed(profile, others, (begin, end), spread, least)
            if seen:
                moving = np.flatnonzero(2 * np.sum(seen, axis=0) >= len(seen))
                from_s, until_s = ((profile.first + begin + k) / rate_hz - starts[camera] for k in moving[[0, -1]])
                found.append(Freeze(camera, from_s, until_s, int(np.ptp(moving)) + 1, len(seen), len(others)))
                break
    return found


def _profile(time_s: Array, change: Array, rate_hz: float, settings: IngestSettings) -> _Profile:
    numbers = np.rint(np.asarray(time_s) * rate_hz).astype(int)
    motion = np.zeros(numbers[-1] - numbers[0] + 1)
    # over dropped frames the change is that of several frames, and belongs to each of them
    value = np.log2(np.maximum(np.asarray(change, float) / settings.still_level, 1.0))
    for before, number, moved in zip(numbers[:-1], numbers[1:], value[1:], strict=True):
        motion[before + 1 - numbers[0] : number + 1 - numbers[0]] = moved
    motion[0] = motion[1] if len(motion) > 1 else 0.0
    return _Profile(int(numbers[0]), motion)


def _still_stretches(profile: _Profile, least: int) -> list[tuple[int, int]]:
    """Begin and end of runs of at least so many frames without motion, the longest first."""
    runs = [(begin, end) for begin, end in _runs(profile.motion == 0) if end - begin >= least]
    return sorted(runs, key=lambda run: run[0] - run[1])


def _witnessed(
    profile: _Profile, others: list[_Profile], stretch: tuple[int, int], spread: int, least: int
) -> list[NDArray[np.bool_]]:
    """Of each camera that testifies to a freeze when it moves in the stretch; empty unless more than half of them do."""
    seen = []
    for number, other in enumerate(others):
        moving = _testimony(profile, other, stretch, spread, least)
        seen += [] if moving is None else [moving]
        if 2 * (len(seen) + len(others) - number - 1) <= len(others):
            return []
    return seen


def _testimony(profile: _Profile, other: _Profile, stretch: tuple[int, int], spread: int, least: int) -> NDArray[np.bool_] | None:
    """When another camera moves in a stretch (n,), if that shows that the stillness is the camera's own; else None."""
    windows = _shifted(other, profile.first, len(profile.motion), spread)
    inside = windows[:, slice(*stretch)]
    possible = np.isfinite(inside).all(axis=1)
    if not possible.any() or any(_longest(window >= 1) < least for window in inside[possible]):
        return None
    # the shift nearest to none
    middle = min(np.flatnonzero(possible), key=lambda shift: abs(shift - spread))
    elsewhere = np.isfinite(windows[middle])
    elsewhere[slice(*stretch)] = False
    if not _moves_along(profile.motion[elsewhere], windows[middle][elsewhere], inside[middle]):
        return None
    return inside[middle] >= 1


def _shifted(other: _Profile, first: int, length: int, spread: int) -> Array:
    """(shifts, length) another camera's motion beside a window of `length` from grid point `first`; NaN beyond its ends."""
    low = first - spread
    padded = np.full(length + 2 * spread, np.nan)
    begin, end = max(other.first - low, 0), min(other.first + len(other.motion) - low, len(padded))
    if end > begin:
        padded[begin:end] = other.motion[begin + low - other.first : end + low - other.first]
    return sliding_window_view(padded, length)


def _moves_along(own: Array, other: Array, other_in_stretch: Array) -> bool:
    """Whether elsewhere a camera clearly moves where another one moves no more than it does in the stretch."""
    usual = float(np.median(other_in_stretch[other_in_stretch >= 1]))
    comparable = (other >= 1) & (other <= usual + 0.5)
    return comparable.sum() >= LEAST_COMPARED and (own[comparable] >= 1).mean() >= MOST


def _longest(told: NDArray[np.bool_]) -> int:
    return max((end - begin for begin, end in _runs(told)), default=0)


def _runs(told: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Begin and end of each run of true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], told, [False]]).astype(int)))
    return ((int(begin), int(end)) for begin, end in edges.reshape(-1, 2))
