"""The line on a scan where the lips meet, found from geometry: the strongest valley that runs across the mouth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from headcap.meshes.rasteriser import rasterise_pixels
from headcap.registration.scan import Scan


class LipLineSettings(BaseModel):
    """Search for the valley between the lips."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    pixel_mm: float = Field(0.2, gt=0, description="Grid of the frontal map of the mouth")
    smoothing_mm: float = Field(0.5, description="Scale at which the valley is searched")
    search_mm: float = Field(9.0, description="How far above or below the fitted mouth the line may lie")
    beside_mm: tuple[float, float] = Field(
        (0.2, 0.6),
        description="The line stands as high as the lips the first of these above and below it: next to the crease; "
        "or the second, where the first looks into an open mouth",
    )
    steepest: float = Field(4.0, description="A fall towards the crease beyond this slope is an open mouth's")
    slope_cost: float = Field(0.6, description="Cost of a line that jumps rows between columns")
    end_share: float = Field(0.4, description="The line ends where the valley has this share of its depth in the middle")
    width_range: tuple[float, float] = Field((0.8, 1.25), description="Mouth width against the fitted one")


@dataclass(frozen=True)
class LipLine:
    """Points along the valley from the subject's right corner to the left."""

    points: NDArray[np.float64]
    """(k, 3) metres, scan frame, evenly spaced."""
    strength: float
    """Mean turn of the normal across the valley, in 1/mm; a smooth face has none."""


@dataclass(frozen=True)
class _Map:
    """What the mouth looks like from the front."""

    height: NDArray
    """(rows, columns) metres towards the viewer, NaN where there is nothing."""
    tilt: NDArray
    """(rows, columns) vertical part of the normal."""
    axes: NDArray
    """(3, 3) rows: right-to-left, up, forward."""
    centre: NDArray
    pixel_m: float

    def place(self, row: NDArray, column: NDArray, settings: "LipLineSettings") -> NDArray:
        """Points (k, 3) at fractional pixels, as high as the lips stand right above and below.

        In the valley itself the height jumps between what is seen of either lip and the gap behind.
        """
        height = 0.5 * sum(self._beside(row, column, side, settings) for side in (-1, 1))
        x = (column - 0.5 * (self.height.shape[1] - 1)) * self.pixel_m
        y = (0.5 * (self.height.shape[0] - 1) - row) * self.pixel_m
        return self.centre + np.stack([x, y, height], axis=1) @ self.axes

    def _beside(self, row: NDArray, column: NDArray, side: int, settings: "LipLineSettings") -> NDArray:
        """Height (k,) next to the crease on one side, from farther out where that is missing or deep in a gap."""
        columns = np.clip(np.round(column).astype(int), 0, self.height.shape[1] - 1)
        rows = (np.round(row + side * 1e-3 * beside / self.pixel_m).astype(int) for beside in settings.beside_mm)
        near, far = (self.height[np.clip(at, 0, self.height.shape[0] - 1), columns] for at in rows)
        fall = settings.steepest * 1e-3 * (settings.beside_mm[1] - settings.beside_mm[0])
        return np.where(far - near < fall, near, far)


def find_lip_line(scan: Scan, line: NDArray, forward: NDArray, settings: LipLineSettings) -> LipLine | None:
    """The valley near a fitted lip line (k, 3) ordered from right corner to left; None where there is no valley.

    `forward` points out of the mouth. Works for lips scanned as one surface with a crease and for an open slit.
    """
    view = _look(scan, line, forward, settings)
    valley = _valley_map(view, settings)
    local = (line - view.centre) @ view.axes.T
    columns = np.arange(valley.shape[1])
    x = (columns - 0.5 * (len(columns) - 1)) * view.pixel_m
    expected = 0.5 * (valley.shape[0] - 1) - np.interp(x, local[:, 0], local[:, 1]) / view.pixel_m
    rows = np.arange(valley.shape[0])[:, None]
    reach = 1e-3 * settings.search_mm / view.pixel_m
    score = valley * np.exp(-0.5 * ((rows - expected) / (0.5 * reach)) ** 2)
    score[np.abs(rows - expected) > reach] = 0.0
    path = _best_path(score, settings.slope_cost)
    strength = gaussian_filter1d(valley[path, columns], 1e-3 / view.pixel_m)
    ends = _ends(strength, x, 0.5 * np.ptp(local[:, 0]), settings)
    middle = np.abs(x) < 0.25 * np.ptp(local[:, 0])
    level = float(np.median(strength[middle]))
    if level < 0.08:
        return None
    fine = gaussian_filter1d(path.astype(float) + _peak_offset(valley, path, columns), 0.5e-3 / view.pixel_m)
    points = view.place(np.interp(ends, x, fine), ends / view.pixel_m + 0.5 * (len(columns) - 1), settings)
    seen = np.isfinite(points).all(1)
    return LipLine(points[seen], level) if seen.mean() > 0.5 else None


