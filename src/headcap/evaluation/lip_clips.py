"""Figures of videos without truth, and of the closures of all of them together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from headcap.evaluation.lip_clip import CORRECTED, LipClip
from headcap.evaluation.lip_closures import ClosureTest, chance_of_as_many, chance_of_such_ranks
from headcap.evaluation.lip_errors import BASE
from headcap.evaluation.metrics import Figure, make_figure
from headcap.evaluation.settings import EvaluateSettings

_SETTINGS = EvaluateSettings()


@dataclass(frozen=True)
class ClosureTotal:
    """Closures of all clips together, of one method."""

    method: str
    shown: int
    closures: int
    unseen: int
    """Without an answered frame near."""
    expected: float
    """Shown by chance."""
    chance: float
    """Probability of as many by chance."""
    mean_rank: float
    rank_chance: float
    """Probability of so low a mean rank by chance."""


def clip_figures(clips: Sequence[LipClip]) -> list[Figure]:
    """Figures of each clip by name."""
    out = []
    for clip in clips:
        values = _values(clip)
        out += [make_figure(name, value, session=clip.name, take=None, settings=_SETTINGS) for name, value in values.items()]
    return out


def closure_totals(clips: Sequence[LipClip]) -> list[ClosureTotal]:
    """How many closures each method shows, and how many chance would; empty where none is known."""
    tests = {method: [clip.closure_test(method) for clip in clips if clip.closures] for method in (BASE, CORRECTED)}
    return [_total(method, of_clips) for method, of_clips in tests.items() if of_clips]


def _total(method: str, tests: Sequence[ClosureTest]) -> ClosureTotal:
    ranks, shown, seen = (np.concatenate([getattr(test, name) for test in tests]) for name in ("rank", "shown", "seen"))
    return ClosureTotal(
        method,
        int(shown.sum()),
        len(shown),
        int((~seen).sum()),
        sum(test.expected for test in tests),
        chance_of_as_many(tests),
        float(ranks[seen].mean()) if seen.any() else float("nan"),
        chance_of_such_ranks(ranks),
    )


def _values(clip: LipClip) -> dict[str, float]:
    answered = np.isfinite(clip.residual)
    values = {
        "lips.lost_frames": len(clip.lost),
        "lips.uncorrected_frames": len(clip.uncorrected),
        "lips.photometric_residual": float(np.median(clip.residual[answered])) if answered.any() else float("nan"),
    }
    for name, method in (("base_", BASE), ("", CORRECTED)):
        outer, inner = clip.mean_contour_px(method)
        values |= {f"lips.{name}outer_contour_px": outer, f"lips.{name}inner_contour_px": inner}
        test = clip.closure_test(method)
        if test is not None:
            values |= {
                f"lips.{name}closures_shown_pct": 100 * float(test.shown.mean()),
                f"lips.{name}closures_by_chance_pct": 100 * test.chance,
            }
    return values
