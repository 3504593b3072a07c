"""From likelihood maps to contours: the best ring along the border's normals, the best pair of rims across the mouth.

The paper takes the closest maximum along each normal by itself (section 5.1); here all places of a contour are found together, by
dynamic programming, so that a nostril's edge or a tooth's does not win a place of its own.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_SLOPE = 3
"""Steps of the grid that neighbouring places may differ by."""
_ENDS_SHARE = 0.3
"""Share of the mouth's width, from either corner, within which the inner contour must begin."""
_SURE, _UNSURE = 4.0, -4.0
"""Log-odds beyond which one pixel does not count more: no place may carry a whole contour."""
NOTHING = -1e9
_WIDTHS, _HEIGHTS = np.array([0.8, 0.9, 1.0, 1.12, 1.25]), np.array([0.6, 0.8, 1.0, 1.25, 1.6, 2.1])
"""Sizes of the true mouth over the base tracker's: an opening that was missed doubles its height."""


def sample(likelihood: NDArray[np.float32], points: NDArray) -> NDArray[np.float64]:
    """Bilinear log-odds (...) of a map (h, w) at points (..., 2), column and row, cut at -4 and 4; outside counts as -4."""
    out = np.empty(points.shape[:-1]).ravel()
    _sample(likelihood, np.ascontiguousarray(points, np.float64).reshape(-1, 2), out)
    return np.clip(out, _UNSURE, _SURE).reshape(points.shape[:-1])


