"""What a handful of labelled frames does for a contour detector, told on frames that it did not learn from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from headcap.lips.contours.finder import ContourFinder
from headcap.lips.contours.search import resample_ring
from headcap.lips.contours.training import LipExample, adapt_detector
from headcap.lips.features import LipContours

_STEP_PX = 0.1


@dataclass(frozen=True, eq=False)
class Agreement:
    """How a finder's contours lie beside labels of k frames."""

    outer_px: NDArray[np.float64]
    """(k,) mean distance of the labels' points from the contour found; NaN where none was."""
    inner_px: NDArray[np.float64]

    @property
    def found(self) -> NDArray[np.bool_]:
        """(k,) frames in which contours were found."""
        return np.isfinite(self.outer_px)

    def __str__(self) -> str:
        """In words: found frames, medians of their distances."""
        told = f"found in {int(self.found.sum())} of {len(self.found)}"
        if not self.found.any():
            return told
        outer, inner = (float(np.nanmedian(values)) for values in (self.outer_px, self.inner_px))
        return f"{told}, outer {outer:.2f} px and inner {inner:.2f} px from the labels (medians)"


def agreement(finder: ContourFinder, examples: Sequence[LipExample]) -> Agreement:
    """What a finder makes of labelled pictures."""
    gaps = [contour_gaps_px(found_in(finder, example), example.contours) for example in examples]
    outer, inner = np.array(gaps, float).reshape(-1, 2).T
    return Agreement(outer, inner)


def held_out_agreement(finder: ContourFinder, examples: Sequence[LipExample]) -> Agreement | None:
    """The same of each half of the examples by a detector that was adapted to the other half (two-fold cross-validation).

    Every second example belongs to one half; a single one has no other, and there is no answer (None).
    """
    if len(examples) < 2:
        return None
    outer, inner = np.empty((2, len(examples)))
    for half in range(2):
        adapted = replace(finder, detector=adapt_detector(finder.detector, examples[1 - half :: 2]))
        told = agreement(adapted, examples[half::2])
        outer[half::2], inner[half::2] = told.outer_px, told.inner_px
    return Agreement(outer, inner)


def found_in(finder: ContourFinder, example: LipExample) -> LipContours | None:
    """A finder's contours in an example's picture."""
    maps = finder.detector.maps(finder.detector.window(example.picture, example.view), finder.settings)
    return finder.contours_in(maps, example.view).contours


def contour_gaps_px(found: LipContours | None, labels: LipContours) -> tuple[float, float]:
    """Mean distance of the labels' outer and inner points from what was found, pixels; NaN where nothing was."""
    if found is None:
        return float("nan"), float("nan")
    outer, inner = ((getattr(found, name), getattr(labels, name)) for name in ("outer", "inner"))
    return _gap(*outer), _gap(*inner)


def _gap(ring: NDArray, points: NDArray) -> float:
    length = np.linalg.norm(np.diff(ring, axis=0, append=ring[:1]), axis=1).sum()
    dense = resample_ring(ring, 2 * int(np.ceil(length / _STEP_PX / 2) + 1), len(ring) // 2)
    return float(cKDTree(dense).query(points)[0].mean())
