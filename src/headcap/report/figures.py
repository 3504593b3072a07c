"""Diagrams of a report. Each returns an RGB image (height, width, 3) uint8, drawn without any display."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgba
from matplotlib.figure import Figure
from numpy.typing import NDArray

from headcap.calibration.detection import CameraDetections
from headcap.calibration.result import CalibrationResult
from headcap.cameras import Rig
from headcap.evaluation.catalogue import unit_of
from headcap.evaluation.tracking import TrackingErrors
from headcap.registration.residuals import TrackResiduals
from headcap.report.inputs import CloudGaps
from headcap.sync.offsets import TimeOffsets

Image = NDArray[np.uint8]
INK, ACCENT, SECOND, WARNING, FAINT = "#1d2a30", "#00877a", "#c97b12", "#b3261e", "#b9c3c7"
_STYLE = {
    "font.size": 8.5,
    "font.family": "DejaVu Sans",
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e8ecee",
    "grid.linewidth": 0.7,
    "text.color": INK,
    "xtick.color": "#51636b",
    "ytick.color": "#51636b",
    "legend.frameon": False,
    "lines.linewidth": 1.3,
}
_DPI = 150
_RESIDUALS = {
    "surface_flow_residual": "Photographs against the textured mesh",
    "last_step_mm": "Last refinement: rms step of the vertices",
}


@contextmanager
def sheet(width_in: float, height_in: float) -> Iterator[tuple[Figure, list[Image]]]:
    """A figure of a size in inches to draw on; its image is appended to the list when it is done."""
    with matplotlib.rc_context(_STYLE):
        figure, out = Figure((width_in, height_in), dpi=_DPI, layout="constrained"), []
        canvas = FigureCanvasAgg(figure)
        yield figure, out
        canvas.draw()
        out.append(np.asarray(canvas.buffer_rgba())[..., :3].copy())


def offsets_diagram(offsets: TimeOffsets, true_start_s: dict[str, float] | None, rate_hz: float) -> Image:
    """When each camera started, with its confidence; and, with truth, by how much each start is off."""
    columns = 1 if true_start_s is None else 2
    rows = np.arange(len(offsets.cameras))
    with sheet(8.2, 1.0 + 0.17 * len(rows)) as (figure, out):
        axes = figure.subplots(1, columns, squeeze=False, sharey=True)[0]
        start_ms = 1e3 * (np.array(offsets.start_s) - min(offsets.start_s))
        opacity = np.clip(0.25 + 0.75 * np.array(offsets.confidence), 0, 1)
        colours = [to_rgba(ACCENT if m == "clap" else SECOND, a) for m, a in zip(offsets.method, opacity, strict=True)]
        axes[0].barh(rows, start_ms, 0.62, color=colours)
        axes[0].set(yticks=rows, yticklabels=offsets.cameras, xlabel="started after the first camera, ms")
        axes[0].set_title(
            "Start times" + (", amber: not by the clap" if set(offsets.method) - {"clap"} else "") + "; pale: less sure"
        )
        axes[0].invert_yaxis()
        if true_start_s is not None:
            error = 1e3 * np.array([s - true_start_s[c] for s, c in zip(offsets.start_s, offsets.cameras, strict=True)])
            error -= error.mean()
            axes[1].axvline(0, color=FAINT, linewidth=1)
            axes[1].plot(error, rows, "o", color=ACCENT, markersize=4)
            axes[1].set_title(f"Error against truth (a frame is {1e3 / rate_hz:.1f} ms)")
            reach = max(0.02, 1.25 * np.abs(error).max())
            axes[1].set(xlabel="estimated minus true, mean taken out, ms", xlim=(-reach, reach))
    return out[0]


def rig_diagram(rig: Rig, cloud: NDArray | None) -> Image:
    """The cameras about the subject: in space, and from above."""
    points = np.empty((0, 3)) if cloud is None else np.asarray(cloud)[:: max(1, len(cloud) // 1500)]
    with sheet(8.2, 3.3) as (figure, out):
        grid = figure.add_gridspec(1, 2, width_ratios=(1, 1.25))
        _draw_in_space(figure.add_subplot(grid[0], projection="3d", computed_zorder=False), rig, points)
        _draw_from_above(figure.add_subplot(grid[1]), rig, points)
    return out[0]


def _draw_in_space(axes: Axes, rig: Rig, points: NDArray) -> None:
    # the plot's vertical axis is the world's y, so axes are handed over as (z, x, y)
    turn = lambda positions: np.moveaxis(np.asarray(positions)[..., [2, 0, 1]], -1, 0)  # noqa: E731
    axes.scatter(*turn(points), s=0.4, color=ACCENT, linewidths=0)
    for camera in rig:
        corners = _frustum(camera)
        for corner in corners:
            axes.plot(*turn(np.stack([camera.centre, corner])), color=INK, linewidth=0.6)
        axes.plot(*turn(np.concatenate([corners, corners[:1]])), color=INK, linewidth=0.8)
    shown = turn(np.concatenate([rig.centres, points, np.zeros((1, 3))]))
    low, high = shown.min(axis=1) - 0.05, shown.max(axis=1) + 0.05
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=1.2)
    axes.view_init(26, 28)
    for name, label in (("x", "z, m"), ("y", "x, m"), ("z", "y, m")):
        getattr(axes, f"set_{name}label")(label, fontsize=7, labelpad=-6)
        getattr(axes, f"{name}axis").set_tick_params(labelsize=6, pad=-3)
        getattr(axes, f"{name}axis").set_pane_color((1, 1, 1, 0))


def _draw_from_above(axes: Axes, rig: Rig, points: NDArray) -> None:
    axes.plot(points[:, 0], points[:, 2], ".", color=ACCENT, markersize=0.7)
    low = rig.centres[:, 1] < np.median(rig.centres[:, 1])
    for camera, is_low in zip(rig, low, strict=True):
        corners = _frustum(camera)
        colour = SECOND if is_low else INK
        for corner in corners:
            axes.plot(*np.stack([camera.centre, corner])[:, [0, 2]].T, color=colour, linewidth=0.7)
        place = camera.centre - (0.11 if is_low else 0.04) * camera.axis
        axes.text(place[0], place[2], camera.name, fontsize=5.5, ha="center", va="center", color=colour)
    axes.set(aspect="equal", xlabel="x, m", ylabel="z, m", title="From above; amber: the lower half of the cameras")
    axes.margins(0.2)
    axes.invert_yaxis()


def _frustum(camera, length_m: float = 0.09) -> NDArray:
    width, height = camera.size
    pixels = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], float)
    rays = camera.rays(pixels)
    return camera.centre + rays * (length_m / (rays @ camera.axis))[:, None]


def coverage_diagram(detections: tuple[CameraDetections, ...]) -> Image:
    """Where in each camera's image board corners were found."""
    columns = 8
    rows = -(-len(detections) // columns)
    aspect = detections[0].height / detections[0].width
    with sheet(8.2, rows * (8.2 / columns * aspect + 0.28)) as (figure, out):
        grid = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes in grid[len(detections) :]:
            axes.set_visible(False)
        for axes, seen in zip(grid, detections, strict=False):
            step = max(1, len(seen.pixels) // 4000)
            axes.plot(*seen.pixels[::step].T, ".", color=ACCENT, markersize=0.8, alpha=0.5)
            axes.set(xlim=(-0.5, seen.width - 0.5), ylim=(seen.height - 0.5, -0.5), xticks=[], yticks=[], aspect="equal")
            axes.set_title(seen.camera, fontsize=7, pad=2)
            for spine in axes.spines.values():
                spine.set_visible(True)
    return out[0]


def heldout_diagram(result: CalibrationResult, limit_px: float | None) -> Image:
    """Reprojection error of held-out board poses by camera: rms and 95th percentile."""
    rows = np.arange(len(result.cameras))
    value = lambda name: np.array([getattr(c, name) if getattr(c, name) is not None else np.nan for c in result.cameras])  # noqa: E731
    with sheet(8.2, 2.1) as (figure, out):
        axes = figure.subplots()
        axes.bar(rows, value("heldout_rms_px"), 0.6, color=ACCENT, label="rms")
        axes.plot(rows, value("heldout_p95_px"), "_", color=SECOND, markersize=11, markeredgewidth=2, label="95th percentile")
        if limit_px is not None:
            axes.axhline(limit_px, color=WARNING, linewidth=0.9, linestyle="--", label="limit of the rms")
        axes.set(xticks=rows, ylabel="px", title="Board corners in poses left out of the adjustment")
        axes.set_xticklabels([camera.camera for camera in result.cameras], rotation=45 if len(rows) > 10 else 0)
        axes.grid(axis="x", visible=False)
        axes.legend(ncols=3, loc="upper right")
        axes.margins(y=0.25)
    return out[0]


def error_curves(errors: TrackingErrors, limits: dict[str, float | None]) -> Image:
    """Surface error, drift and lip gap of a tracked take over its frames."""
    has_lips = np.isfinite(errors.lip_gap_mm).any()
    with sheet(8.2, 2.3) as (figure, out):
        axes = figure.subplots(1, 3 if has_lips else 2)
        for panel, name, title in ((axes[0], "surface", "Distance to the true surface"), (axes[1], "drift", "Material drift")):
            values = np.where(errors.seen, getattr(errors, f"{name}_mm"), np.nan)
            key = "surface_error" if name == "surface" else "drift"
            for percentile, colour, part in ((50, ACCENT, "median"), (95, SECOND, "p95")):
                curve = np.nanpercentile(values, percentile, axis=1)
                panel.plot(errors.frames, curve, color=colour, label="median" if percentile == 50 else "95th percentile")
                if (limit := limits.get(f"track.{key}_{part}_mm")) is not None:
                    panel.axhline(limit, color=colour, linewidth=0.8, linestyle="--")
            panel.set(title=title, xlabel="frame", ylabel="mm", ylim=(0, None))
            panel.set(ylim=(0, 1.35 * panel.get_ylim()[1]))
            panel.legend(loc="upper left")
        if has_lips:
            axes[2].plot(errors.frames, errors.true_lip_gap_mm, color=INK, label="true")
            axes[2].plot(errors.frames, errors.lip_gap_mm, color=ACCENT, label="tracked")
            axes[2].set(title="Distance of the inner lips", xlabel="frame", ylabel="mm", ylim=(0, None))
            axes[2].set(ylim=(0, 1.35 * axes[2].get_ylim()[1]))
            axes[2].legend(loc="upper left")
    return out[0]


def gap_curves(gaps: CloudGaps) -> Image:
    """Distance of the reconstructed points to the tracked mesh over the frames."""
    with sheet(8.2, 1.9) as (figure, out):
        axes = figure.subplots()
        axes.plot(gaps.frames, gaps.median_mm, "-o", markersize=2.5, color=ACCENT, label="median")
        axes.plot(gaps.frames, gaps.p95_mm, "-o", markersize=2.5, color=SECOND, label="95th percentile")
        axes.set(title="Reconstructed points to the tracked mesh", xlabel="frame", ylabel="mm", ylim=(0, None))
        axes.legend(ncols=2, loc="upper right")
    return out[0]


def residual_curves(residuals: TrackResiduals) -> Image:
    """What the tracker was left with in each frame, one panel per residual."""
    frames = np.arange(len(residuals))
    with sheet(8.2, 1.9) as (figure, out):
        panels = figure.subplots(1, len(residuals.values), squeeze=False)[0]
        for axes, (name, values) in zip(panels, residuals.values.items(), strict=True):
            axes.plot(frames, values, color=ACCENT)
            worst = int(np.argmax(values))
            axes.plot(worst, values[worst], "o", markersize=4, color=SECOND)
            side = "left" if worst < len(residuals) / 2 else "right"
            told = f"frame {worst}: {values[worst]:.3g}"
            axes.annotate(told, (worst, values[worst]), (0, 5), textcoords="offset points", ha=side)
            axes.set(title=_RESIDUALS.get(name, name), xlabel="frame", ylabel=unit_of(f"track.{name}"))
            axes.set(ylim=(0, 1.25 * max(float(np.max(values)), 1e-9)), xlim=(-0.5, len(residuals) - 0.5))
    return out[0]


def error_histogram(error_mm: NDArray, limits: dict[str, float | None], *, title: str) -> Image:
    """Distribution of distances with their median and 95th percentile."""
    known = error_mm[np.isfinite(error_mm)]
    with sheet(8.2, 1.9) as (figure, out):
        axes = figure.subplots()
        reach = max(1e-6, 1.5 * np.percentile(known, 95))
        axes.hist(known, 80, range=(0, reach), color=FAINT)
        for percentile, part, name, colour in ((50, "median", "median", ACCENT), (95, "p95", "95th percentile", SECOND)):
            value = np.percentile(known, percentile)
            axes.axvline(value, color=colour, label=f"{name}: {value:.3f} mm")
            limit = next((limit for key, limit in limits.items() if key.endswith(f"_{part}_mm") and limit is not None), None)
            if limit is not None:
                axes.axvline(limit, color=colour, linewidth=0.9, linestyle="--", label=f"its limit: {limit:.3g} mm")
        axes.set(title=title, xlabel="mm", yticks=[], xlim=(0, None))
        axes.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=4, borderaxespad=0.2)
    return out[0]


def colour_bar(top: float, label: str) -> Image:
    """The scale of an error picture, from 0 to `top`."""
    with sheet(3.2, 0.5) as (figure, out):
        axes = figure.subplots()
        figure.colorbar(ScalarMappable(Normalize(0, top), "viridis"), cax=axes, orientation="horizontal", label=label)
    return out[0]
