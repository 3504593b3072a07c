"""Lips that touch: they are closed at rest, flatten where they press on each other and never pass through."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from headcap.synthetic.anatomy import Fields

_THIN_M, _SOFT_M = 0.00005, 0.00004
"""Half of what is left between touching lips, and the height over which they round off to it."""
_PRESS_M = 0.0003
"""How far relaxed lips would reach into each other if they did not flatten: it makes a line of contact a band."""
_CLOSING_REACH_M = 0.0035
_ROLL_IN_RAD, _ROLL_OUT_RAD = 1.2, 0.75
_ROLL_AXIS_M = (0.0005, 0.0035)
"""Where the axis of a rolling lip runs: ahead of its rim and away from the other lip, about the middle of the lip's flesh."""
_ROLL_CORE_M, _ROLL_REACH_M = 0.0045, 0.012
"""What lies so near the axis turns as a body; farther off skin gives way, and beyond the reach it stays."""
_ROLL_BACK_M = 0.0015
"""Lips that roll in draw back over the teeth, those that roll out come forward."""
_ROLL_PRESS_M = 0.0012
"""Lips that roll in press on each other, or what they turn away would leave a gap."""
_FADE_M = (0.006, 0.03)
"""Skin's motion dies out between these depths of the mouth: the lips' backs still go with their fronts."""


@dataclass(frozen=True)
class LipContact:
    """Where the lips meet: all between them happens on either side of a sheet through the two rims."""

    rims: tuple[NDArray[np.int64], NDArray[np.int64]]
    """Vertices (k,) of the upper and the lower rim from the right corner to the left, in pairs; one vertex at the corners."""
    sides: tuple[NDArray[np.int64], NDArray[np.int64]]
    """Vertices of the upper and the lower lip between the corners, the rims among them."""
    freedom: tuple[NDArray[np.float64], NDArray[np.float64]]
    """For each of these 1 in the middle, 0 at the corners, where the two lips are one."""

    def keep_apart(self, points: NDArray) -> None:
        """Lay the lips (of points (n, 3), changed in place) on the sheet between the rims where they would cross it.

        A vertex's height h over the sheet becomes thin + soft * softplus((h - thin) / soft).
        """
        sheet = self.sheet(points)
        for side, vertices, freedom in zip((1.0, -1.0), self.sides, self.freedom, strict=True):
            middle = sheet(points[vertices, 0])
            thin, soft = _THIN_M * freedom, _SOFT_M * np.maximum(freedom, 1e-3)
            height = side * (points[vertices, 1] - middle)
            held = thin + soft * np.logaddexp(0, (height - thin) / soft)
            points[vertices, 1] = middle + side * held

    def sheet(self, points: NDArray) -> PchipInterpolator:
        """Height y midway between the rims of points (n, 3), as a function of x."""
        return _halfway(*(_curve(points[rim], 1) for rim in self.rims))


def roll_lips(
    points: NDArray, zone: NDArray, contact: LipContact, fields: Fields, arch_centre_z: float, rolls: tuple[float, float]
) -> None:
    """Roll the upper and the lower lip (`rolls`, -1 out to 1 in) about axes inside them, points (n, 3) of `zone` in place.

    Each cross-section of a lip swirls: it turns about the axis by an angle that depends on the distance from it alone, which
    folds nothing whatever the angle. At the corners, where the lips are one skin, it dies out.
    """
    for side, rim, field, roll in zip((1, -1), contact.rims, (fields.upper_lip, fields.lower_lip), rolls, strict=True):
        if abs(roll) < 1e-6:
            continue
        p = points[zone]
        turn, radius = np.arctan2(p[:, 0], p[:, 2] - arch_centre_z), np.hypot(p[:, 0], p[:, 2] - arch_centre_z)
        axis_turn = np.arctan2(points[rim, 0], points[rim, 2] - arch_centre_z)
        axis = np.stack([np.hypot(points[rim, 0], points[rim, 2] - arch_centre_z), points[rim, 1]], axis=1)
        freedom = np.clip(1 - np.where(turn < 0, turn / axis_turn[0], turn / axis_turn[-1]) ** 4, 0, 1)
        # lips thin out towards the corners, and so does what they roll about
        within = np.stack([np.full(len(p), _ROLL_AXIS_M[0]), side * _ROLL_AXIS_M[1] * (0.4 + 0.6 * freedom)], axis=1)
        axis = _along(turn, axis_turn, axis) + within
        ahead, above = radius - axis[:, 0], p[:, 1] - axis[:, 1]
        part = np.clip((np.hypot(ahead, above) - _ROLL_CORE_M) / (_ROLL_REACH_M - _ROLL_CORE_M), 0, 1)
        share = roll * field[zone] * freedom * (1 - part * part * (3 - 2 * part))
        angle = side * share * (_ROLL_IN_RAD if roll > 0 else _ROLL_OUT_RAD)
        c, s = np.cos(angle), np.sin(angle)
        radius = axis[:, 0] + c * ahead + s * above - _ROLL_BACK_M * share
        height = axis[:, 1] - s * ahead + c * above - side * _ROLL_PRESS_M * np.maximum(share, 0)
        points[zone] = np.stack([radius * np.sin(turn), height, arch_centre_z + radius * np.cos(turn)], axis=1)


