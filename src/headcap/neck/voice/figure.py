"""One picture of a trained voice: each take's coefficients as fitted and as heard, frames predicted without having been seen."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import atomic_path
from headcap.neck.figure import SHOWN_WEIGHTS
from headcap.neck.voice.training import TakePrediction, VoiceTraining

MOST_ROWS = 10
"""Takes drawn in a picture."""
_FITTED, _HEARD = "0.55", "#00877a"
_ONE = {"people": "person", "takes": "take", "stretches": "stretch"}


def save_voice_figure(path: Path | str, training: VoiceTraining) -> None:
    """Draw a PNG: per take a row with tau, alpha and the first weights of phi, fitted beside predicted."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    takes = _drawn(training.predictions)
    figure = Figure(figsize=(14, 1.0 + 2.4 * len(takes)), layout="constrained", dpi=100)
    FigureCanvasAgg(figure)
    columns = len(_shown(takes[0]))
    for row, take in zip(figure.subplots(len(takes), columns, squeeze=False), takes, strict=True):
        _draw_take(row, take)
    told = [f"grey: fitted, green: predicted from sound by regressors that left the frame's {_ONE[training.errors.left_out]} out"]
    figure.suptitle("\n".join([*told, *training.errors.remarks]), fontsize=10)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})


def _drawn(takes: Sequence[TakePrediction]) -> Sequence[TakePrediction]:
    """All takes, or the first of each person where they are too many for a picture."""
    if len(takes) <= MOST_ROWS:
        return takes
    return list({take.person: take for take in reversed(takes)}.values())[::-1][:MOST_ROWS]


def _draw_take(row, take: TakePrediction) -> None:
    time_s = take.time_s - take.time_s[0]
    for axes, (title, fitted, predicted) in zip(row, _shown(take), strict=True):
        axes.plot(time_s, fitted, color=_FITTED, lw=1.2)
        axes.plot(time_s, predicted, color=_HEARD, lw=1.2)
        if np.isfinite(fitted).any():
            axes.axhline(np.nanmean(fitted), color="0.85", lw=0.8, zorder=0)
        axes.set_title(f"{take.person}, {take.take}: {title}", fontsize=9)
        axes.set_xlabel("s")


def _shown(take: TakePrediction) -> list[tuple[str, NDArray, NDArray]]:
    """Title, fitted and predicted (f,) of what is drawn: tau and alpha where there are any, and the first weights."""
    shown, (fitted, predicted) = [], (take.fitted, take.predicted)
    if fitted.tau is not None and predicted.tau is not None:
        shown.append(("slide tau, mm up", 1e3 * fitted.tau, 1e3 * predicted.tau))
        shown.append(("scale alpha", fitted.alpha, predicted.alpha))
    weights = range(min(SHOWN_WEIGHTS, fitted.phi.shape[1]))
    return shown + [(f"phi {k}, mm", 1e3 * fitted.phi[:, k], 1e3 * predicted.phi[:, k]) for k in weights]
