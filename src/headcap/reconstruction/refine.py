"""Gauss-Newton refinement of plane hypotheses on the photographs, after PatchMatch has found the right basin.

For each source the window is compared with the source's samples after the best gain and offset are taken out (variable
projection, Golub and Pereyra 1973; the same minimum as that of normalised cross-correlation). Because inverse depth is
linear over the window, the derivative of a sample by (w, a, b) is the epipolar rate times (1, du, dv): three numbers and
no numerical differences. A weak Gaussian prior ties a cell to the planes of its four neighbours and lets go at
discontinuities, so that bare skin borrows from textured skin in proportion to what the photographs say.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from headcap.reconstruction.patchmatch import FROZEN
from headcap.reconstruction.windows import (
    JIT,
    aim,
    correlate,
    load_patch,
    pixel_of_disparity,
    window_inside,
    window_offsets,
)


@njit(inline="always")
def _sum_samples(flat, start, stride, x0, y0, z0, xu, yu, zu, xv, yv, zv, tx, ty, tz, du, dv, patch):
    """Sums over a window's samples: of values v and patch r, of the rates J by (w, a, b), and of their products."""
    one, zero, right, down = np.float32(1.0), np.float32(0.0), np.uint32(1), np.uint32(stride)
    s_v, s_vv, s_rv = zero, zero, zero
    g0, g1, g2 = zero, zero, zero
    v0, v1, v2 = zero, zero, zero
    r0, r1, r2 = zero, zero, zero
    h00, h01, h02, h11, h12, h22 = zero, zero, zero, zero, zero, zero
    for k in range(patch.size):
        p, q = du[k], dv[k]
        over = one / (z0 + p * zu + q * zv)
        x = (x0 + p * xu + q * xv) * over
        y = (y0 + p * yu + q * yv) * over
        column, row = np.int32(x), np.int32(y)
        fx, fy = x - np.float32(column), y - np.float32(row)
        at = np.uint32(start + row * stride + column)
        under = np.uint32(at + down)
        i00, i01 = flat[at], flat[np.uint32(at + right)]
        i10, i11 = flat[under], flat[np.uint32(under + right)]
        top, bottom = i00 + fx * (i01 - i00), i10 + fx * (i11 - i10)
        value = top + fy * (bottom - top)
        gx = (i01 - i00) + fy * ((i11 - i10) - (i01 - i00))
        rate = (gx * (tx - x * tz) + (bottom - top) * (ty - y * tz)) * over
        reference = patch[k]
        s_v += value
        s_vv += value * value
        s_rv += value * reference
        rate_u, rate_v = rate * p, rate * q
        g0 += rate
        g1 += rate_u
        g2 += rate_v
        v0 += value * rate
        v1 += value * rate_u
        v2 += value * rate_v
        r0 += reference * rate
        r1 += reference * rate_u
        r2 += reference * rate_v
        h00 += rate * rate
        h01 += rate * rate_u
        h02 += rate * rate_v
        h11 += rate_u * rate_u
        h12 += rate_u * rate_v
        h22 += rate_v * rate_v
    return (s_v, s_vv, s_rv), (g0, g1, g2), (v0, v1, v2), (r0, r1, r2), (h00, h01, h02, h11, h12, h22)


