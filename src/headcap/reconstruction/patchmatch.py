"""PatchMatch over cells: plane hypotheses compete by normalised cross-correlation in several sources.

A hypothesis is a plane written in the image: inverse depth w at the cell's centre and its slopes a, b per pixel, because
the inverse depth of a plane is linear over a pinhole image. Handing it to a neighbour is then w + a du + b dv, and the
warp into a source is the homography M (u, v, 1) + t (w + a du + b dv). Scheme: Bleyer et al. 2011 (PatchMatch stereo),
whose sweeps in reading order carry a plane across the
image at once; one core per process makes red-black sweeps needless. Hypotheses compete on every second sample of a window,
which is enough to rank them (Galliani et al. 2015 skip rows and columns alike); refinement takes all.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

JIT = {"cache": True, "fastmath": True, "nogil": True, "error_model": "numpy", "boundscheck": False}
NO_MATCH = np.float32(2.0)
"""Cost of a hypothesis that a source cannot see: that of perfect anticorrelation."""
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
def window_offsets(cell_px, window_px):
    """Pixel offsets (n,), (n,) of a window's samples from the centre of its cell, row by row."""
    side = window_px if (window_px - cell_px) % 2 == 0 else window_px + 1
    du = np.empty(side * side, np.float32)
    dv = np.empty(side * side, np.float32)
    for row in range(side):
        for column in range(side):
            du[row * side + column] = column - 0.5 * (side - 1)
            dv[row * side + column] = row - 0.5 * (side - 1)
    return du, dv


