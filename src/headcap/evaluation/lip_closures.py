"""Whether lips shut when b, p and m are said: minima of the lip gap at known moments, against moments at random.

What shuts and opens with every syllable has minima everywhere, so the share of moments that would pass by chance is measured on
the same curve, over the time in which the person speaks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

WITHIN_S = 0.08
"""How far a minimum may lie from the middle of its closure: two pictures at 25 Hz. Aligners place words within one or two."""
BASIN_S = 0.12
"""A minimum is the least within so much on either side; the shortest syllables last twice that."""
SHUT_SHARE = 0.25
"""A minimum is shut where the gap is in this lowest part of the range that it has while the person speaks. Not a quantile: of
somebody who says no b, p or m a quarter of all frames would count as shut."""
_RANGE = (0.05, 0.95)
"""Quantiles that tell the range: single frames may be wrong."""
_GRID_S = 0.004
_EXACT = 16
"""Beyond so many ranks the exact sum loses digits, and the normal distribution is as good."""


@dataclass(frozen=True, eq=False)
class ClosureTest:
    """One curve of the lip gap at k closures of a clip."""

    time_s: NDArray[np.float64]
    """(k,) middle of each closure."""
    seen: NDArray[np.bool_]
    """(k,) closures with an answered frame near."""
    shown: NDArray[np.bool_]
    """(k,) closures with a shut minimum near."""
    least: NDArray[np.float64]
    """(k,) least gap near each, in the curve's unit; NaN where none was seen."""
    rank: NDArray[np.float64]
    """(k,) share of spoken moments with a smaller least gap near, ties half: 0 the most shut, 0.5 by chance."""
    chance: float
    """Share of spoken moments that have a shut minimum near."""

    @property
    def expected(self) -> float:
        """How many closures would be shown if they lay anywhere in the speech."""
        return self.chance * len(self.shown)


def gap_minima(time_s: ArrayLike, gap: ArrayLike) -> NDArray[np.int64]:
    """Frames (m,) whose gap (f,) is the least within `BASIN_S` on either side, with wider ones on both; the first of equals.

    Frames without an answer (NaN) are none and are passed over.
    """
    time_s, gap = np.asarray(time_s, float), np.asarray(gap, float)
    found = []
    for frame in np.flatnonzero(np.isfinite(gap)):
        near = np.abs(time_s - time_s[frame]) <= BASIN_S + 1e-9
        before, after = gap[near & (time_s < time_s[frame])], gap[near & (time_s > time_s[frame])]
        least = np.nanmin(gap[near])
        falls = np.isfinite(before).any() and np.nanmax(before) > gap[frame] and not (before <= gap[frame]).any()
        rises = np.isfinite(after).any() and np.nanmax(after) > gap[frame]
        if gap[frame] <= least and falls and rises:
            found.append(frame)
    return np.array(found, np.int64)


def shut_below(time_s: ArrayLike, gap: ArrayLike, spoken_s: tuple[float, float]) -> float:
    """The gap up to which lips count as shut, see `SHUT_SHARE`; NaN where no frame was answered while speaking."""
    time_s, gap = np.asarray(time_s, float), np.asarray(gap, float)
    said = gap[(time_s >= spoken_s[0]) & (time_s <= spoken_s[1]) & np.isfinite(gap)]
    if not len(said):
        return float("nan")
    low, high = np.quantile(said, _RANGE)
    return float(low + SHUT_SHARE * (high - low))


def check_closures(time_s: ArrayLike, gap: ArrayLike, closures_s: ArrayLike, spoken_s: tuple[float, float]) -> ClosureTest:
    """A gap (f,) at `time_s` (f,) held against moments (k,) at which lips shut, in speech from `spoken_s[0]` to `spoken_s[1]`.

    A closure is shown where `gap_minima` has a frame within `WITHIN_S` that is shut (`shut_below`). Frames without an answer
    (NaN) show nothing.
    """
    time_s, gap, moments = (np.asarray(values, float) for values in (time_s, gap, closures_s))
    minima = gap_minima(time_s, gap)
    shut = time_s[minima[gap[minima] <= shut_below(time_s, gap, spoken_s)]]
    grid = np.arange(spoken_s[0], spoken_s[1], _GRID_S)
    least, anywhere = _least(time_s, gap, moments), _least(time_s, gap, grid)
    known = anywhere[np.isfinite(anywhere)]
    below = (known < least[:, None]).sum(axis=1) + 0.5 * (known == least[:, None]).sum(axis=1)
    rank = np.where(np.isfinite(least), below / max(len(known), 1), np.nan)
    chance = float(_near(grid, shut).mean()) if len(grid) else 0.0
    return ClosureTest(moments, np.isfinite(least), _near(moments, shut), least, rank, chance)


def chance_of_as_many(tests: Sequence[ClosureTest]) -> float:
    """Probability that closures at random would show as many minima as these did, each by its own clip's chance.

    The upper tail of the Poisson binomial distribution: with ten closures in all a handful of lucky ones proves nothing.
    """
    counts = np.ones(1)
    for test in tests:
        for _ in test.shown:
            counts = np.convolve(counts, [1 - test.chance, test.chance])
    shown = sum(int(test.shown.sum()) for test in tests)
    return float(min(counts[shown:].sum(), 1.0))


def chance_of_such_ranks(ranks: ArrayLike) -> float:
    """Probability that as many moments at random have a mean rank (k,) so low: the distribution of a mean of uniform numbers.

    Irwin & Hall's formula; NaN, closures without a frame near, are left out. 1 without any.
    """
    known = np.asarray(ranks, float)
    known = known[np.isfinite(known)]
    count, total = len(known), float(known.sum())
    if count > _EXACT:
        return float(ndtr((total - count / 2) / np.sqrt(count / 12)))
    terms = [(-1) ** k * math.comb(count, k) * (total - k) ** count for k in range(math.floor(total) + 1)]
    return float(np.clip(math.fsum(terms) / math.factorial(count), 0.0, 1.0))


def _near(moments: NDArray, others: NDArray) -> NDArray[np.bool_]:
    """(k,) moments with another within `WITHIN_S`."""
    return (np.abs(moments[:, None] - others) <= WITHIN_S + 1e-9).any(axis=1)


def _least(time_s: NDArray, gap: NDArray, moments: NDArray) -> NDArray[np.float64]:
    """(k,) least gap within `WITHIN_S` of each moment; NaN where no frame was answered."""
    near = np.abs(moments[:, None] - time_s) <= WITHIN_S + 1e-9
    least = np.where(near & np.isfinite(gap), gap, np.inf).min(axis=1, initial=np.inf)
    return np.where(np.isfinite(least), least, np.nan)
