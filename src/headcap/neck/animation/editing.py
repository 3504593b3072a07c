"""Edits of coefficient curves (section 7.4, neck motion editing): scale, offset, exaggerate, key, add; each has an inverse.

The paper edits "by simply adjusting the coefficients" and shows larynx shape and range exaggerated (figure 14); which operations
an editor has is chosen here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.neck.animation.curves import REST, CoefficientCurves

FADE_S = 0.25
"""Time over which keys take hold before the first of them and let go after the last."""


def scaled(curves: CoefficientCurves, name: str, factor: float) -> CoefficientCurves:
    """A curve times a factor: alpha by 1.5 is a larynx half as prominent again, tau by 1.5 one that slides half as far again.

    1 / factor is the inverse. Raises `InputError` for an unknown curve or a factor that is no number.
    """
    return curves.with_curve(name, curves.curve(name) * _number(factor, name))


def shifted(curves: CoefficientCurves, name: str, amount: float) -> CoefficientCurves:
    """A curve plus an amount, in its own units (tau in metres); -amount is the inverse."""
    return curves.with_curve(name, curves.curve(name) + _number(amount, name))


def exaggerated(curves: CoefficientCurves, name: str, factor: float) -> CoefficientCurves:
    """A curve's departures from its mean over all frames, times a factor; the mean stays and 1 / factor is the inverse."""
    values = curves.curve(name)
    mean = values.mean(axis=0)
    return curves.with_curve(name, mean + _number(factor, name) * (values - mean))


def keyed(curves: CoefficientCurves, name: str, keys: Sequence[tuple[float, float]], fade_s: float = FADE_S) -> CoefficientCurves:
    """A single curve bent so that it takes the value of each key (moment in s, value) at the frame nearest to its moment.

    What is added is the difference at the keys, in between by monotone cubics (PCHIP, Fritsch and Carlson 1980: nothing
    overshoots), fading to nothing within `fade_s` before the first key and after the last. Fine motion between keys stays as it
    was. Keys at the same moments with the former values are the inverse. Raises `InputError` for a curve of several components,
    keys outside the curve, or two keys of one frame.
    """
    values = curves.curve(name)
    if values.ndim != 1:
        raise InputError(f"keys of {name}", expected=f"one component, such as {name}.0 or {name}.x", remedy="Key one curve.")
    moments = np.array([_number(time, name) for time, _ in keys])
    step_s = float(np.median(np.diff(curves.time_s))) if len(curves) > 1 else 0.0
    frames = np.abs(curves.time_s[:, None] - moments).argmin(axis=0)
    away = np.abs(curves.time_s[frames] - moments)
    if len(keys) == 0 or (away > 0.501 * step_s + 1e-9).any() or len(np.unique(frames)) < len(frames):
        raise InputError(
            f"keys of {name} at {', '.join(f'{time:g}' for time in moments) or 'no moment'} s",
            expected=f"different frames within {curves.time_s[0]:.3f} to {curves.time_s[-1]:.3f} s",
            remedy="Correct the moments of the keys.",
        )
    order = np.argsort(frames)
    wanted = np.array([_number(value, name) for _, value in keys])[order]
    frames = frames[order]
    return curves.with_curve(name, values + _bend(curves.time_s, frames, wanted - values[frames], max(fade_s, 1e-6)))


def _bend(time_s: NDArray, frames: NDArray, difference: NDArray, fade_s: float) -> NDArray[np.float64]:
    from scipy.interpolate import PchipInterpolator

    at = time_s[frames]
    at = np.concatenate([[at[0] - fade_s], at, [at[-1] + fade_s]])
    smooth = PchipInterpolator(at, np.concatenate([[0.0], difference, [0.0]]), extrapolate=False)
    return np.nan_to_num(smooth(time_s), nan=0.0)


def added(curves: CoefficientCurves, other: CoefficientCurves, at_s: float, *, sign: float = 1.0) -> CoefficientCurves:
    """Curves with the motion of others laid on from a moment on: a swallow in a pause of speech; sign -1 is the inverse.

    The motion is what `other` departs from the straight line between its first and last frame, so that nothing jumps where it
    begins and ends. A channel that only `other` has starts from rest. Raises `InputError` where `other` does not fit into the
    curves' time, or is of another model.
    """
    if other.model_version and curves.model_version:
        other.check_model(curves.model_version)
    own_s = curves.time_s - at_s + other.time_s[0]
    last = curves.time_s[-1] + (float(np.median(np.diff(curves.time_s))) if len(curves) > 1 else 0.0)
    if not curves.time_s[0] - 1e-9 <= at_s or at_s + other.duration_s > last + 1e-9:
        raise InputError(
            f"motion of {other.duration_s:.3f} s from {at_s:g} s on",
            expected=f"room for it between {curves.time_s[0]:.3f} and {curves.time_s[-1]:.3f} s",
            remedy="Begin earlier, or make the curves longer.",
        )
    channels = dict(curves.channels)
    for name, values in other.channels.items():
        before = channels.get(name, np.full((len(curves), *values.shape[1:]), REST.get(name, 0.0)))
        if before.shape[1:] != values.shape[1:]:
            raise InputError(
                f"{name} of {values.shape[1:]} components on {before.shape[1:]}", expected="as many", remedy="Use one model."
            )
        channels[name] = before + sign * _departure(own_s, other.time_s, values)
    return replace(curves, channels=channels, model_version=curves.model_version or other.model_version)


def _departure(time_s: NDArray, known_s: NDArray, values: NDArray) -> NDArray[np.float64]:
    """Values (k, ...) less the line through their ends, at moments (n,); 0 outside."""
    share = ((known_s - known_s[0]) / max(known_s[-1] - known_s[0], 1e-12)).reshape(-1, *[1] * (values.ndim - 1))
    away = (values - (1 - share) * values[0] - share * values[-1]).reshape(len(known_s), -1)
    columns = [np.interp(time_s, known_s, column, left=0.0, right=0.0) for column in away.T]
    return np.array(columns).T.reshape(len(time_s), *values.shape[1:])


def _number(value: float, name: str) -> float:
    if not np.isfinite(value):
        raise InputError(f"{value} for {name}", expected="a finite number", remedy="Correct the edit.")
    return float(value)