def build_contact(points: NDArray, pairs: NDArray, upper: NDArray, lower: NDArray) -> LipContact:
    """The contact of resting points (n, 3) with rims `pairs` (k, 2) from right to left and masks (n,) of the two lips."""
    right, left = points[pairs[0, 0], 0], points[pairs[-1, 0], 0]
    # 1 in the middle, 0 at and beyond either corner
    freedom = np.clip(1 - np.where(points[:, 0] < 0, points[:, 0] / right, points[:, 0] / left) ** 4, 0, 1)
    sides = tuple(np.flatnonzero(mask & (freedom > 0)) for mask in (upper, lower))
    return LipContact((pairs[:, 0], pairs[:, 1]), sides, tuple(freedom[side] for side in sides))


def close_lips(points: NDArray, pairs: NDArray, upper: NDArray, lower: NDArray) -> NDArray[np.float64]:
    """Points (n, 3) with the two lips brought together until their rims would overlap by a little, all along the mouth.

    `upper` and `lower` (n,) are masks of all skin on either side of the mouth; it follows the rims, the less the farther.
    """
    x = points[pairs, 0].mean(1)
    corner = np.where(x < 0, x / x[0], x / x[-1])
    missing = points[pairs[:, 0]] - points[pairs[:, 1]]
    missing[:, 1] += _PRESS_M * (1 - corner**4)
    out = points.copy()
    for way, mask, rim in ((-0.5, upper, points[pairs[:, 0]]), (0.5, lower, points[pairs[:, 1]])):
        near = np.flatnonzero(mask & (np.abs(points[:, 1:] - rim[:, 1:].mean(0)).max(1) < 8 * _CLOSING_REACH_M))
        away = points[near, 1:] - _along(points[near, 0], rim[:, 0], rim[:, 1:])
        share = np.exp(-0.5 * (away**2).sum(1) / _CLOSING_REACH_M**2)
        out[near] += way * share[:, None] * _along(points[near, 0], x, missing)
    return out


def follows_face(points: NDArray, pairs: NDArray, inside: NDArray) -> NDArray[np.float64]:
    """How far (n,) points (n, 3) follow the face's skin: wholly outside, less and less with their depth in the mouth."""
    rim = points[pairs].mean(1)
    depth = np.interp(points[:, 0], rim[:, 0], rim[:, 2]) - points[:, 2]
    part = np.clip((_FADE_M[1] - depth) / (_FADE_M[1] - _FADE_M[0]), 0, 1)
    return np.where(inside, part * part * (3 - 2 * part), 1.0)


def _along(x: NDArray, places: NDArray, values: NDArray) -> NDArray[np.float64]:
    """Values (k, c), known at rising places (k,), at x (n,)."""
    return np.stack([np.interp(x, places, column) for column in values.T], axis=1)


def _curve(rim: NDArray, axis: int) -> tuple[NDArray, NDArray]:
    """One coordinate of a rim over x, x rising: where corners fold back, the first of what shares a place."""
    order = np.argsort(rim[:, 0], kind="stable")
    x = rim[order, 0]
    keep = np.r_[True, np.diff(x) > 1e-7]
    return x[keep], rim[order, axis][keep]


def _halfway(first: tuple[NDArray, NDArray], second: tuple[NDArray, NDArray]) -> PchipInterpolator:
    """The mean of two curves over the places of both, level beyond the ends."""
    x = np.unique(np.concatenate([first[0], second[0]]))
    x = x[np.r_[True, np.diff(x) > 1e-7]]
    y = 0.5 * (np.interp(x, *first) + np.interp(x, *second))
    x, y = np.r_[x[0] - 1, x, x[-1] + 1], np.r_[y[0], y, y[-1]]
    return PchipInterpolator(x, y)
