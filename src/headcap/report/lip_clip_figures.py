"""Diagrams of a video without truth: lip gap, distance of contours and photometric residual over time.

Images are (height, width, 3) uint8 RGB.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from headcap.evaluation.lip_clip import CORRECTED, LipClip
from headcap.evaluation.lip_closures import WITHIN_S, gap_minima
from headcap.evaluation.lip_errors import BASE
from headcap.report.figures import ACCENT, FAINT, INK, SECOND, WARNING, Image, sheet

_COLOURS = {BASE: SECOND, CORRECTED: ACCENT}
_OVER = {"loc": "lower right", "bbox_to_anchor": (1.0, 0.97), "borderpad": 0}
"""Legends beside the title, where no curve runs."""
_TOLD = {BASE: "base tracker", CORRECTED: "corrected"}


def clip_curves(clip: LipClip) -> Image:
    """A clip's lip gap with its minima and the closures of what was said, its contour distances and its residual over time.

    Frames without a face are red, frames with one but without corrected lips grey.
    """
    with sheet(8.2, 5.4) as (figure, out):
        gap, contours, residual = figure.subplots(3, 1, sharex=True, height_ratios=(1.7, 1, 0.8))
        for axes in (gap, contours, residual):
            _unanswered(axes, clip)
        _gaps(gap, clip)
        _contours(contours, clip)
        residual.plot(clip.time_s, clip.residual, color=INK)
        residual.set(title="Photometric residual of the base tracker", ylabel="linear intensity", xlabel="s", ylim=(0, None))
        residual.set_xlim(clip.time_s[0], max(clip.time_s[-1], clip.time_s[0] + 1e-3))
    return out[0]


def _gaps(axes: Axes, clip: LipClip) -> None:
    for method in clip.methods:
        values = clip.gap(method)
        axes.plot(clip.time_s, values, color=_COLOURS[method], label=_TOLD[method])
        least = gap_minima(clip.time_s, values)
        axes.plot(clip.time_s[least], values[least], "o", color=_COLOURS[method], markersize=3.5)
    top = 1.3 * max(np.nanmax(clip.gap_mm, initial=0.1), 0.1)
    for closure in clip.closures:
        axes.axvspan(closure.time_s - WITHIN_S, closure.time_s + WITHIN_S, color=ACCENT, alpha=0.13, linewidth=0)
        axes.axvline(closure.time_s, color=ACCENT, linewidth=0.8)
    for word in clip.words:
        axes.text((word.start_s + word.end_s) / 2, 0.98 * top, word.text, ha="center", va="top", clip_on=True)
        axes.axvline(word.start_s, color=FAINT, linewidth=0.6, linestyle=":")
    told = "; shaded: b, p, m" if clip.closures else ""
    axes.set(title=f"{clip.name}: lip gap{told}", ylabel="mm", ylim=(0, top))
    axes.legend(ncols=2, **_OVER)


def _contours(axes: Axes, clip: LipClip) -> None:
    for method in clip.methods:
        outer, inner = clip.contour_px[clip.row(method)].T
        axes.plot(clip.time_s, outer, color=_COLOURS[method], label=f"{_TOLD[method]}, outer")
        axes.plot(clip.time_s, inner, color=_COLOURS[method], linestyle="--", label="inner")
    top = max(np.nanmax(clip.contour_px, initial=0.1), 0.1)
    axes.set(title="Contours from those found", ylabel="pixels", ylim=(0, 1.05 * top))
    axes.legend(ncols=4, **_OVER)


def _unanswered(axes: Axes, clip: LipClip) -> None:
    """Stripes over the frames without an answer."""
    half = 0.5 * float(np.median(np.diff(clip.time_s))) if len(clip) > 1 else 0.5
    for frames, colour in ((clip.lost, WARNING), (clip.uncorrected, FAINT)):
        for start, end in _runs(frames):
            axes.axvspan(clip.time_s[start] - half, clip.time_s[end] + half, color=colour, alpha=0.3, linewidth=0)


def told_frames(frames: NDArray[np.int64]) -> str:
    """Frame numbers for a reader: "3, 7 to 9", or "none"."""
    runs = [f"{start}" if start == end else f"{start} to {end}" for start, end in _runs(frames)]
    return ", ".join(runs) or "none"


def _runs(frames: NDArray[np.int64]) -> list[tuple[int, int]]:
    """First and last of each run of neighbours among rising numbers."""
    parts = np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1)
    return [(int(part[0]), int(part[-1])) for part in parts if len(part)]
