"""Linear prediction of audio frames: all-pole filter, reflection coefficients, gain (paper section 7, audio feature)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.speech.framing import FRAME_SAMPLES

LPC_ORDER = 32
QUANTISATION_VARIANCE = 2.0**-30 / 12
"""Of one sample at 16 bit and full scale 1. Nothing is known below it, so it is added to each frame's power: the equations
stay regular, and silence has the filter 1 with this gain instead of no filter."""
WHITE_NOISE_CORRECTION = 1e-4
"""Of each frame's power, 40 dB below it, as speech coders add (ITU-T G.729): a band that a codec, a resampler or a microphone
empties would otherwise shape the filter and set the gain."""
_WINDOW = 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(FRAME_SAMPLES) + 0.5) / FRAME_SAMPLES)


@dataclass(frozen=True)
class LinearPrediction:
    """All-pole models of n frames, x_t = -sum_k a_k x_(t-k) + b0 e_t."""

    filters: NDArray[np.float64]
    """(n, 32) coefficients a_1 ... a_32 of the inverse filter 1 + sum a_k z^-k."""
    reflections: NDArray[np.float64]
    """(n, 32) reflection coefficients, inside (-1, 1); the same filter as a lattice."""
    gain: NDArray[np.float64]
    """(n,) gain b0: rms of the inverse-filtered frame, in units of the samples."""
    power: NDArray[np.float64]
    """(n,) mean square of the frame."""


def linear_prediction(samples: NDArray, starts: NDArray[np.int64], offset: int = 0) -> LinearPrediction:
    """Order-32 linear prediction of the 256-sample frames that begin at `starts` (n,).

    The first of `samples` has number `offset`; what lies outside is silence. Each frame loses its mean and is weighted
    by a Hann window, as in Karras et al. 2017, whose settings the paper takes. Autocorrelation method (Levinson-Durbin),
    which for an all-pole model is Prony's method in least squares: gain^2 = r_0 + a . r. Paper sections 6.1 and 7.
    """
    samples = np.ascontiguousarray(samples, np.float64)
    filters, reflections, gain, power = _predict(samples, np.asarray(starts, np.int64) - offset, _WINDOW, LPC_ORDER)
    return LinearPrediction(filters, reflections, gain, power)


@njit(cache=True)
def _windowed(samples, start, window, frame):
    """Fill `frame` without its mean; sums in one order, so that a frame is the same in whichever buffer it lies."""
    n, mean = len(window), 0.0
    for i in range(n):
        frame[i] = samples[start + i] if 0 <= start + i < len(samples) else 0.0
        mean += frame[i]
    mean /= n
    for i in range(n):
        frame[i] = (frame[i] - mean) * window[i]


@njit(cache=True, fastmath=True)
def _autocorrelation(frame, out):
    for lag in range(len(out)):
        total = 0.0
        for i in range(len(frame) - lag):
            total += frame[i] * frame[i + lag]
        out[lag] = total


@njit(cache=True)
def _levinson(r, a, k):
    """Solve the Toeplitz equations for the inverse filter; returns the error's power."""
    error = r[0]
    order = len(a)
    for m in range(order):
        total = r[m + 1]
        for i in range(m):
            total += a[i] * r[m - i]
        k[m] = -total / error
        for i in range((m + 1) // 2):
            low, high = a[i], a[m - 1 - i]
            a[i], a[m - 1 - i] = low + k[m] * high, high + k[m] * low
        a[m] = k[m]
        error *= 1.0 - k[m] * k[m]
    return error


@njit(cache=True)
def _predict(samples, starts, window, order):
    n = len(starts)
    filters, reflections = np.zeros((n, order)), np.zeros((n, order))
    gain, power = np.zeros(n), np.zeros(n)
    r, frame = np.zeros(order + 1), np.zeros(len(window))
    weight = 0.0
    for value in window:
        weight += value * value
    for f in range(n):
        _windowed(samples, starts[f], window, frame)
        _autocorrelation(frame, r)
        r /= weight
        power[f] = r[0]
        r[0] = r[0] * (1.0 + WHITE_NOISE_CORRECTION) + QUANTISATION_VARIANCE
        gain[f] = np.sqrt(_levinson(r, filters[f], reflections[f]))
    return filters, reflections, gain, power
