"""PatchMatch over cells: plane hypotheses compete by normalised cross-correlation in several sources.

Scheme: Bleyer et al. 2011 (PatchMatch stereo), whose sweeps in reading order carry a plane across the image at once; one
core per process makes red-black sweeps needless. Hypotheses (see `windows`) compete on every second sample of a window,
which is enough to rank them (Galliani et al. 2015 skip rows and columns alike); refinement takes all.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from headcap.reconstruction.windows import JIT, aim, checkered_offsets, load_patch, pixel_of_disparity, same_plane, score

FROZEN = 2
"""State of a cell (in `settled`) that hands its plane on and is not changed itself."""


@njit(**JIT)
def next_random(state):
    """Advance a 32-bit linear congruential generator (1-element uint64 array); uniform in [-1, 1).

    The product is masked because numba multiplies uint32 in 64 bits; the high bits are the random ones.
    """
    state[0] = (state[0] * np.uint64(1664525) + np.uint64(1013904223)) & np.uint64(0xFFFFFFFF)
    return np.float32(np.float64(state[0] >> np.uint64(8)) * (2.0 / 16777216.0) - 1.0)


@njit(**JIT)
def sweep_depths(images, sizes, view, sources, m, t, cell_px, window_px, depths, best_sources, min_variance, active, plane, cost):
    """Try each of `depths` (n,), facing the camera, in every active cell; fills plane (rows, columns, 3) and cost."""
    flat = images.reshape(-1)
    area, stride = images.shape[1] * images.shape[2], images.shape[2]
    du, dv = checkered_offsets(cell_px, window_px)
    patch, costs = np.empty(du.size, np.float32), np.empty(len(sources), np.float32)
    warp = np.empty((len(sources), 12), np.float32)
    rows, columns = cost.shape
    image = images[view, : sizes[view, 1], : sizes[view, 0]]
    zero = np.float32(0.0)
    for row in range(rows):
        for column in range(columns):
            if not active[row, column]:
                continue
            u, v = cell_px * column + 0.5 * (cell_px - 1), cell_px * row + 0.5 * (cell_px - 1)
            energy = load_patch(image, u, v, du, dv, patch)
            if energy < min_variance * np.float32(patch.size):
                active[row, column] = False
                continue
            aim(m, t, u, v, warp)
            for k in range(len(depths)):
                w = np.float32(1.0 / depths[k])
                trial = score(flat, area, stride, sizes, sources, warp, w, zero, zero, du, dv, patch, energy, best_sources, costs)
                if trial < cost[row, column]:
                    cost[row, column] = trial
                    plane[row, column, 0], plane[row, column, 1], plane[row, column, 2] = w, zero, zero


@njit(inline="always")
def _take_handed_on(
    flat, area, stride, sizes, sources, warp, du, dv, patch, energy, best_sources, costs, row, column, cell_px, side, far_step,
    w_limits, active, plane, unit, best, w, a, b,
):  # fmt: skip
    """The better of a cell's plane (w, a, b) of cost `best` and those of cells just passed: (cost, w, a, b)."""
    rows, columns = active.shape
    for k in range(4 if far_step > 0 else 2):
        reach = side * (1 if k < 2 else far_step)
        r, c = row + reach * (k % 2), column + reach * (1 - k % 2)
        if r < 0 or c < 0 or r >= rows or c >= columns or not active[r, c]:
            continue
        pa, pb = plane[r, c, 1], plane[r, c, 2]
        pw = plane[r, c, 0] + np.float32(cell_px) * (pa * np.float32(column - c) + pb * np.float32(row - r))
        if pw <= w_limits[0] or pw >= w_limits[1] or same_plane(unit, du[-1], w, a, b, pw, pa, pb):
            continue
        trial = score(flat, area, stride, sizes, sources, warp, pw, pa, pb, du, dv, patch, energy, best_sources, costs)
        if trial < best:
            best, w, a, b = trial, pw, pa, pb
    return best, w, a, b


@njit(inline="always")
def _change_at_random(
    flat, area, stride, sizes, sources, warp, du, dv, patch, energy, best_sources, costs, w_limits, trials, reach_px, slope_reach,
    state, best, w, a, b,
):  # fmt: skip
    """The better of a plane (w, a, b) of cost `best` and random changes to it: (cost, w, a, b, changes accepted)."""
    unit = pixel_of_disparity(warp, w)
    scale = np.float32(1.0)
    accepted = 0
    for _ in range(trials):
        pw = w + unit * np.float32(reach_px) * scale * next_random(state)
        pa = a + w * np.float32(slope_reach) * scale * next_random(state)
        pb = b + w * np.float32(slope_reach) * scale * next_random(state)
        scale *= np.float32(0.5)
        if pw <= w_limits[0] or pw >= w_limits[1]:
            continue
        trial = score(flat, area, stride, sizes, sources, warp, pw, pa, pb, du, dv, patch, energy, best_sources, costs)
        if trial < best:
            best, w, a, b = trial, pw, pa, pb
            accepted += 1
    return best, w, a, b, accepted