def _look(scan: Scan, line: NDArray, forward: NDArray, settings: LipLineSettings) -> _Map:
    across = line[-1] - line[0]
    across = across / np.linalg.norm(across)
    forward = forward - (forward @ across) * across
    forward /= np.linalg.norm(forward)
    axes = np.stack([across, np.cross(forward, across), forward])
    centre = 0.5 * (line[0] + line[-1])
    local = (scan.vertices - centre) @ axes.T
    half = np.array([0.75 * np.linalg.norm(line[-1] - line[0]), 2.2e-3 * settings.search_mm])
    pixel = 1e-3 * settings.pixel_mm
    width, height = (2 * np.ceil(half / pixel) + 1).astype(int)
    near = (np.abs(local[:, :2]) < half + 0.004).all(1) & (local[:, 2] > -0.03)
    chosen = scan.triangles[near[scan.triangles].all(1)]
    pixels = np.stack([local[:, 0] / pixel + 0.5 * (width - 1), 0.5 * (height - 1) - local[:, 1] / pixel], axis=1)
    # an orthographic view through the z-buffer: so far away that depth is linear over a triangle
    raster = rasterise_pixels(pixels, 10.0 - local[:, 2], chosen, (int(width), int(height)), cull_back_faces=True)
    seen = raster.interpolate(chosen, np.stack([local[:, 2], scan.normals() @ axes[1]], axis=1))
    return _Map(seen[..., 0], seen[..., 1], axes, centre, pixel)


def _valley_map(view: _Map, settings: LipLineSettings) -> NDArray:
    """How fast the normal turns from down (upper lip) to up (lower lip) along a column, 1/mm; 0 where it does not."""
    known = np.isfinite(view.tilt)
    sigma = settings.smoothing_mm * 1e-3 / view.pixel_m
    share = gaussian_filter(known.astype(float), sigma)
    tilt = gaussian_filter(np.where(known, view.tilt, 0.0), sigma) / np.maximum(share, 1e-6)
    turn = np.gradient(tilt, axis=0) / settings.pixel_mm
    return np.where(share > 0.3, np.maximum(turn, 0.0), 0.0)


def _best_path(score: NDArray, slope_cost: float) -> NDArray[np.int64]:
    """Row per column (dynamic programming, steps of at most two rows)."""
    rows, columns = score.shape
    total, back = score[:, 0].copy(), np.zeros((columns, rows), np.int64)
    penalty = slope_cost * 0.02
    index = np.arange(rows)
    for column in range(1, columns):
        best, origin = total.copy(), index.copy()
        for step in (-2, -1, 1, 2):
            source = np.clip(index + step, 0, rows - 1)
            candidate = total[source] - penalty * step * step
            better = candidate > best
            best[better], origin[better] = candidate[better], source[better]
        total, back[column] = best + score[:, column], origin
    path = np.empty(columns, np.int64)
    path[-1] = int(total.argmax())
    for column in range(columns - 1, 0, -1):
        path[column - 1] = back[column, path[column]]
    return path


def _ends(strength: NDArray, x: NDArray, half_width: float, settings: LipLineSettings) -> NDArray:
    """Evenly spaced x between the corners: where the valley runs out on either side."""
    level = np.median(strength[np.abs(x) < 0.5 * half_width]) * settings.end_share
    low, high = (share * half_width for share in settings.width_range)
    reach = []
    for side in (-1.0, 1.0):
        outward = np.sort(x[(side * x > low)] * side)
        weak = outward[np.interp(side * outward, x, strength) < level]
        reach.append(float(np.clip(weak[0] if len(weak) else high, low, high)))
    return np.linspace(-reach[0], reach[1], 101)


def _peak_offset(valley: NDArray, path: NDArray, columns: NDArray) -> NDArray:
    """Fraction of a row to the summit of a parabola through three rows."""
    inside = np.clip(path, 1, valley.shape[0] - 2)
    above, here, below = (valley[inside + step, columns] for step in (-1, 0, 1))
    bend = above - 2 * here + below
    return np.where(bend < -1e-9, np.clip(0.5 * (above - below) / np.where(bend < -1e-9, bend, -1.0), -1, 1), 0.0)