@njit(inline="always")
def _take_out_gain(sums, size, energy, s, system):
    """Turn sums into row `s` of a system, gain and offset taken out; false where the source shows nothing."""
    (s_v, s_vv, s_rv), (g0, g1, g2), (v0, v1, v2), (r0, r1, r2), (h00, h01, h02, h11, h12, h22) = sums
    one, zero = np.float32(1.0), np.float32(0.0)
    over_n = one / np.float32(size)
    variance = s_vv - s_v * s_v * over_n
    if variance <= np.float32(1e-3) * np.float32(size):
        return False
    gain = max(s_rv / variance, zero)
    v0 -= s_v * g0 * over_n
    v1 -= s_v * g1 * over_n
    v2 -= s_v * g2 * over_n
    gain2, over_v = gain * gain, one / variance
    system[s, 0] = gain2 * (h00 - g0 * g0 * over_n - v0 * v0 * over_v)
    system[s, 1] = gain2 * (h01 - g0 * g1 * over_n - v0 * v1 * over_v)
    system[s, 2] = gain2 * (h02 - g0 * g2 * over_n - v0 * v2 * over_v)
    system[s, 3] = gain2 * (h11 - g1 * g1 * over_n - v1 * v1 * over_v)
    system[s, 4] = gain2 * (h12 - g1 * g2 * over_n - v1 * v2 * over_v)
    system[s, 5] = gain2 * (h22 - g2 * g2 * over_n - v2 * v2 * over_v)
    system[s, 6] = gain * (r0 - gain * v0)
    system[s, 7] = gain * (r1 - gain * v1)
    system[s, 8] = gain * (r2 - gain * v2)
    system[s, 9] = energy - gain * s_rv
    system[s, 10] = s_rv / math.sqrt(variance * energy)
    return True


@njit(**JIT)
def sample_system(flat, start, stride, width, height, warp, s, w, a, b, du, dv, patch, energy, unit, system):
    """Normal equations of source `s`, in steps of `unit` of (w, a, b), in squared grey levels per window.

    `system` (n_sources, 11) receives in row s: the upper triangle of J^T J (00 01 02 11 12 22), J^T r (3), the residual's
    sum of squares after gain and offset, and the correlation. Returns false where the window leaves the source.
    """
    x0, y0, z0 = warp[s, 0] + warp[s, 9] * w, warp[s, 1] + warp[s, 10] * w, warp[s, 2] + warp[s, 11] * w
    xu, yu, zu = warp[s, 3] + warp[s, 9] * a, warp[s, 4] + warp[s, 10] * a, warp[s, 5] + warp[s, 11] * a
    xv, yv, zv = warp[s, 6] + warp[s, 9] * b, warp[s, 7] + warp[s, 10] * b, warp[s, 8] + warp[s, 11] * b
    if not window_inside(x0, y0, z0, xu, yu, zu, xv, yv, zv, du[-1], width, height):
        return False
    tx, ty, tz = warp[s, 9] * unit, warp[s, 10] * unit, warp[s, 11] * unit
    sums = _sum_samples(flat, start, stride, x0, y0, z0, xu, yu, zu, xv, yv, zv, tx, ty, tz, du, dv, patch)
    return _take_out_gain(sums, patch.size, energy, s, system)


@njit(**JIT)
def solve3(h, g, step):
    """Solve the symmetric 3 x 3 system h (00 01 02 11 12 22) step = g by Cholesky; false where it is singular."""
    if h[0] <= 0.0:
        return False
    l00 = math.sqrt(h[0])
    l10, l20 = h[1] / l00, h[2] / l00
    d1 = h[3] - l10 * l10
    if d1 <= 0.0:
        return False
    l11 = math.sqrt(d1)
    l21 = (h[4] - l20 * l10) / l11
    d2 = h[5] - l20 * l20 - l21 * l21
    if d2 <= 0.0:
        return False
    l22 = math.sqrt(d2)
    y0 = g[0] / l00
    y1 = (g[1] - l10 * y0) / l11
    y2 = (g[2] - l20 * y0 - l21 * y1) / l22
    step[2] = y2 / l22
    step[1] = (y1 - l21 * step[2]) / l11
    step[0] = (y0 - l10 * step[1] - l20 * step[2]) / l00
    return True


