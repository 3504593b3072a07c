"""Diagrams of quasi-eigen faces: errors over time and against the size of a basis, weights. RGB (height, width, 3) uint8."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter, StrMethodFormatter
from numpy.typing import NDArray

from headcap.report.figures import ACCENT, FAINT, INK, SECOND, Image, sheet

TOLD = {"hand": "hand-made", "pca": "eigenfaces", "quasi": "quasi-eigen faces"}
"""What a reader calls a basis."""
COLOURS = {"hand": SECOND, "pca": INK, "quasi": ACCENT}
_STYLES = {"hand": "-", "pca": "--", "quasi": "-"}
_COLUMNS = 2
"""Of the small diagrams of weights."""


def alpha_curves(time_s: NDArray, alphas_pct: Mapping[str, NDArray], moments: Sequence[int] = ()) -> Image:
    """Eq. 6 of each frame (l,) by basis, percent, on a logarithmic axis; thin lines at the frames `moments` that are pictured."""
    with sheet(8.2, 2.9) as (figure, out):
        axes = figure.subplots()
        for frame in moments:
            axes.axvline(time_s[frame], color=FAINT, linewidth=0.9)
        for name, values in alphas_pct.items():
            axes.plot(time_s, np.maximum(values, 1e-6), _STYLES[name], color=COLOURS[name], label=TOLD[name])
        _logarithmic(axes, np.concatenate(list(alphas_pct.values())))
        axes.set(title="Alpha, frame by frame", xlabel="s", ylabel="alpha, %", xlim=_whole(time_s))
        axes.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
    return out[0]


def coverage_curves(by_size_pct: Mapping[str, NDArray], elements: int) -> Image:
    """Alpha over the whole performance with no, one, two ... elements of each basis, percents (j + 1,).

    A thin line marks the number of elements at which bases are compared.
    """
    with sheet(8.2, 3.1) as (figure, out):
        axes = figure.subplots()
        axes.axvline(elements, color=FAINT, linewidth=0.9)
        for name, values in by_size_pct.items():
            marker = {"markersize": 2.6, "marker": "o"}
            axes.plot(np.maximum(values, 1e-6), _STYLES[name], color=COLOURS[name], label=TOLD[name], **marker)
        _logarithmic(axes, np.concatenate(list(by_size_pct.values())))
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set(title="Alpha against the size of the basis", xlabel="elements", ylabel="alpha, %")
        axes.set_xlim(left=0)
        axes.legend(loc="upper right")
    return out[0]


def weight_curves(time_s: NDArray, names: Sequence[str], hand: NDArray, quasi: NDArray) -> Image:
    """Weights (l, k) over time of named shapes, as hand-made and as quasi-eigen faces, each in a diagram of its own."""
    rows = -(-len(names) // _COLUMNS)
    with sheet(8.2, 0.5 + 1.05 * rows) as (figure, out):
        panels = figure.subplots(rows, _COLUMNS, sharex=True, squeeze=False).ravel()
        for axes, name, before, after in zip(panels, names, hand.T, quasi.T, strict=False):
            axes.axhline(0, color=FAINT, linewidth=0.8)
            axes.plot(time_s, before, color=COLOURS["hand"], linewidth=1.0, label=TOLD["hand"])
            axes.plot(time_s, after, color=COLOURS["quasi"], label=TOLD["quasi"])
            axes.set_title(name)
            axes.set_xlim(*_whole(time_s))
            axes.yaxis.set_major_locator(MaxNLocator(3))
        for axes in panels[len(names) :]:
            axes.set_visible(False)
        for axes in panels[max(0, len(names) - _COLUMNS) : len(names)]:
            axes.set_xlabel("s")
            axes.tick_params(labelbottom=True)
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper right", ncols=2)
    return out[0]


def _whole(time_s: NDArray) -> tuple[float, float]:
    """First and last moment, apart even of a single frame."""
    return float(time_s[0]), max(float(time_s[-1]), float(time_s[0]) + 1e-3)


def _logarithmic(axes: Axes, values: NDArray) -> None:
    """Ticks as plain numbers; an error of nothing does not stretch the axis without end."""
    known = values[np.isfinite(values) & (values > 0)]
    axes.set_yscale("log")
    if len(known):
        axes.set_ylim(max(known.min(), 1e-3 * known.max()) / 1.3, known.max() * 1.3)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
