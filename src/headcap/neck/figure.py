"""Pictures of a neck model: the training's energy by step, and a person's coefficients and errors over time."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from headcap.artifacts import atomic_path
from headcap.neck.fits import NeckFits, TakeFit
from headcap.neck.training.speech import SpeechTraining

SHOWN_WEIGHTS = 3
"""Blendshape weights drawn, as in the paper's figure 8."""


def save_training_figure(path: Path | str, training: SpeechTraining) -> None:
    """Draw a PNG: the energy after each step of Algorithm 1."""
    figure, rows = _figure(1)
    _draw_energy(rows[0], training)
    _save(figure, path)


def save_fits_figure(path: Path | str, fits: NeckFits) -> None:
    """Draw a PNG: per take a row with tau, alpha, weights and errors (figures 7, 8, 9)."""
    figure, rows = _figure(len(fits.takes))
    for axes, take in zip(rows, fits.takes, strict=True):
        _draw_take(axes, take)
    _save(figure, path)


def _figure(rows: int):
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 2.6 * rows), layout="constrained", dpi=100)
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, 1, squeeze=False)[:, 0]


def _save(figure, path: Path | str) -> None:
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})


def _draw_energy(axes, training: SpeechTraining) -> None:
    steps, energy = zip(*training.energy, strict=True)
    axes.semilogy(np.arange(len(energy)), energy, color="0.7", lw=1)
    for name, colour in (("larynx coefficients", "#00877a"), ("larynx model", "#b3261e"), ("speech blendshapes", "#3b5bdb")):
        chosen = [k for k, step in enumerate(steps) if step == name]
        axes.semilogy(chosen, [energy[k] for k in chosen], "o", ms=4, color=colour, label=name)
    axes.set_title("energy after each step of the training, square metres")
    axes.legend(frameon=False, fontsize=8)


def _draw_take(axes, take: TakeFit) -> None:
    time_s = take.time_s - take.time_s[0]
    axes.plot(time_s, 1e3 * take.speech.tau_m, color="#00877a", label="slide tau, mm up")
    axes.plot(time_s, take.base_error_mm, color="0.6", label="neck error without speech parts, mm")
    axes.plot(time_s, take.error_mm, color="#b3261e", label="with them, mm")
    for k in range(min(SHOWN_WEIGHTS, take.speech.phi.shape[1])):
        weights = take.speech.phi[:, k]
        axes.plot(time_s, weights / max(np.nanmax(np.abs(weights)), 1e-12), lw=0.6, color="#3b5bdb", alpha=0.9 - 0.25 * k)
    scale = axes.twinx()
    scale.plot(time_s, take.speech.alpha, color="#e8890c", lw=1)
    scale.set_ylabel("scale alpha", color="#e8890c")
    axes.set_title(f"{take.take}; thin: first blendshape weights, each by its largest")
    axes.set_xlabel("s")
    axes.legend(frameon=False, fontsize=8, loc="upper left", ncols=3)
