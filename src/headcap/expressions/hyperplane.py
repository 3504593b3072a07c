"""How many principal axes hand-made shapes are projected onto (quasi-eigen paper, section 4: n >= m).

The paper has as many shapes as axes. Onto fewer axes than shapes can span, projections lose what they might reproduce. Onto as
many, some projections may be nearly dependent (left and right always performed together, shapes nobody performed), and then a
direction is lost whose share of the motion may be large. The best number is found without the frames: axes, their variances and
the mean tell what is left. ICT-FaceKit's 53 shapes, sculpted five times, on a rig's takes with and without speech: 1.02 times the
error of 53 eigenfaces at most.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.expressions.basis import LEAST_OFFSET, Eigenfaces, ExpressionBasis

REACHED = 1e-4
"""Directions that unit shapes reach by less than this share of what they reach most are out of reach for single precision."""


def spanning_axes(hand: ExpressionBasis, eigen: Eigenfaces) -> Eigenfaces:
    """The first principal axes and the direction to the neutral face onto which projected shapes reproduce most (eq. 3 to 6).

    See `Eigenfaces.through_neutral` for the direction, `unreached` for what is counted.
    """
    return eigen.through_neutral(1 + int(np.argmin(unreached(hand, eigen))))


def unreached(hand: ExpressionBasis, eigen: Eigenfaces) -> NDArray[np.float64]:
    """(c,) mean square over frames, square metres, of what shapes projected onto 1 to c axes leave of the displacements.

    c is one fewer than there are shapes, or all axes; each time the direction to the neutral face is another axis.
    """
    shapes, axes = hand.rows.astype(np.float64), eigen.rows.astype(np.float64)
    most = max(min(len(hand) - 1, len(eigen)), 1)
    mean = eigen.mean.ravel().astype(np.float64)
    along_mean = axes @ mean
    offsets = mean - np.cumsum(along_mean[:most, None] * axes[:most], axis=0)
    seen = _Coordinates(
        shapes @ axes.T, shapes @ offsets.T, along_mean, np.linalg.norm(offsets, axis=1), eigen.variances, np.linalg.norm(mean)
    )
    everything = eigen.total_variance + float(mean @ mean)
    return np.array([everything - seen.reached(count) for count in range(1, most + 1)])


@dataclass(frozen=True, eq=False)
class _Coordinates:
    """k shapes and the mean along m axes and along what the first 1 to c axes leave of the mean."""

    shapes: NDArray[np.float64]
    """(k, m)"""
    shapes_along_offsets: NDArray[np.float64]
    """(k, c), not yet divided by the offsets' lengths."""
    mean: NDArray[np.float64]
    """(m,)"""
    offsets: NDArray[np.float64]
    """(c,) lengths."""
    variances: NDArray[np.float64]
    mean_length: float

    def reached(self, count: int) -> float:
        """Mean square of the displacements' part in the span of the shapes on `count` axes and the direction to the neutral."""
        along, mean, variances = self.shapes[:, :count], self.mean[:count], self.variances[:count]
        offset = self.offsets[count - 1]
        if offset > LEAST_OFFSET * self.mean_length:
            along = np.column_stack([along, self.shapes_along_offsets[:, count - 1] / offset])
            # axes left out meet the offset where the mean meets them
            beyond = float(np.square(self.mean[count:] / offset) @ self.variances[count:])
            mean, variances = np.append(mean, offset), np.append(variances, beyond)
        span = _span(along)
        return float((np.square(span) @ variances).sum() + np.square(span @ mean).sum())


def _span(rows: NDArray) -> NDArray[np.float64]:
    """(r, m) orthonormal directions that unit rows (k, m) reach."""
    unit = rows / np.maximum(np.linalg.norm(rows, axis=1), np.finfo(np.float64).tiny)[:, None]
    values, turn = np.linalg.eigh(unit.T @ unit)
    return turn[:, values > REACHED**2 * values.max(initial=0.0)].T
