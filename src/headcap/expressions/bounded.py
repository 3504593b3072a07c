"""Quadratic programs of weights with bounds, sparsity and smoothing over time, solved exactly (quasi-eigen paper, eq. 5).

Minimises sum_t 1/2 w_t' G w_t - b_t' w_t + sparsity |w_t|_1 + smoothing/2 |w_t - w_{t-1}|^2 for low <= w <= high by projected
Newton steps (Bertsekas 1982): coordinate descent finds which weights lie on a bound or at zero, the others are solved for at
once by a Cholesky factor of blocks along time, and a step along the projected arc is taken only where the objective falls.
Coordinate descent alone would converge; the steps end it after a few rounds, to rounding.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_TOLERANCE = 1e-11
"""Of the gradient, against the largest right-hand side: rounding of a product with some 100 terms."""
_ROUNDS = 200
_HALVINGS = 12


def solve_frames(
    gram: NDArray, right: NDArray, low: float, high: float, sparsity: float, start: NDArray
) -> tuple[NDArray[np.float64], int]:
    """Weights (l, k) of frames without a tie between them, each begun where the one before ended; frames that did not settle."""
    return _solve_frames(gram, np.ascontiguousarray(right), low, high, sparsity, np.array(start, float))


def solve_sequence(
    gram: NDArray, right: NDArray, low: float, high: float, sparsity: float, smoothing: float, start: NDArray
) -> tuple[NDArray[np.float64], bool]:
    """Weights (l, k) of all frames together, begun at `start` (l, k), and whether they settled; memory l k^2 doubles."""
    weights = np.clip(start, low, high)
    settled = _descend(gram, np.ascontiguousarray(right), low, high, sparsity, smoothing, weights)
    return weights, bool(settled)


@njit(cache=True)
def _solve_frames(gram, right, low, high, sparsity, start):
    frames, count = right.shape
    out = np.empty((frames, count))
    unsettled = 0
    last = start.reshape(1, count)
    for frame in range(frames):
        if not _descend(gram, right[frame : frame + 1], low, high, sparsity, 0.0, last):
            unsettled += 1
        for i in range(count):
            out[frame, i] = last[0, i]
    return out, unsettled


@njit(cache=True)
def _descend(gram, right, low, high, sparsity, smoothing, weights):
    """Rounds of coordinate descent and a projected Newton step, in place; whether the gradient came to rest."""
    scale = sparsity
    for t in range(right.shape[0]):
        for i in range(right.shape[1]):
            scale = max(scale, abs(right[t, i]))
    gradient = np.empty_like(weights)
    for _ in range(_ROUNDS):
        _gradient(gram, right, smoothing, weights, gradient)
        _sweep(gram, low, high, sparsity, smoothing, weights, gradient)
        _gradient(gram, right, smoothing, weights, gradient)
        if _at_rest(low, high, sparsity, weights, gradient) <= _TOLERANCE * scale:
            return True
        _newton(gram, low, high, sparsity, smoothing, weights, gradient)
        _gradient(gram, right, smoothing, weights, gradient)
        if _at_rest(low, high, sparsity, weights, gradient) <= _TOLERANCE * scale:
            return True
    return False


@njit(cache=True)
def _add(out, factor, row):
    for i in range(len(out)):
        out[i] += factor * row[i]


@njit(cache=True)
def _move(weights, share, step, least, most, out):
    """A step along the projected arc."""
    for t in range(weights.shape[0]):
        for i in range(weights.shape[1]):
            out[t, i] = min(max(weights[t, i] + share * step[t, i], least[t, i]), most[t, i])


@njit(cache=True)
def _gradient(gram, right, smoothing, weights, gradient):
    """Of the smooth part, per weight."""
    frames, count = weights.shape
    for t in range(frames):
        for i in range(count):
            gradient[t, i] = -right[t, i]
            if t > 0:
                gradient[t, i] += smoothing * (weights[t, i] - weights[t - 1, i])
            if t + 1 < frames:
                gradient[t, i] += smoothing * (weights[t, i] - weights[t + 1, i])
        for i in range(count):
            if weights[t, i] != 0.0:
                _add(gradient[t], weights[t, i], gram[i])


@njit(cache=True)
def _sweep(gram, low, high, sparsity, smoothing, weights, gradient):
    """Coordinate descent over all weights once; the gradient of the frame at hand is kept up to date."""
    frames, count = weights.shape
    for t in range(frames):
        neighbours = (1.0 if t > 0 else 0.0) + (1.0 if t + 1 < frames else 0.0)
        for i in range(count):
            curvature = gram[i, i] + smoothing * neighbours
            free = weights[t, i] - gradient[t, i] / curvature
            shrunk = np.sign(free) * max(abs(free) - sparsity / curvature, 0.0)
            moved = min(max(shrunk, low), high) - weights[t, i]
            if moved == 0.0:
                continue
            weights[t, i] += moved
            _add(gradient[t], moved, gram[i])
            gradient[t, i] += smoothing * neighbours * moved
            if t + 1 < frames:
                gradient[t + 1, i] -= smoothing * moved


@njit(cache=True)
def _slope(low, high, sparsity, weight, gradient):
    """Slope of the whole objective along the weight where it may still move, 0 where it rests; and the sign it has."""
    up = gradient + (sparsity if weight >= 0.0 else -sparsity)
    down = gradient + (sparsity if weight > 0.0 else -sparsity)
    if up < 0.0 and weight < high:
        return up, 1.0 if weight >= 0.0 else -1.0
    if down > 0.0 and weight > low:
        return down, 1.0 if weight > 0.0 else -1.0
    return 0.0, 0.0


@njit(cache=True)
def _at_rest(low, high, sparsity, weights, gradient):
    """The largest slope that is left."""
    worst = 0.0
    for t in range(weights.shape[0]):
        for i in range(weights.shape[1]):
            worst = max(worst, abs(_slope(low, high, sparsity, weights[t, i], gradient[t, i])[0]))
    return worst


@njit(cache=True)
def _newton(gram, low, high, sparsity, smoothing, weights, gradient):
    """One step of the weights that may move, along the projected arc or, where the objective rises there, to the first bound."""
    tried = np.empty_like(weights)
    for straight in (False, True):
        free, least, most, step = _room(low, high, sparsity, weights, gradient, straight)
        _solve_blocks(gram, smoothing, free, step)
        if straight:
            # the objective falls until the face's minimum: finite, since each step ends there or on one bound more
            _move(weights, _reach(weights, step, least, most), step, least, most, weights)
            return
        share = 1.0
        for _ in range(_HALVINGS):
            _move(weights, share, step, least, most, tried)
            if _change(gram, sparsity, smoothing, weights, tried, gradient) <= 0.0:
                _move(tried, 0.0, step, least, most, weights)
                return
            share *= 0.5


@njit(cache=True)
def _room(low, high, sparsity, weights, gradient, inside_only):
    """Which weights may move, between what, on their side of zero where sparsity has a kink; and the slope they go against."""
    free, step = np.zeros(weights.shape, np.bool_), np.zeros_like(weights)
    least, most = np.empty_like(weights), np.empty_like(weights)
    for t in range(weights.shape[0]):
        for i in range(weights.shape[1]):
            weight = weights[t, i]
            slope, side = _slope(low, high, sparsity, weight, gradient[t, i])
            inside = low < weight < high and (sparsity == 0.0 or weight != 0.0)
            least[t, i] = most[t, i] = weight
            if not inside and (inside_only or slope == 0.0):
                continue
            if slope == 0.0:
                side = np.sign(weight)
            free[t, i], step[t, i] = True, -slope
            least[t, i] = max(low, 0.0) if sparsity > 0.0 and side > 0.0 else low
            most[t, i] = min(high, 0.0) if sparsity > 0.0 and side < 0.0 else high
    return free, least, most, step


@njit(cache=True)
def _reach(weights, step, least, most):
    """How much of a step there is room for, at most 1."""
    share = 1.0
    for t in range(weights.shape[0]):
        for i in range(weights.shape[1]):
            if step[t, i] > 0.0:
                share = min(share, (most[t, i] - weights[t, i]) / step[t, i])
            elif step[t, i] < 0.0:
                share = min(share, (least[t, i] - weights[t, i]) / step[t, i])
    return share


@njit(cache=True)
def _change(gram, sparsity, smoothing, weights, tried, gradient):
    """By how much the objective rises: from the difference, since near the optimum two objectives agree to rounding."""
    frames, count = weights.shape
    total, product = 0.0, np.empty(count)
    for t in range(frames):
        product[:] = 0.0
        for i in range(count):
            if tried[t, i] != weights[t, i]:
                _add(product, tried[t, i] - weights[t, i], gram[i])
        for i in range(count):
            moved = tried[t, i] - weights[t, i]
            total += moved * (gradient[t, i] + 0.5 * product[i]) + sparsity * (abs(tried[t, i]) - abs(weights[t, i]))
            if t > 0:
                total += 0.5 * smoothing * (moved - tried[t - 1, i] + weights[t - 1, i]) ** 2
    return total


@njit(cache=True)
def _choose(free, chosen, values):
    """How many weights of a frame are free, and which; values of the others are 0."""
    size = 0
    for i in range(len(free)):
        if free[i]:
            chosen[size] = i
            size += 1
        else:
            values[i] = 0.0
    return size


@njit(cache=True)
def _solve_blocks(gram, smoothing, free, values):
    """Solves the system of the free weights in place; those that are not free come out 0.

    Along time the matrix is block-tridiagonal with -smoothing on the diagonal of its off-diagonal blocks: each block's Schur
    complement takes the inverse of the one before.
    """
    frames, count = values.shape
    inverses = np.empty((frames if frames > 1 else 0, count, count))
    block, chosen = np.empty((count, count)), np.empty(count, np.int64)
    for t in range(frames):
        size = _choose(free[t], chosen, values[t])
        neighbours = (1.0 if t > 0 else 0.0) + (1.0 if t + 1 < frames else 0.0)
        for a in range(size):
            for b in range(a + 1):
                block[a, b] = gram[chosen[a], chosen[b]]
                if t > 0:
                    block[a, b] -= smoothing**2 * inverses[t - 1, chosen[a], chosen[b]]
            block[a, a] += smoothing * neighbours
        _cholesky(block, size)
        if t > 0:
            _add(values[t], smoothing, _product(inverses[t - 1], values[t - 1], free[t]))
        if frames == 1:
            _substitute(block, size, chosen, values[t])
        else:
            _invert(block, size, chosen, inverses[t])
    if frames == 1:
        return
    for t in range(frames - 1, -1, -1):
        if t + 1 < frames:
            for i in range(count):
                if free[t, i]:
                    values[t, i] += smoothing * values[t + 1, i]
        found = _product(inverses[t], values[t], free[t])
        for i in range(count):
            values[t, i] = found[i]


@njit(cache=True)
def _product(matrix, vector, rows):
    out = np.zeros(len(vector))
    for i in range(len(vector)):
        if rows[i]:
            for j in range(len(vector)):
                out[i] += matrix[i, j] * vector[j]
    return out


@njit(cache=True, fastmath=True)
def _cholesky(block, size):
    """Lower factor in place of the leading part."""
    for a in range(size):
        for b in range(a + 1):
            total = block[a, b]
            for c in range(b):
                total -= block[a, c] * block[b, c]
            if a == b:
                block[a, a] = np.sqrt(total)
            else:
                block[a, b] = total / block[b, b]


@njit(cache=True)
def _substitute(factor, size, chosen, values):
    for a in range(size):
        total = values[chosen[a]]
        for b in range(a):
            total -= factor[a, b] * values[chosen[b]]
        values[chosen[a]] = total / factor[a, a]
    for a in range(size - 1, -1, -1):
        total = values[chosen[a]]
        for b in range(a + 1, size):
            total -= factor[b, a] * values[chosen[b]]
        values[chosen[a]] = total / factor[a, a]


@njit(cache=True, fastmath=True)
def _invert(factor, size, chosen, out):
    """Inverse of the factored matrix, in the places of the free weights; 0 elsewhere."""
    lower = np.zeros((size, size))
    # rows of the transposed inverse factor, so that both loops run along memory
    for a in range(size):
        lower[a, a] = 1.0 / factor[a, a]
        for b in range(a + 1, size):
            total = 0.0
            for c in range(a, b):
                total -= factor[b, c] * lower[a, c]
            lower[a, b] = total / factor[b, b]
    out[:] = 0.0
    for a in range(size):
        for b in range(a + 1):
            total = 0.0
            for c in range(a, size):
                total += lower[a, c] * lower[b, c]
            out[chosen[a], chosen[b]] = total
            out[chosen[b], chosen[a]] = total
