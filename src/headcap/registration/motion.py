"""How the mesh moves within a frame: cameras do not fire together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Motion(Protocol):
    """Where a mesh goes within a frame."""

    def offsets(self, delays_s: list[float]) -> list[NDArray[np.float64]]:
        """Motion (n, 3) from the frame to each of the moments `delays_s` later."""

    def fields(self, delay_s: float) -> NDArray[np.float64]:
        """(k, n, 3) what one unit of each of its corrections moves at that moment."""


@dataclass(frozen=True)
class Trajectory:
    """Motion about a frame from the polynomial through its neighbours in the coarse pass.

    A brisk head shake is no parabola within three frames: with two neighbours on either side what is left at half a frame is a
    fifth difference times 0.01, and noise of the coarse pass enters with weights below one.
    """

    time_s: NDArray[np.float64]
    """(k,) frames, rising."""
    positions: NDArray[np.float64]
    """(k, n, 3) metres."""
    index: int
    """Which of them is the frame."""

    def offsets(self, delays_s: list[float]) -> list[NDArray[np.float64]]:
        """Motion (n, 3) from the frame to each of the moments `delays_s` later."""
        return [self._offset(delay_s) for delay_s in delays_s]

    def fields(self, delay_s: float) -> NDArray[np.float64]:
        """(3, n, 3) corrections: more velocity, velocity along the acceleration, more acceleration."""
        step_s = float(np.median(np.diff(self.time_s))) if len(self.time_s) > 1 else 1.0
        ahead, behind = self._offset(0.5 * step_s), self._offset(-0.5 * step_s)
        velocity, acceleration = ahead - behind, 4 * (ahead + behind)
        share = delay_s / step_s
        return np.stack([share * velocity, share * acceleration, share**2 * acceleration])

    def _offset(self, delay_s: float) -> NDArray[np.float64]:
        weights = _lagrange(self.time_s, self.time_s[self.index] + delay_s)
        weights[self.index] -= 1.0
        return np.tensordot(weights, self.positions, axes=1)


def _lagrange(nodes: NDArray, x: float) -> NDArray[np.float64]:
    """Weights (k,) of values at distinct nodes (k,) that give the interpolating polynomial at x."""
    apart = nodes[:, None] - nodes + np.eye(len(nodes))
    factors = np.where(np.eye(len(nodes), dtype=bool), 1.0, (x - nodes) / apart)
    return factors.prod(axis=1)
