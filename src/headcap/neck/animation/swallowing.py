"""Swallowing (section 7.4): a ready curve, and the swallow of a fitted take."""

from __future__ import annotations

import numpy as np

from headcap.errors import InputError
from headcap.neck.animation.curves import CoefficientCurves

RISE_M, SECONDS, ALPHA_AT_TOP = 0.022, 1.0, 0.7
_UP, _TOP = 0.4, 0.15
"""Shares of the time in which the larynx rises, and stays up; the rest it returns in."""
LEAST_RISE_M = 0.005
"""Speech moves a larynx by a few millimetres, a swallow by a centimetre and more."""
_FOOT = 0.05
"""Share of its height below which a swallow is over."""


def swallow(
    fps: float, *, rise_m: float = RISE_M, seconds: float = SECONDS, alpha_at_top: float = ALPHA_AT_TOP, rest_s: float = 0.25
) -> CoefficientCurves:
    """tau and alpha of one swallow, with `rest_s` of rest on either side, for any model with a larynx.

    The larynx rises by 20 to 25 mm (the reach of `SlideSettings`) and is back within about a second: a swallow takes 1.1 s,
    standard deviation 0.3 (Deng et al. 2015, 40 people). How far it rises is stated very differently by method and landmark
    (Molfenter and Steele 2011, a review; Deng et al.: the laryngeal ventricle by 10 mm, standard deviation 5): give a subject's
    own rise where it is known, or cut one from a take. alpha falls as tau rises, as in the paper's figure 9: the higher the
    larynx, the deeper it lies; how far it falls, to 0.7, is chosen here. Up and down are minimum-jerk courses (Flash and Hogan
    1985). Raises `InputError` for a rate, height or time that is not positive.
    """
    given = (("frames per second", fps), ("metres of rise", rise_m), ("seconds", seconds), ("seconds of rest", rest_s + 1e-12))
    for name, value in given:
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"a swallow of {value:g} {name}", expected="a positive number", remedy="Correct it.")
    time_s = np.arange(round((seconds + 2 * rest_s) * fps) + 1) / fps
    share = (time_s - rest_s) / seconds
    height = _minimum_jerk(share / _UP) - _minimum_jerk((share - _UP - _TOP) / (1 - _UP - _TOP))
    return CoefficientCurves(time_s, {"tau": rise_m * height, "alpha": 1 - (1 - alpha_at_top) * height})


def _minimum_jerk(share: np.ndarray) -> np.ndarray:
    """From 0 to 1 with velocity and acceleration 0 at both ends."""
    s = np.clip(share, 0.0, 1.0)
    return s**3 * (10 - 15 * s + 6 * s**2)


def find_swallow(curves: CoefficientCurves, *, longest_s: float = 2.0, rest_s: float = 0.1) -> CoefficientCurves:
    """The part of a take's curves in which its highest slide rises from its foot and returns to it.

    The foot on either side is the lowest tau within `longest_s` of the top; the swallow ends where tau comes within a twentieth
    of the rise above it, and `rest_s` are kept around. Raises `InputError` where the larynx rises by less than 5 mm on either
    side: that is speech, or half a swallow.
    """
    tau, time_s = curves.curve("tau"), curves.time_s
    top = int(tau.argmax())
    ends, rises = [], []
    for side in (np.arange(top, -1, -1), np.arange(top, len(tau))):
        side = side[np.abs(time_s[side] - time_s[top]) <= longest_s]
        foot = tau[side].min()
        rises.append(tau[top] - foot)
        ends.append(side[np.argmax(tau[side] <= foot + _FOOT * rises[-1])])
    if min(rises) < LEAST_RISE_M:
        raise InputError(
            f"a larynx that rises by {1e3 * rises[0]:.1f} mm to its highest place and falls by {1e3 * rises[1]:.1f} mm from it",
            expected=f"at least {1e3 * LEAST_RISE_M:g} mm either way, as in a swallow",
            remedy="Give a take with a whole swallow in it, or the moments to cut",
        )
    return curves.cut(time_s[ends[0]] - rest_s, time_s[ends[1]] + rest_s)
