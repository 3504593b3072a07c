"""One picture of a take's synchronisation: sounds aligned at the clap, residuals of all pairs, confidence."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts.files import atomic_path
from headcap.sync.solve import SyncResult

BEFORE_S, AFTER_S = 0.004, 0.016
CONFIDENT = "#00877a"
DOUBTFUL = "#b3261e"


def save_sync_figure(
    path: Path | str, result: SyncResult, audio: Mapping[str, tuple[NDArray, int, float]], *, min_confidence: float = 0.5
) -> None:
    """Draw a PNG: each camera's sound around its clap (arrivals under one another), pair residuals, confidence."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    cameras = result.offsets.cameras
    figure = Figure(figsize=(14, 1.9 + 0.24 * len(cameras)), layout="constrained", dpi=100)
    FigureCanvasAgg(figure)
    waves, pairs, bars = figure.subplots(1, 3, width_ratios=(2.2, 1.7, 1.2))
    _draw_waves(waves, result, audio)
    _draw_residuals(figure, pairs, result)
    _draw_confidence(bars, result, min_confidence)
    figure.suptitle(f"{result.offsets.take}: start times from sound")
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", metadata={"Software": None})


def _draw_waves(axes, result: SyncResult, audio: Mapping) -> None:
    cameras = result.offsets.cameras
    for row, camera in enumerate(cameras):
        if not result.events:
            break
        samples, rate, start_s = audio[camera]
        arrival_s = result.events[0].own_time_s[row]
        first = round((arrival_s - BEFORE_S - start_s) * rate)
        numbers = np.arange(max(first, 0), min(first + round((BEFORE_S + AFTER_S) * rate), len(samples)))
        if len(numbers):
            cut = np.asarray(samples[numbers], float)
            time_ms = 1e3 * (start_s + numbers / rate - arrival_s)
            axes.plot(time_ms, row - 0.45 * cut / max(np.abs(cut).max(), 1e-9), lw=0.6, color="#2166ac")
    axes.axvline(0, color="black", lw=0.8)
    axes.set(yticks=range(len(cameras)), yticklabels=cameras, xlim=(-1e3 * BEFORE_S, 1e3 * AFTER_S))
    axes.set(xlabel="ms after the clap's arrival", title="sound of each camera, aligned at the clap")
    axes.invert_yaxis()


def _draw_residuals(figure, axes, result: SyncResult) -> None:
    cameras = result.offsets.cameras
    axes.set(title="each pair against the start times", xticks=range(len(cameras)), yticks=range(len(cameras)))
    axes.set_xticklabels(cameras, rotation=90, fontsize=7)
    axes.set_yticklabels(cameras, fontsize=7)
    if not result.events:
        axes.text(0.5, 0.5, "all offsets given by hand", ha="center", transform=axes.transAxes)
        return
    residual_us = 1e6 * result.events[0].residual_s
    known = np.abs(residual_us[np.isfinite(residual_us)])
    limit = max(float(np.percentile(known, 95)) if len(known) else 0.0, 1.0)
    image = axes.imshow(residual_us, cmap="RdBu", vmin=-limit, vmax=limit)
    figure.colorbar(image, ax=axes, location="bottom", shrink=0.8, aspect=30, label="microseconds")


def _draw_confidence(axes, result: SyncResult, min_confidence: float) -> None:
    offsets = result.offsets
    rows = np.arange(len(offsets.cameras))
    colours = [CONFIDENT if value >= min_confidence else DOUBTFUL for value in offsets.confidence]
    axes.barh(rows, offsets.confidence, color=colours)
    for row, (start_s, drift, method) in enumerate(zip(offsets.start_s, offsets.drift_ppm, offsets.method, strict=True)):
        text = f"{1e3 * start_s:+.3f} ms" + (f", {drift:+.1f} ppm" if drift else "") + ("" if method == "clap" else f", {method}")
        axes.text(0.03, row, text, va="center", fontsize=8, color="white" if offsets.confidence[row] > 0.6 else "black")
    axes.axvline(min_confidence, color="black", lw=0.8, ls="--")
    axes.set(yticks=rows, yticklabels=offsets.cameras, xlim=(0, 1), title="confidence; start time")
    axes.invert_yaxis()
