"""The larynx: a rigid body that slides under the skin; skin is lifted where the body is, it does not travel along."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.synthetic.anatomy import Places

_SOFTNESS_M = 0.0012
"""Skin and fat round off the body's edges over this height."""
_REACH_M = 0.055
_RIDGE_SLOPE, _RIDGE_RADIUS_M = 0.55, 0.003
_TOP_RADIUS_M, _BOTTOM_RADIUS_M = 0.009, 0.024
_CRICOID_BELOW_M, _CRICOID_SHARE, _CRICOID_RADIUS_M = 0.022, 0.35, 0.009


@dataclass(frozen=True)
class Larynx:
    """The body and the skin above it."""

    prominence_m: float
    vertices: NDArray[np.int64]
    """Skin vertices in reach (k,)."""
    across_m: NDArray[np.float64]
    """(k,) sideways from the body's midline."""
    along_m: NDArray[np.float64]
    """(k,) up along the throat from the body's resting place."""
    outward: NDArray[np.float64]
    """(3,) the way the body lifts the skin."""
    upward: NDArray[np.float64]
    """(3,) the way it slides."""

    def lift(self, slide_m: float, size: float) -> NDArray[np.float64]:
        """Displacement (k, 3) of the skin with the body `slide_m` above its rest, scaled by `size`.

        The skin comes to lie on a smooth maximum of its own height and the body's: softplus(height / softness).
        """
        height = self._height((self.across_m) / size, (self.along_m - slide_m) / size) * size
        return np.logaddexp(0, height / _SOFTNESS_M)[:, None] * _SOFTNESS_M * self.outward

    def _height(self, across: NDArray, along: NDArray) -> NDArray:
        """Height (k,) of the body over the bare skin: a ridged shield and a ring below it."""
        ridge = _RIDGE_SLOPE * (np.sqrt(across**2 + _RIDGE_RADIUS_M**2) - _RIDGE_RADIUS_M)
        bend = along**2 / (2 * np.where(along > 0, _TOP_RADIUS_M, _BOTTOM_RADIUS_M))
        shield = self.prominence_m - ridge - bend
        lower = along + _CRICOID_BELOW_M
        ring = _CRICOID_SHARE * self.prominence_m - 0.7 * ridge - lower**2 / (2 * _CRICOID_RADIUS_M)
        return np.maximum(shield, ring)


def build_larynx(vertices_m: NDArray, skin: NDArray, places: Places, prominence_m: float) -> Larynx:
    """The larynx of a resting subject whose throat is bare of any bump; `skin` (n,) masks the outer skin."""
    outward, upward = throat_frame(vertices_m, places)
    offset = vertices_m - places.larynx
    in_reach = skin & (np.abs(offset[:, 0]) < _REACH_M) & (np.abs(offset @ upward) < _REACH_M) & (offset @ outward > -0.04)
    chosen = np.flatnonzero(in_reach)
    return Larynx(prominence_m, chosen, offset[chosen, 0], offset[chosen] @ upward, outward, upward)


def throat_frame(vertices_m: NDArray, places: Places) -> tuple[NDArray, NDArray]:
    """Outward and upward unit vectors (3,) of the throat about the larynx."""
    offset = vertices_m - places.larynx
    near = (np.abs(offset[:, 0]) < 0.006) & (np.abs(offset[:, 1]) < 0.03) & (np.abs(offset[:, 2]) < 0.03)
    slope = np.polyfit(offset[near, 1], offset[near, 2], 1)[0]
    upward = np.array([0.0, 1.0, slope]) / np.hypot(1, slope)
    return np.array([0.0, -upward[2], upward[1]]), upward