@njit(**JIT)
def neighbour_prior(plane, active, row, column, cell_px, unit, w, a, b, sigma, sigma_slope, limit, h, g):
    """Add the pull of the four neighbours' planes to the system; returns its energy.

    Each pull is a Gaussian of width `sigma` and `sigma_slope`, weighted by (1 + (d / limit)^2)^-2 (Geman-McClure) of the
    neighbour's departure d in pixels.
    """
    rows, columns = active.shape
    total = np.float32(0.0)
    info, info_slope = np.float32(1.0) / (sigma * sigma), np.float32(1.0) / (sigma_slope * sigma_slope)
    for k in range(4):
        r = row + (k - 2 if k % 2 == 1 else 0)
        c = column + (k - 1 if k % 2 == 0 else 0)
        if r < 0 or c < 0 or r >= rows or c >= columns or not active[r, c]:
            continue
        na, nb = plane[r, c, 1], plane[r, c, 2]
        predicted = plane[r, c, 0] + np.float32(cell_px) * (na * np.float32(column - c) + nb * np.float32(row - r))
        d0, d1, d2 = (predicted - w) / unit, (na - a) / unit, (nb - b) / unit
        ratio = d0 / limit
        ease = np.float32(1.0) / (np.float32(1.0) + ratio * ratio)
        weight, weight_slope = info * ease * ease, info_slope * ease * ease
        h[0] += weight
        h[3] += weight_slope
        h[5] += weight_slope
        g[0] += weight * d0
        g[1] += weight_slope * d1
        g[2] += weight_slope * d2
        total += weight * d0 * d0 + weight_slope * (d1 * d1 + d2 * d2)
    return total


@njit(**JIT)
def _assemble(
    flat, area, stride, sizes, sources, warp, w, a, b, du, dv, patch, energy, unit, noise2, weights, correlation, system, h,
    g,
):  # fmt: skip
    """Weigh the sources and sum their systems into h, g; returns the weighted energy."""
    n = len(sources)
    h[:], g[:] = 0.0, 0.0
    best = np.float32(-1.0)
    for s in range(n):
        source = sources[s]
        correlation[s] = -1.0
        if sample_system(
            flat, source * area, stride, sizes[source, 0], sizes[source, 1], warp, s, w, a, b, du, dv, patch, energy, unit,
            system,
        ):  # fmt: skip
            correlation[s] = system[s, 10]
            best = max(best, system[s, 10])
    total = np.float32(0.0)
    for s in range(n):
        weights[s] = 0.0
        if correlation[s] <= 0.1:
            continue
        # an occluded source correlates far worse than the best one
        lag = (best - correlation[s]) / (np.float32(1.0) - best + np.float32(0.15))
        trust = np.float32(1.0) / (np.float32(1.0) + lag * lag)
        weights[s] = trust * trust / (noise2 + system[s, 9] / np.float32(patch.size))
        for k in range(6):
            h[k] += weights[s] * system[s, k]
        for k in range(3):
            g[k] += weights[s] * system[s, 6 + k]
        total += weights[s] * system[s, 9]
    return total


@njit(**JIT)
def _weighted_energy(flat, area, stride, sizes, sources, warp, w, a, b, du, dv, patch, energy, weights):
    """The photographs' part of the energy with the weights held; what is left after the best gain is 1 - correlation^2."""
    total = np.float32(0.0)
    for s in range(len(sources)):
        if weights[s] > 0.0:
            source = sources[s]
            cost = correlate(
                flat, source * area, stride, sizes[source, 0], sizes[source, 1], warp, s, w, a, b, du, dv, patch, energy
            )
            correlation = max(np.float32(1.0) - cost, np.float32(0.0))
            total += weights[s] * energy * (np.float32(1.0) - correlation * correlation)
    return total


@njit(inline="always")
def _memory(n, samples):
    """Patch, warp, weights, correlation, systems of `n` sources, and their sum h, g and its solution."""
    patch, warp = np.empty(samples, np.float32), np.empty((n, 12), np.float32)
    weights, correlation, system = np.zeros(n, np.float32), np.zeros(n, np.float32), np.empty((n, 11), np.float32)
    h, g, step = np.empty(6, np.float32), np.empty(3, np.float32), np.zeros(3, np.float32)
    return patch, warp, weights, correlation, system, h, g, step


@njit(inline="always")
def _sum_weights(weights, correlation):
    """Sum of the sources' weights, and of weight times correlation."""
    trust, mean = np.float32(0.0), np.float32(0.0)
    for s in range(len(weights)):
        trust += weights[s]
        mean += weights[s] * correlation[s]
    return trust, mean