@njit(**JIT)
def propagate(
    images, sizes, view, sources, m, t, cell_px, window_px, w_limits, best_sources, min_variance, far_step, trials, reach_px,
    slope_reach, seed, backward, settled, active, plane, cost,
):  # fmt: skip
    """One sweep in reading order, or against it: each cell tries planes handed on, then `trials` random changes.

    Handed on are the planes of the two neighbours that the sweep has just passed (so one sweep carries a good plane
    across the image) and, where `far_step` > 0, of the two at that distance. Random changes halve in size from
    `reach_px` pixels of disparity and `slope_reach` (change of inverse depth per pixel, relative to inverse depth).
    Cells marked FROZEN in `settled` (rows, columns) stay as they are. Returns how many random changes were accepted.
    """
    flat = images.reshape(-1)
    area, stride = images.shape[1] * images.shape[2], images.shape[2]
    du, dv = checkered_offsets(cell_px, window_px)
    patch, costs = np.empty(du.size, np.float32), np.empty(len(sources), np.float32)
    warp = np.empty((len(sources), 12), np.float32)
    rows, columns = cost.shape
    image = images[view, : sizes[view, 1], : sizes[view, 0]]
    state = np.array([seed], np.uint64)
    accepted = 0
    side = 1 if backward else -1
    for index in range(rows * columns):
        place = rows * columns - 1 - index if backward else index
        row, column = place // columns, place % columns
        if not active[row, column] or settled[row, column] == FROZEN:
            continue
        u, v = cell_px * column + 0.5 * (cell_px - 1), cell_px * row + 0.5 * (cell_px - 1)
        energy = load_patch(image, u, v, du, dv, patch)
        if energy < min_variance * np.float32(patch.size):
            active[row, column] = False
            continue
        aim(m, t, u, v, warp)
        w, a, b = plane[row, column, 0], plane[row, column, 1], plane[row, column, 2]
        best = cost[row, column]
        unit = pixel_of_disparity(warp, w)
        best, w, a, b = _take_handed_on(
            flat, area, stride, sizes, sources, warp, du, dv, patch, energy, best_sources, costs, row, column, cell_px, side,
            far_step, w_limits, active, plane, unit, best, w, a, b,
        )  # fmt: skip
        if w > 0:
            best, w, a, b, improved = _change_at_random(
                flat, area, stride, sizes, sources, warp, du, dv, patch, energy, best_sources, costs, w_limits, trials, reach_px,
                slope_reach, state, best, w, a, b,
            )  # fmt: skip
            accepted += improved
        cost[row, column] = best
        plane[row, column, 0], plane[row, column, 1], plane[row, column, 2] = w, a, b
    return accepted


@njit(**JIT)
def descend(
    images, sizes, view, sources, m, t, cell_px, window_px, best_sources, min_variance, coarse_plane, coarse_active, active,
    plane, cost,
):  # fmt: skip
    """Start a level from the one above: each cell takes the best of the four coarse planes around its centre."""
    flat = images.reshape(-1)
    area, stride = images.shape[1] * images.shape[2], images.shape[2]
    du, dv = checkered_offsets(cell_px, window_px)
    patch, costs = np.empty(du.size, np.float32), np.empty(len(sources), np.float32)
    warp = np.empty((len(sources), 12), np.float32)
    rows, columns = cost.shape
    coarse_rows, coarse_columns = coarse_active.shape
    image = images[view, : sizes[view, 1], : sizes[view, 0]]
    half = np.float32(0.5)
    for row in range(rows):
        for column in range(columns):
            if not active[row, column]:
                continue
            u, v = cell_px * column + 0.5 * (cell_px - 1), cell_px * row + 0.5 * (cell_px - 1)
            energy = load_patch(image, u, v, du, dv, patch)
            if energy < min_variance * np.float32(patch.size):
                active[row, column] = False
                continue
            aim(m, t, u, v, warp)
            found, unit = False, np.float32(0.0)
            for k in range(4):
                r = row // 2 + (k // 2) * (2 * (row % 2) - 1)
                c = column // 2 + (k % 2) * (2 * (column % 2) - 1)
                if r < 0 or c < 0 or r >= coarse_rows or c >= coarse_columns or not coarse_active[r, c]:
                    continue
                # slopes are per pixel: half as steep on an image twice as large
                pa, pb = half * coarse_plane[r, c, 1], half * coarse_plane[r, c, 2]
                away_u, away_v = column + 0.5 - 2 * (c + 0.5), row + 0.5 - 2 * (r + 0.5)
                pw = coarse_plane[r, c, 0] + np.float32(cell_px * away_u) * pa + np.float32(cell_px * away_v) * pb
                if found and same_plane(
                    unit, du[-1], plane[row, column, 0], plane[row, column, 1], plane[row, column, 2], pw, pa, pb
                ):
                    continue
                trial = score(flat, area, stride, sizes, sources, warp, pw, pa, pb, du, dv, patch, energy, best_sources, costs)
                if trial < cost[row, column]:
                    found, unit = True, pixel_of_disparity(warp, pw)
                    cost[row, column] = trial
                    plane[row, column, 0], plane[row, column, 1], plane[row, column, 2] = pw, pa, pb
            active[row, column] = found