def resample_ring(ring: NDArray, count: int, left: int) -> NDArray[np.float64]:
    """(count, 2) places on a ring (k, 2) from its first point: half of them, evenly, to the point `left`, half from there on."""
    closed = np.concatenate([ring, ring[:1]])
    halves = []
    for part in (closed[: left + 1], closed[left:]):
        run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(part, axis=0), axis=1))])
        at = np.arange(count // 2) / (count // 2) * run[-1]
        halves.append(np.stack([np.interp(at, run, part[:, k]) for k in range(2)], axis=1))
    return np.concatenate(halves)


def outward_normals(ring: NDArray, smoothing: int) -> NDArray[np.float64]:
    """(k, 2) unit normals of a ring (k, 2), outwards, each from the chord between the places `smoothing` before and after."""
    chord = np.roll(ring, -smoothing, axis=0) - np.roll(ring, smoothing, axis=0)
    normal = np.stack([chord[:, 1], -chord[:, 0]], axis=1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    ahead = np.roll(ring, -1, axis=0)
    area = (ring[:, 0] * ahead[:, 1] - ring[:, 1] * ahead[:, 0]).sum()
    return normal if area > 0 else -normal


def settle_ring(likelihood: NDArray[np.float32], ring: NDArray, reach: float) -> NDArray[np.float64]:
    """A ring (k, 2) moved and stretched as a whole to where a map says most, all in the map's pixels.

    Maximises the mean of L over the ring less (|shift| / reach)^2, one log-odd at the full reach, over shifts of at most `reach`
    and `_WIDTHS` and `_HEIGHTS` about its middle. Normals of a mouth beside the true one lead astray; its shape does not.
    """
    middle = ring.mean(axis=0)
    steps = np.arange(-int(reach), int(reach) + 1, dtype=float)
    best = _best_settling(likelihood, ring - middle, middle, steps, reach, _WIDTHS, _HEIGHTS, _UNSURE, _SURE)
    return middle + best[:2] + (ring - middle) * best[2:]


def search_ring(
    likelihood: NDArray[np.float32], ring: NDArray, normals: NDArray, reach: float, step: float, stiffness: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The ring (k, 2) of most log-odds among those that leave a ring (k, 2) along its normals (k, 2), and its log-odds (k,).

    Maximises sum_i L(p_i + o_i n_i) - (o_i / reach)^2 - stiffness (o_i - o_{i+1})^2 over offsets o_i of at most `reach` on a grid
    of `step` (all in the map's pixels), the last place next to the first: of equal maxima the closest. Then each offset goes to
    the vertex of the parabola through its L.
    """
    offsets = np.arange(-np.ceil(reach / step), np.ceil(reach / step) + 1) * step
    odds = sample(likelihood, ring[:, None] + offsets[None, :, None] * normals[:, None])
    path = _best_cycle(odds - (offsets / reach) ** 2, stiffness * step**2, _SLOPE)
    rows = np.arange(len(ring))
    chosen = offsets[path] + step * _vertex(odds, rows, path, max(1, round(1 / step)))
    return ring + chosen[:, None] * normals, odds[rows, path]


def _vertex(odds: NDArray, rows: NDArray, path: NDArray, span: int) -> NDArray[np.float64]:
    """(k,) steps from a place to the vertex of the parabola through it and those `span` steps before and after, at most one step.

    A span of one pixel: what is bilinear between pixels peaks on them, and a shorter parabola would follow it there.
    """
    last = odds.shape[1] - 1
    before, here, after = (odds[rows, np.clip(path + k, 0, last)] for k in (-span, 0, span))
    bend = before - 2 * here + after
    share = np.where(bend < -1e-6, 0.5 * (before - after) / np.where(bend < -1e-6, bend, 1.0), 0.0)
    return np.where((path >= span) & (path <= last - span), np.clip(span * share, -1.0, 1.0), 0.0)


def search_rims(
    likelihood: NDArray[np.float32],
    origin: NDArray,
    across: NDArray,
    stations: NDArray,
    upper: NDArray,
    lower: NDArray,
    offsets: NDArray,
    bounds: NDArray,
    stiffness: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]] | None:
    """Heights (s,) of the mouth's upper and lower rim at stations (s,), and their log-odds (s,); NaN where it does not reach.

    In the map, pixels: stations lie at `origin` + station * `across` (unit); heights count downwards from there. Candidates are
    `upper` and `lower` (s,) plus `offsets` (o,); they keep within `bounds` (s, 2). Among runs of stations, one from near either
    end, it takes the two chains u <= l of most log-odds, L(u) + L(l), less stiffness times squared steps. Where the two are one,
    L counts once; at both ends of the run they must be: a shut mouth is one line, and two rims need two edges. None where no run
    gains anything.

    Two rims on the flanks of one edge would count it twice: the least that the map says between them, at quarters of the way, is
    taken off where it still speaks of an edge.
    """
    down = np.array([-across[1], across[0]])
    places = origin + stations[:, None] * across
    heights = [base[:, None] + offsets for base in (upper, lower)]
    odds = []
    for height in heights:
        here = sample(likelihood, places[:, None] + height[..., None] * down)
        odds.append(np.where((height >= bounds[:, :1]) & (height <= bounds[:, 1:]), here, NOTHING))
    same = 0.5 * float(offsets[1] - offsets[0])
    last_start = max(1, int(_ENDS_SHARE * len(stations)))
    first, paths = _best_rims(likelihood, places, down, *heights, *odds, same, stiffness, _SLOPE, last_start)
    if first < 0:
        return None
    rims = np.full((2, len(stations)), np.nan)
    counted = np.full(len(stations), np.nan)
    rows = np.arange(first, first + len(paths))
    for k in range(2):
        rims[k, rows] = heights[k][rows, paths[:, k]]
    flat = rims[1] - rims[0] < same
    step = float(offsets[1] - offsets[0])
    for k in range(2):
        rims[k, rows] += step * _vertex(odds[k], rows, paths[:, k], max(1, round(1 / step)))
    rims[:, flat] = rims[:, flat].mean(axis=0)
    counted[rows] = np.minimum(odds[0][rows, paths[:, 0]], odds[1][rows, paths[:, 1]])
    return np.minimum(rims[0], rims[1]), np.maximum(rims[0], rims[1]), counted


@njit(cache=True)
def _at(likelihood, x, y):
    height, width = likelihood.shape
    if not (0 <= x <= width - 1 and 0 <= y <= height - 1):
        return -1e3
    column, row = min(int(x), width - 2), min(int(y), height - 2)
    u, v = x - column, y - row
    top = (1 - u) * likelihood[row, column] + u * likelihood[row, column + 1]
    bottom = (1 - u) * likelihood[row + 1, column] + u * likelihood[row + 1, column + 1]
    return (1 - v) * top + v * bottom


@njit(cache=True)
def _sample(likelihood, points, out):
    for i in range(len(points)):
        out[i] = _at(likelihood, points[i, 0], points[i, 1])


@njit(cache=True)
def _best_settling(likelihood, ring, middle, steps, reach, widths, heights, low, high):
    """Shift and stretch (4,)."""
    best_value, best = -np.inf, np.array([0.0, 0.0, 1.0, 1.0])
    for dx in steps:
        for dy in steps:
            away = (dx * dx + dy * dy) / reach**2
            if away > 1:
                continue
            for width in widths:
                for height in heights:
                    total = 0.0
                    for i in range(len(ring)):
                        x, y = middle[0] + dx + width * ring[i, 0], middle[1] + dy + height * ring[i, 1]
                        total += min(max(_at(likelihood, x, y), low), high)
                    if total / len(ring) - away > best_value:
                        best_value = total / len(ring) - away
                        best[:] = (dx, dy, width, height)
    return best


@njit(cache=True)
def _best_cycle(odds, stiffness, slope):
    """States (k,) of most odds less stiffness times squared steps round a ring of k places: one run for each first state."""
    places, states = odds.shape
    best_value, best = -np.inf, np.zeros(places, np.int64)
    came = np.zeros((places, states), np.int64)
    for start in range(states):
        value = np.full(states, -np.inf)
        value[start] = odds[0, start]
        for k in range(1, places + 1):
            after = np.full(states, -np.inf)
            for j in range(states):
                for i in range(max(0, j - slope), min(states, j + slope + 1)):
                    candidate = value[i] - stiffness * (i - j) ** 2
                    if candidate > after[j]:
                        after[j] = candidate
                        if k < places:
                            came[k, j] = i
                if k < places:
                    after[j] += odds[k, j]
            if k == places and after[start] > best_value:
                best_value = after[start]
                # back from the state that came before the first
                state, top = start, -np.inf
                for i in range(max(0, start - slope), min(states, start + slope + 1)):
                    if value[i] - stiffness * (i - start) ** 2 > top:
                        top, state = value[i] - stiffness * (i - start) ** 2, i
                for back in range(places - 1, -1, -1):
                    best[back] = state
                    state = came[back, state]
            value = after
    return best


@njit(cache=True)
def _joint(likelihood, place, down, upper, gap):
    """What two rims have in common: the least log-odds between them, where they are on a contour rather than not."""
    least = np.inf
    for quarter in (0.25, 0.5, 0.75):
        height = upper + quarter * gap
        least = min(least, _at(likelihood, place[0] + height * down[0], place[1] + height * down[1]))
    return max(least, 0.0)


@njit(cache=True)
def _best_rims(likelihood, places, down, upper, lower, upper_odds, lower_odds, same, stiffness, slope, last_start):
    """First station and states (n, 2) of the best run of pairs; -1 where none is worth anything."""
    stations, states = upper.shape
    value = np.full((states, states), -np.inf)
    came = np.full((stations, states, states), -1, np.int32)
    best_value, end, end_u, end_l = 0.0, -1, 0, 0
    for k in range(stations):
        after = np.full((states, states), -np.inf)
        for u in range(states):
            for w in range(states):
                gap = lower[k, w] - upper[k, u]
                if gap < -same or upper_odds[k, u] < -1e6 or lower_odds[k, w] < -1e6:
                    continue
                shut = gap < same
                here = upper_odds[k, u]
                if not shut:
                    here += lower_odds[k, w] - _joint(likelihood, places[k], down, upper[k, u], gap)
                # a run may begin here, with shut lips
                top, source = (0.0, -1) if shut and k < last_start else (-np.inf, -1)
                if k > 0:
                    for i in range(max(0, u - slope), min(states, u + slope + 1)):
                        for j in range(max(0, w - slope), min(states, w + slope + 1)):
                            if value[i, j] == -np.inf:
                                continue
                            rise = (upper[k, u] - upper[k - 1, i]) ** 2 + (lower[k, w] - lower[k - 1, j]) ** 2
                            candidate = value[i, j] - stiffness * rise
                            if candidate > top:
                                top, source = candidate, i * states + j
                if top == -np.inf:
                    continue
                after[u, w] = top + here
                came[k, u, w] = source
                if shut and k >= stations - last_start and after[u, w] > best_value:
                    best_value, end, end_u, end_l = after[u, w], k, u, w
        value = after
    if end < 0:
        return -1, np.zeros((0, 2), np.int64)
    path = np.zeros((end + 1, 2), np.int64)
    k, u, w = end, end_u, end_l
    while True:
        path[k, 0], path[k, 1] = u, w
        source = came[k, u, w]
        if source < 0:
            return k, path[k:]
        k, u, w = k - 1, source // states, source % states
