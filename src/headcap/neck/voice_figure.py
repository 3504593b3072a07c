"""One picture of a trained voice: each take's coefficients as fitted and as heard, frames predicted without having been seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from headcap.artifacts import atomic_path
from headcap.neck.figure import SHOWN_WEIGHTS
from headcap.neck.voice_training import TakePrediction, VoiceTraining

_FITTED, _HEARD = "0.55", "#00877a"


def save_voice_figure(path: Path | str, training: VoiceTraining) -> None:
    """Draw a PNG: per take a row with tau, alpha and the first weights of phi, fitted beside predicted."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    takes = training.predictions
    figure = Figure(figsize=(14, 1.0 + 2.4 * len(takes)), layout="constrained", dpi=100)
    FigureCanvasAgg(figure)
    columns = 2 + min(SHOWN_WEIGHTS, takes[0].fitted.phi.shape[1])
    for row, take in zip(figure.subplots(len(takes), columns, squeeze=False), takes, strict=True):
        _draw_take(row, take)
    told = ["grey: fitted, green: predicted from sound by regressors that left the frame's take or stretch out"]
    figure.suptitle("\n".join([*told, *training.remarks()]), fontsize=10)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})


def _draw_take(row, take: TakePrediction) -> None:
    shown = [
        ("slide tau, mm up", 1e3 * take.fitted.tau, 1e3 * take.predicted.tau),
        ("scale alpha", take.fitted.alpha, take.predicted.alpha),
    ]
    shown += [(f"phi {k}, mm", 1e3 * take.fitted.phi[:, k], 1e3 * take.predicted.phi[:, k]) for k in range(len(row) - 2)]
    time_s = take.time_s - take.time_s[0]
    for axes, (title, fitted, predicted) in zip(row, shown, strict=True):
        axes.plot(time_s, fitted, color=_FITTED, lw=1.2)
        axes.plot(time_s, predicted, color=_HEARD, lw=1.2)
        if np.isfinite(fitted).any():
            axes.axhline(np.nanmean(fitted), color="0.85", lw=0.8, zorder=0)
        axes.set_title(f"{take.take}: {title}", fontsize=9)
        axes.set_xlabel("s")
