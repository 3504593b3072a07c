"""Windows of one view and their images in its sources under plane hypotheses: what all matching kernels share.

A hypothesis is a plane written in the image: inverse depth w at the cell's centre and its slopes a, b per pixel, because
the inverse depth of a plane is linear over a pinhole image. Handing it to a neighbour is then w + a du + b dv, and the
warp into a source is the homography M (u, v, 1) + t (w + a du + b dv).

Kernels take arrays and numbers one by one: in named tuples they cost twice the time, for numba counts references to each.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

JIT = {"cache": True, "fastmath": True, "nogil": True, "error_model": "numpy", "boundscheck": False}
NO_MATCH = np.float32(2.0)
"""Cost of a hypothesis that a source cannot see: that of perfect anticorrelation."""


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