@njit(inline="always")
def _damp(h):
    """Raise the diagonal a little (Levenberg): a window without texture along one direction stays where it is along it."""
    h[0] += np.float32(1e-3) * h[0] + np.float32(1e-4)
    h[3] += np.float32(1e-3) * h[3] + np.float32(1e-4)
    h[5] += np.float32(1e-3) * h[5] + np.float32(1e-4)


@njit(inline="always")
def _limit(step):
    """Shorten a step to at most a pixel of disparity: farther away the linear system says nothing."""
    if abs(step[0]) > 1.0:
        shrink = np.float32(1.0) / abs(step[0])
        step[0] *= shrink
        step[1] *= shrink
        step[2] *= shrink


@njit(inline="always")
def _settle(settled, row, column, converged):
    """Leave a converged cell alone from now on; wake the neighbours of one that moved."""
    rows, columns = settled.shape
    if converged:
        settled[row, column] = 1
    else:
        for k in range(4):
            r = row + (k - 2 if k % 2 == 1 else 0)
            c = column + (k - 1 if k % 2 == 0 else 0)
            if r >= 0 and c >= 0 and r < rows and c < columns and settled[r, c] != FROZEN:
                settled[r, c] = 0


@njit(**JIT)
def refine_sweep(
    images, sizes, view, sources, m, t, cell_px, window_px, noise_grey, sigma, sigma_slope, limit, converged, backward,
    active, settled, plane, cost, spread,
):  # fmt: skip
    """One sweep of damped Gauss-Newton steps over all active cells, each step kept only if it lowers the energy.

    `settled` (rows, columns) uint8 is set to 1 where the step was below `converged` pixels and cleared around cells that
    moved; FROZEN cells are left as they are.
    `cost` receives 1 - weighted mean correlation, `spread` the standard deviation of w that the system implies.
    Returns (accepted, rejected).
    """
    flat = images.reshape(-1)
    area, stride = images.shape[1] * images.shape[2], images.shape[2]
    du, dv = window_offsets(cell_px, window_px)
    patch, warp, weights, correlation, system, h, g, step = _memory(len(sources), du.size)
    rows, columns = cost.shape
    image = images[view, : sizes[view, 1], : sizes[view, 0]]
    noise2 = np.float32(noise_grey * noise_grey)
    sigma, sigma_slope, limit = np.float32(sigma), np.float32(sigma_slope), np.float32(limit)
    accepted, rejected = 0, 0
    for index in range(rows * columns):
        place = rows * columns - 1 - index if backward else index
        row, column = place // columns, place % columns
        if not active[row, column] or settled[row, column]:
            continue
        u, v = cell_px * column + 0.5 * (cell_px - 1), cell_px * row + 0.5 * (cell_px - 1)
        energy = load_patch(image, u, v, du, dv, patch)
        w, a, b = plane[row, column, 0], plane[row, column, 1], plane[row, column, 2]
        aim(m, t, u, v, warp)
        unit = pixel_of_disparity(warp, w)
        before = _assemble(
            flat, area, stride, sizes, sources, warp, w, a, b, du, dv, patch, energy, unit, noise2, weights, correlation,
            system, h, g,
        )  # fmt: skip
        trust, mean = _sum_weights(weights, correlation)
        if trust <= 0.0:
            active[row, column] = False
            continue
        cost[row, column] = np.float32(1.0) - mean / trust
        before += neighbour_prior(plane, active, row, column, cell_px, unit, w, a, b, sigma, sigma_slope, limit, h, g)
        _damp(h)
        spread[row, column] = unit / math.sqrt(h[0])
        if not solve3(h, g, step):
            continue
        _limit(step)
        nw, na, nb = w + unit * step[0], a + unit * step[1], b + unit * step[2]
        after = _weighted_energy(flat, area, stride, sizes, sources, warp, nw, na, nb, du, dv, patch, energy, weights)
        after += neighbour_prior(plane, active, row, column, cell_px, unit, nw, na, nb, sigma, sigma_slope, limit, h, g)
        if after < before:
            accepted += 1
            plane[row, column, 0], plane[row, column, 1], plane[row, column, 2] = nw, na, nb
            _settle(settled, row, column, abs(step[0]) < converged)
        else:
            rejected += 1
            settled[row, column] = 1
    return accepted, rejected
