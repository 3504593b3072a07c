"""Diagrams of a study's neck model: the paper's figures 7, 8 and 9. Each returns an RGB image (height, width, 3) uint8."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from headcap.evaluation.neck_study import PAPER_ERROR_DROPS, NeckStudy
from headcap.neck.animation.curves import CoefficientCurves
from headcap.neck.fits import TakeFit
from headcap.report.figures import ACCENT, FAINT, INK, SECOND, WARNING, Image, sheet

NEUTRAL_SHARE, NEUTRAL_SECONDS = 0.35, 0.12
"""A face is near neutral where jaw and expression stay below this share of their 95th percentiles, for so long at least."""
_SHOWN_WEIGHTS = 3
_WEIGHT_COLOURS = (ACCENT, SECOND, "#3b5bdb")


def fitting_errors(takes: list[tuple[str, TakeFit]]) -> Image:
    """Figure 7: mean error of the neck over the frames of speech takes, the head model before training against the whole."""
    with sheet(8.2, 0.5 + 1.7 * len(takes)) as (figure, out):
        for axes, (title, take) in zip(figure.subplots(len(takes), 1, squeeze=False)[:, 0], takes, strict=True):
            frames = np.arange(len(take.time_s))
            for stage, colour, told in (
                ("base", SECOND, "before training"),
                ("expression", FAINT, "without speech parts"),
                ("full", ACCENT, "whole model"),
            ):
                if stage in take.errors_mm:
                    error = take.errors_mm[stage]
                    axes.plot(frames, error, color=colour, label=f"{told}: {np.nanmean(error):.3f} mm")
            axes.set(title=title, ylabel="mm", ylim=(0, None), xlim=(0, max(1, len(frames) - 1)))
            axes.set(ylim=(0, 1.3 * axes.get_ylim()[1]))
            axes.legend(ncols=3, loc="upper right")
        axes.set(xlabel="frame")
    return out[0]


def speech_weights(title: str, take: TakeFit) -> Image:
    """Figure 8: the first three weights of the speech blendshapes over time, near-neutral stretches marked."""
    time_s, phi = take.time_s - take.time_s[0], 1e3 * take.speech.phi
    with sheet(8.2, 2.1) as (figure, out):
        axes = figure.subplots()
        for k, (first, end) in enumerate(near_neutral(take)):
            label = "near-neutral face" if k == 0 else None
            axes.axvspan(time_s[first], time_s[end - 1], color="#f6e3b4", linewidth=0, label=label)
        for k in range(min(_SHOWN_WEIGHTS, phi.shape[1])):
            axes.plot(time_s, phi[:, k], color=_WEIGHT_COLOURS[k], label=f"phi {k + 1}")
        axes.set(title=title, xlabel="s", ylabel="mm", xlim=(0, time_s[-1]))
        axes.set(ylim=(axes.get_ylim()[0], axes.get_ylim()[0] + 1.25 * np.diff(axes.get_ylim())[0]))
        axes.legend(ncols=4, loc="upper right")
    return out[0]


def near_neutral(take: TakeFit) -> list[tuple[int, int]]:
    """Stretches (first, end) of frames in which the face is near neutral, see `NEUTRAL_SHARE`; a lost frame ends a stretch.

    The paper does not say when it counts an expression as nearly neutral. Jaw and expression are compared with their own 95th
    percentiles in the take, so that a person who moves little has pauses too.
    """
    quiet = np.isfinite(take.placement).all(axis=(1, 2))
    for moved in (np.linalg.norm(take.psi, axis=1), np.linalg.norm(take.theta[:, 1], axis=1)):
        reach = np.nanpercentile(moved, 95) if quiet.any() else 0.0
        quiet = quiet & ~(moved > NEUTRAL_SHARE * reach)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], quiet, [False]]).astype(int)))
    step_s = float(np.median(np.diff(take.time_s))) if len(take.time_s) > 1 else 0.0
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2) if (b - a) * step_s >= NEUTRAL_SECONDS]


def weights_when_neutral(take: TakeFit) -> tuple[float, float] | None:
    """Mean length of phi, mm, in near-neutral stretches and elsewhere; None where a take has only one of the two."""
    inside = np.zeros(len(take.time_s), bool)
    for first, end in near_neutral(take):
        inside[first:end] = True
    length, known = 1e3 * np.linalg.norm(take.speech.phi, axis=1), take.speech.known
    if not (inside & known).any() or not (~inside & known).any():
        return None
    return float(length[inside & known].mean()), float(length[~inside & known].mean())


def slide_and_scale_curves(parts: list[tuple[str, CoefficientCurves]]) -> Image:
    """Figure 9: tau (up, mm) and alpha over the frames of each part."""
    with sheet(8.2, 0.4 + 1.6 * len(parts)) as (figure, out):
        for axes, (title, curves) in zip(figure.subplots(len(parts), 1, squeeze=False)[:, 0], parts, strict=True):
            tau, alpha = 1e3 * curves.curve("tau"), curves.curve("alpha")
            axes.plot(curves.time_s, tau, color=ACCENT)
            axes.set(title=f"{title}{_together(tau, alpha)}", xlim=(0, max(curves.time_s[-1], 1e-3)))
            axes.set_ylabel("tau, mm up", color=ACCENT)
            other = axes.twinx()
            other.plot(curves.time_s, alpha, color=SECOND)
            other.set_ylabel("alpha", color=SECOND)
            other.grid(visible=False)
        axes.set(xlabel="s")
    return out[0]


def _together(tau: NDArray, alpha: NDArray) -> str:
    """How slide and scale go together, for a title."""
    if min(np.std(tau), np.std(alpha)) < 1e-9:
        return ""
    return f"; correlation of tau and alpha {np.corrcoef(tau, alpha)[0, 1]:+.2f}"


def error_drops_diagram(study: NeckStudy) -> Image:
    """Table 1 as bars: held-out subjects, then the paper's."""
    rows = [row for row in study.drops if row.held_out] + list(PAPER_ERROR_DROPS)
    with sheet(8.2, 0.9 + 0.19 * len(rows)) as (figure, out):
        panels = figure.subplots(1, 3, sharey=True)
        for axes, stage in zip(panels, ("pose", "expression", "speech"), strict=True):
            values = [getattr(row, f"{stage}_mm") for row in rows]
            colours = [
                FAINT if row in PAPER_ERROR_DROPS else WARNING if (v or 0) < 0 else ACCENT
                for row, v in zip(rows, values, strict=True)
            ]
            axes.barh(range(len(rows)), [v or 0.0 for v in values], 0.62, color=colours)
            axes.axvline(0, color=INK, linewidth=0.8)
            axes.set(title=f"{stage} fitting", xlabel="error drop, mm")
            axes.grid(axis="y", visible=False)
        panels[0].set(yticks=range(len(rows)), yticklabels=[row.subject for row in rows])
        panels[0].invert_yaxis()
    return out[0]