@njit(**JIT)
def checkered_offsets(cell_px, window_px):
    """Every second of `window_offsets`, as the squares of one colour of a chessboard, first and last sample included."""
    every_u, every_v = window_offsets(cell_px, window_px)
    side = round(2 * every_u[-1]) + 1
    du = np.empty((every_u.size + 1) // 2, np.float32)
    dv = np.empty_like(du)
    n = 0
    for k in range(every_u.size):
        if (k // side + k % side) % 2 == 0:
            du[n], dv[n] = every_u[k], every_v[k]
            n += 1
    return du, dv


@njit(**JIT)
def load_patch(image, u, v, du, dv, patch):
    """Copy the samples (du, dv) around (u, v), less their mean; returns the sum of squares, -1 where one is out of the image."""
    height, width = image.shape
    reach = du[-1]
    if u < reach or v < reach or u + reach > width - 1 or v + reach > height - 1:
        return np.float32(-1.0)
    total = np.float32(0.0)
    for k in range(patch.size):
        patch[k] = image[np.int32(v + dv[k]), np.int32(u + du[k])]
        total += patch[k]
    mean = total / np.float32(patch.size)
    energy = np.float32(0.0)
    for k in range(patch.size):
        patch[k] -= mean
        energy += patch[k] * patch[k]
    return energy


@njit(**JIT)
def aim(m, t, u, v, warp):
    """Fill warp (n_sources, 12) float32 for a cell at (u, v): M (u, v, 1), the first two columns of M, and t.

    What does not depend on the hypothesis is summed once per cell, in float64.
    """
    for s in range(len(t)):
        for axis in range(3):
            warp[s, axis] = m[s, axis, 0] * u + m[s, axis, 1] * v + m[s, axis, 2]
            warp[s, 3 + axis] = m[s, axis, 0]
            warp[s, 6 + axis] = m[s, axis, 1]
            warp[s, 9 + axis] = t[s, axis]


@njit(inline="always")
def window_inside(x0, y0, z0, xu, yu, zu, xv, yv, zv, reach, width, height):
    """Whether a window's four corners lie in a source and are not mirrored (as by a plane seen from behind).

    Every bound is linear over the window (x / z < width is width z - x > 0), so it is least at a corner: the centre's value
    less `reach` times the size of its slopes.
    """
    right, bottom, zero = np.float32(width) - np.float32(1.001), np.float32(height) - np.float32(1.001), np.float32(0.0)
    facing = (xu * yv - xv * yu) * z0 + (yu * zv - yv * zu) * x0 + (zu * xv - zv * xu) * y0
    return (
        (facing > zero)
        & (z0 - reach * (abs(zu) + abs(zv)) > np.float32(1e-6))
        & (x0 - reach * (abs(xu) + abs(xv)) >= zero)
        & (y0 - reach * (abs(yu) + abs(yv)) >= zero)
        & (right * z0 - x0 - reach * (abs(right * zu - xu) + abs(right * zv - xv)) > zero)
        & (bottom * z0 - y0 - reach * (abs(bottom * zu - yu) + abs(bottom * zv - yv)) > zero)
    )


@njit(**JIT)
def correlate(flat, start, stride, width, height, warp, s, w, a, b, du, dv, patch, energy):
    """1 - normalised cross-correlation of a view's window with its image in source `s` under a plane hypothesis.

    The source's image begins at flat[start], its rows are `stride` apart; `warp` is as `aim` fills it.
    """
    x0, y0, z0 = warp[s, 0] + warp[s, 9] * w, warp[s, 1] + warp[s, 10] * w, warp[s, 2] + warp[s, 11] * w
    xu, yu, zu = warp[s, 3] + warp[s, 9] * a, warp[s, 4] + warp[s, 10] * a, warp[s, 5] + warp[s, 11] * a
    xv, yv, zv = warp[s, 6] + warp[s, 9] * b, warp[s, 7] + warp[s, 10] * b, warp[s, 8] + warp[s, 11] * b
    if not window_inside(x0, y0, z0, xu, yu, zu, xv, yv, zv, du[-1], width, height):
        return NO_MATCH
    one, right, down = np.float32(1.0), np.uint32(1), np.uint32(stride)
    total, square, cross = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for k in range(patch.size):
        over = one / (z0 + du[k] * zu + dv[k] * zv)
        x = (x0 + du[k] * xu + dv[k] * xv) * over
        y = (y0 + du[k] * yu + dv[k] * yv) * over
        column, row = np.int32(x), np.int32(y)
        fx, fy = x - np.float32(column), y - np.float32(row)
        # unsigned: no test for negative indices; 32 bits: twice the lanes of a gather
        at = np.uint32(start + row * stride + column)
        under = np.uint32(at + down)
        top = flat[at] + fx * (flat[np.uint32(at + right)] - flat[at])
        bottom = flat[under] + fx * (flat[np.uint32(under + right)] - flat[under])
        value = top + fy * (bottom - top)
        total += value
        square += value * value
        cross += value * patch[k]
    variance = square - total * total / np.float32(patch.size)
    if variance <= np.float32(1e-3) * np.float32(patch.size):
        return NO_MATCH
    return one - cross / math.sqrt(variance * energy)


@njit(**JIT)
def score(flat, area, stride, sizes, sources, warp, w, a, b, du, dv, patch, energy, best_sources, costs):
    """Mean cost over the `best_sources` best of the sources; `costs` receives each source's, sorted."""
    n = len(sources)
    for s in range(n):
        source = sources[s]
        cost = correlate(flat, source * area, stride, sizes[source, 0], sizes[source, 1], warp, s, w, a, b, du, dv, patch, energy)
        place = s
        while place > 0 and costs[place - 1] > cost:
            costs[place] = costs[place - 1]
            place -= 1
        costs[place] = cost
    keep = min(best_sources, n)
    total = np.float32(0.0)
    for k in range(keep):
        total += costs[k]
    return total / np.float32(keep)


@njit(**JIT)
def same_plane(unit, reach, w, a, b, pw, pa, pb):
    """Whether two hypotheses differ by less than a tenth of a pixel over a window: refinement bridges that."""
    near = np.float32(0.1) * unit
    return abs(pw - w) < near and abs(pa - a) * reach < near and abs(pb - b) * reach < near


@njit(**JIT)
def pixel_of_disparity(warp, w):
    """Inverse depth that moves the image in the sources by one pixel, 1/m: the harmonic mean over sources."""
    rate = np.float32(0.0)
    for s in range(len(warp)):
        over = np.float32(1.0) / (warp[s, 2] + warp[s, 11] * w)
        x, y = (warp[s, 0] + warp[s, 9] * w) * over, (warp[s, 1] + warp[s, 10] * w) * over
        rate += math.sqrt((warp[s, 9] - x * warp[s, 11]) ** 2 + (warp[s, 10] - y * warp[s, 11]) ** 2) * abs(over)
    return np.float32(len(warp)) / max(rate, np.float32(1e-6))


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


@njit(**JIT)
def propagate(
    images,
    sizes,
    view,
    sources,
    m,
    t,
    cell_px,
    window_px,
    w_limits,
    best_sources,
    min_variance,
    far_step,
    trials,
    reach_px,
    slope_reach,
    seed,
    backward,
    settled,
    active,
    plane,
    cost,
):
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
        if w > 0:
            unit = pixel_of_disparity(warp, w)
            scale = np.float32(1.0)
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
        cost[row, column] = best
        plane[row, column, 0], plane[row, column, 1], plane[row, column, 2] = w, a, b
    return accepted


@njit(**JIT)
def descend(
    images,
    sizes,
    view,
    sources,
    m,
    t,
    cell_px,
    window_px,
    best_sources,
    min_variance,
    coarse_plane,
    coarse_active,
    active,
    plane,
    cost,
):
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
