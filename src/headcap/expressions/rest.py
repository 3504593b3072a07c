"""Whether the neutral face that displacements are measured from is one: v^0 of the quasi-eigen paper, section 3, is given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.expressions.performance import Performance
from headcap.geometry.transforms import fit_similarity, rotation_angle

FAR = 2.0
"""Nearest frame over the spread of all frames beyond which a neutral face is refused: the offset then is what is captured."""
_UNIT = 10.0
"""Ratio of sizes that is no person's but another unit's."""
_RIGID = 0.9
"""Share of an offset's squares that a rigid motion must explain to be called one."""


@dataclass(frozen=True)
class RestOffset:
    """How a neutral face lies to the frame of a performance that comes nearest to it."""

    source: str
    frame: int
    """The nearest frame."""
    nearest_mm: float
    """Root mean square over points of its displacement: no frame comes nearer."""
    spread_mm: float
    """The same of all frames about their mean: what the performance moves."""
    largest_mm: float
    where: str
    """Region with the largest root mean square of that frame's displacement; else the point with the largest displacement."""
    scale: float
    """Size of the nearest frame over that of the neutral face."""
    shift_mm: float
    turn_deg: float
    """Rigid motion of the neutral face to that frame: of its centroid, and about it."""
    rigid_share: float
    """Share of the squares of the displacement that rigid motion and size explain."""

    @property
    def ratio(self) -> float:
        """Nearest over spread: near 0 where some frame is at rest."""
        return self.nearest_mm / self.spread_mm if self.spread_mm > 0 else np.inf

    def require(self, most: float = FAR) -> None:
        """Raises `InputError`, naming the offset, where no frame comes within `most` spreads of the neutral face.

        In performances of speech, of expressions and of poses of the neck with a true neutral face, half of all frames lay within
        0.4 to 1.3 spreads of it and the nearest at it: a take cut free of all rest would still pass 2. A neutral face that is
        itself within what the person does, an open mouth of one who speaks, is an expression as good as another: nothing in the
        performance tells it from rest.
        """
        if self.ratio <= most:
            return
        nearest = f"{self.source}: no frame comes nearer to the neutral face than {self.nearest_mm:.3g} mm (frame {self.frame})"
        raise InputError(
            f"{nearest}, while all frames lie {self.spread_mm:.3g} mm about their mean; {self._kind}; at most "
            f"{self.largest_mm:.3g} mm, {self.where}",
            expected=f"a frame within {most:g} times that spread",
            remedy="Give the resting face of the same person in the units and the place of the frames.",
        )

    @property
    def _kind(self) -> str:
        if not 1 / _UNIT < self.scale < _UNIT:
            return f"frames are {self.scale:.3g} times the size of the neutral face: other units?"
        if self.rigid_share > _RIGID:
            return f"the neutral face is placed elsewhere: moved by {self.shift_mm:.3g} mm, turned by {self.turn_deg:.3g} degrees"
        return "the neutral face has another shape"


def offset_of_rest(performance: Performance) -> RestOffset:
    """How far the neutral face is from the frame that comes nearest to it, of what kind the offset is and where; in one pass."""
    total, squares, first = np.zeros(performance.columns), 0.0, 0
    nearest, least, number = None, np.inf, 0
    for rows in performance.rows():
        energy = np.einsum("fc,fc->f", rows, rows, dtype=np.float64)
        total += rows.sum(axis=0, dtype=np.float64)
        squares += float(energy.sum())
        if energy.min() < least:
            at = int(energy.argmin())
            least, number, nearest = float(energy[at]), first + at, rows[at].astype(np.float64)
        first += len(rows)
    if nearest is None:
        raise InputError(
            f"{performance.source}: no frame is finite", expected="finite coordinates", remedy="Repair the performance."
        )
    points = len(performance.neutral)
    spread = np.sqrt(max(squares / first - float(np.square(total / first).sum()), 0.0) / points)
    return _described(performance, nearest.reshape(-1, 3), number, spread)


def _described(performance: Performance, offset: NDArray, frame: int, spread: float) -> RestOffset:
    neutral = performance.neutral.astype(np.float64)
    length = np.linalg.norm(offset, axis=1)
    move, fitted, scale = _similarity(neutral, neutral + offset)
    left = float(np.square(neutral + offset - fitted).sum())
    whole = float(np.square(offset).sum())
    return RestOffset(
        source=performance.source,
        frame=frame,
        nearest_mm=1e3 * float(np.sqrt((length**2).mean())),
        spread_mm=1e3 * float(spread),
        largest_mm=1e3 * float(length.max()),
        where=_where(performance, length),
        scale=scale,
        shift_mm=1e3 * float(np.linalg.norm((fitted - neutral).mean(axis=0))),
        turn_deg=float(np.degrees(rotation_angle(move[:3, :3]))),
        rigid_share=1.0 - left / whole if whole > 0 else 0.0,
    )


def _similarity(source: NDArray, target: NDArray) -> tuple[NDArray, NDArray, float]:
    move, scale = fit_similarity(source, target)
    return move, scale * source @ move[:3, :3].T + move[:3, 3], float(scale)


def _where(performance: Performance, length: NDArray) -> str:
    if performance.regions:
        rms = {name: float(np.sqrt((length[mask] ** 2).mean())) for name, mask in performance.regions.items() if mask.any()}
        if rms:
            return f"most in region {max(rms, key=rms.get)}"
    point = int(length.argmax())
    return f"at marker {performance.points[point]}" if performance.points else f"at vertex {point}"
