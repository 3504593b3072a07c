"""Diagrams of a study's lips: the lip paper's tables as bars, and curves over time. RGB images (height, width, 3) uint8."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from numpy.typing import NDArray

from headcap.evaluation.lip_errors import BASE, CONTOUR, LipErrors
from headcap.evaluation.lips_study import (
    AFFINE,
    ALL,
    DISTANCES,
    PAPER_TABLE_1,
    PAPER_TABLE_2,
    PAPER_TABLE_3,
    SHAPE,
    Estimate,
    LipRow,
    LipStudy,
)
from headcap.report.figures import ACCENT, FAINT, INK, SECOND, Image, sheet

TOLD = {
    BASE: "base tracker",
    CONTOUR: "contour-based",
    "PS": "person-specific",
    "MS": "multi-person",
    "GR": "never seen (GR)",
    SHAPE: "shape alone",
    DISTANCES: "distances alone",
    "combined": "shape and distances",
    AFFINE: "affine",
}
"""What a reader calls a method."""
_COLOURS = (ACCENT, SECOND, "#3b5bdb", "#8a3ffc", "#6b8e23")


def error_bars(study: LipStudy, scope: str = ALL) -> Image:
    """Table 1: mean tracking error by method with its interval over takes, mm; the paper's beside it in grey."""
    rows = {row.method: row for row in study.table_1(scope)}
    with sheet(8.2, 2.6) as (figure, out):
        _bars(figure.subplots(), rows, PAPER_TABLE_1, "error_mm", "mm")
    return out[0]


def input_bars(study: LipStudy, relation: str, scope: str = ALL) -> Image:
    """Tables 2 and 3 and the affine regressor, of one kind of regressor (PS, MS, GR); the paper's in grey."""
    rows = study.by_inputs(relation, scope)
    with sheet(8.2, 2.6) as (figure, out):
        left, right = figure.subplots(1, 2)
        told = {name: row for name, row in rows.items() if row.layer_error is not None}
        _bars(left, told, PAPER_TABLE_2, "layer_error", "radians and strains, rms")
        left.set(title="Error of the nine numbers on takes left out (table 2)")
        _bars(right, rows, PAPER_TABLE_3, "error_mm", "mm")
        right.set(title="Tracking error (table 3)")
    return out[0]


def gap_curves(errors: LipErrors, methods: Sequence[str]) -> Image:
    """Distance of the lips over the time of a take, of some methods and the truth; gaps where there was no answer."""
    curves = {method: errors.gap_mm[errors.row(method)] for method in methods}
    return _curves(errors, curves, errors.gap_mm[-1], "mm", "Distance between the lips")


def roll_curves(errors: LipErrors, methods: Sequence[str]) -> Image:
    """How far the lips are rolled out over time, mean of both lips, of some methods and the truth."""
    curves = {method: errors.roll_deg[errors.row(method)].mean(axis=1) for method in methods}
    return _curves(errors, curves, errors.roll_deg[-1].mean(axis=1), "degrees", "Roll of the lips (larger: farther out)")


def _curves(errors: LipErrors, curves: Mapping[str, NDArray], truth: NDArray, unit: str, title: str) -> Image:
    time_s = errors.time_s - errors.time_s[0]
    with sheet(8.2, 2.3) as (figure, out):
        axes = figure.subplots()
        axes.plot(time_s, truth, color=INK, linewidth=2.2, alpha=0.45, label="truth")
        for (method, values), colour in zip(curves.items(), _COLOURS, strict=False):
            axes.plot(time_s, values, color=FAINT if method == BASE else colour, label=TOLD.get(method, method))
        axes.set(title=f"{title}: {errors.person}, {errors.take}", xlabel="s", ylabel=unit)
        axes.set(xlim=(0, max(float(time_s[-1]), 1e-3)), ylim=_headroom(*axes.get_ylim()))
        axes.legend(ncols=len(curves) + 1, loc="upper left")
    return out[0]


def _headroom(low: float, high: float) -> tuple[float, float]:
    """Room for a legend above curves."""
    return low, high + 0.25 * (high - low)


def _bars(axes, rows: Mapping[str, LipRow], paper: Mapping[str, tuple[float, float]], name: str, unit: str) -> None:
    """Ours, with intervals where several takes tell them, and the paper's."""
    methods = [method for method in rows if method in paper or method == AFFINE]
    digits = 2 if unit == "mm" else 3
    for place, method in enumerate(methods):
        estimate: Estimate = getattr(rows[method], name)
        axes.bar(place - 0.2, estimate.value, 0.38, color=SECOND if method == BASE else ACCENT, label=None)
        if estimate.low is not None:
            low, high = max(estimate.value - estimate.low, 0.0), max(estimate.high - estimate.value, 0.0)
            axes.errorbar(place - 0.2, estimate.value, [[low], [high]], color=INK, capsize=3, linewidth=1)
        axes.annotate(
            f"{estimate.value:.{digits}f}", (place - 0.2, 0), (0, 3), textcoords="offset points", ha="center", color="white"
        )
        if method in paper:
            axes.bar(place + 0.2, paper[method][0], 0.38, color=FAINT)
            axes.annotate(f"{paper[method][0]:.{digits - 1}f}", (place + 0.2, 0), (0, 3), textcoords="offset points", ha="center")
    names = [TOLD[method].replace(" ", "\n", 1) + f"\n{rows[method].takes} takes" for method in methods]
    axes.set(xticks=range(len(methods)), xticklabels=names, ylabel=unit)
    axes.grid(axis="x", visible=False)
