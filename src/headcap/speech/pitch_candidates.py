"""Pitches that a piece of sound may have: maxima of its correlation with itself one period later."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.speech.framing import RATE_HZ
from headcap.speech.settings import PitchSettings

_UPSAMPLING = 4
_TAPS = 8  # lags on either side of an interpolated one
_BEYOND_RANGE = 0.01  # an estimate this far outside is taken for the range's end
_LEAST = 0.1  # a weaker correlation is no candidate: it could not win against the unvoiced state over a whole sound


class PitchCandidates:
    """The correlation of one setting at one loudness of speech (rms, in units of the samples)."""

    def __init__(self, settings: PitchSettings, level: float) -> None:
        self._settings = settings
        self._low = math.floor(RATE_HZ / settings.highest_hz / (1 + _BEYOND_RANGE))
        self._high = math.ceil(RATE_HZ / settings.lowest_hz * (1 + _BEYOND_RANGE))
        self._weights = _hann(round(settings.window_s * RATE_HZ) - self._high).astype(np.float32)  # twice as fast
        self._pause_power = max(level, 1e-12) ** 2 * 10 ** (-settings.pause_below_speech_db / 10)
        self._interpolation = _interpolation()
        self.reach = (len(self._weights) + self._high + _TAPS) // 2 + 1
        """Samples on either side of a step's centre that it sees."""

    def find(self, samples: NDArray[np.float64], centres: NDArray[np.int64]) -> tuple[NDArray, NDArray]:
        """Pitches (n, candidates + 1) in Hz and their strengths at samples number `centres` (n,); silence outside.

        Column 0 is the unvoiced state: pitch 0, strength the voicing threshold. Places without a candidate have strength
        -inf. Strength is the normalised correlation r(T) = sum w u v / sqrt(sum w u^2 + e) (sum w v^2 + e) of the sound u
        with the sound v one period T later, both placed evenly around the centre, w a Hann window and e the energy of a
        pause, less `octave_cost` per octave that T is longer than the range's middle: the cost is to choose among octaves and
        not to decide on voice. Lags between samples come from 4-fold band-limited interpolation and a parabola.
        """
        settings = self._settings
        pitch_hz, strength = _find(
            samples, centres, self._weights, self._low, self._high, self._pause_power, self._interpolation,
            settings.candidates + 1, settings.octave_cost,
        )  # fmt: skip
        low, high = settings.lowest_hz, settings.highest_hz
        strength[(pitch_hz < low * (1 - _BEYOND_RANGE)) | (pitch_hz > high * (1 + _BEYOND_RANGE))] = -np.inf
        pitch_hz = np.clip(pitch_hz, low, high)
        pitch_hz[:, 0], strength[:, 0] = 0.0, settings.voicing_threshold
        return pitch_hz, strength


def _hann(n: int) -> NDArray[np.float64]:
    return 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(n) + 0.5) / n)


def _interpolation() -> NDArray[np.float64]:
    """Weights (4, 16) of lags -7 ... 8 for a lag 0, 1/4, 1/2, 3/4 beyond: a sinc under a Hann window."""
    distance = np.arange(_UPSAMPLING)[:, None] / _UPSAMPLING - np.arange(1 - _TAPS, _TAPS + 1)
    return np.sinc(distance) * (0.5 + 0.5 * np.cos(np.pi * distance / _TAPS))


@njit(cache=True, fastmath=True)
def _correlation(piece, weights, pause, least, out):
    """Weighted correlation at lags `least` ... len(out) - 1, zero where the pause's energy keeps it below _LEAST."""
    n, most = len(weights), len(out) - 1
    out[:] = 0.0
    energy = np.empty(most + 1)
    for place in range(most + 1):
        total = np.float32(0.0)
        for i in range(n):
            total += weights[i] * piece[place + i] * piece[place + i]
        energy[place] = pause + total
    if energy.max() * (1 - _LEAST) < pause:
        return
    weighted = np.empty(n, np.float32)
    known = -1
    for lag in range(least, most + 1):
        place = (most - lag) // 2
        if place != known:
            for i in range(n):
                weighted[i] = weights[i] * piece[place + i]
            known = place
        total = np.float32(0.0)
        for i in range(n):
            total += weighted[i] * piece[place + lag + i]
        out[lag] = total / np.sqrt(energy[place] * energy[place + lag])


@njit(cache=True)
def _refine(r, lag, table):
    """Place and height of the maximum near an integer lag."""
    step = len(table)
    best, height = 0, -2.0
    values = np.empty(2 * step + 1)
    for j in range(2 * step + 1):
        base, part = lag - 1 + j // step, j % step
        total = 0.0
        for k in range(table.shape[1]):
            if part == 0 and k != table.shape[1] // 2 - 1:
                continue
            total += table[part, k] * r[base + k - table.shape[1] // 2 + 1]
        values[j] = total
        if total > height and 0 < j < 2 * step:
            best, height = j, total
    before, after = values[best - 1], values[best + 1]
    bend = before - 2 * height + after
    shift = 0.5 * (before - after) / bend if bend < 0 else 0.0
    shift = min(max(shift, -0.5), 0.5)
    return lag - 1 + (best + shift) / step, min(height - 0.25 * (before - after) * shift, 1.0)


@njit(cache=True)
def _find(samples, centres, weights, low, high, pause_power, table, states, octave_cost):
    taps = table.shape[1] // 2
    span = len(weights) + high + taps
    pitch_hz, strength = np.zeros((len(centres), states)), np.full((len(centres), states), -np.inf)
    pause = pause_power * weights.sum()
    piece, r = np.empty(span, np.float32), np.zeros(high + taps + 1)
    for step in range(len(centres)):
        start, mean = centres[step] - span // 2, 0.0
        for i in range(span):
            piece[i] = samples[start + i] if 0 <= start + i < len(samples) else 0.0
            mean += piece[i]
        piece -= np.float32(mean / span)
        _correlation(piece, weights, pause, low - taps, r)
        for lag in range(low, high + 1):
            if r[lag] <= _LEAST or r[lag] <= r[lag - 1] or r[lag] < r[lag + 1]:
                continue
            period, height = _refine(r, lag, table)
            height -= 0.5 * octave_cost * np.log2(period / low * period / high)
            weakest = 1
            for k in range(2, states):
                if strength[step, k] < strength[step, weakest]:
                    weakest = k
            if height > strength[step, weakest]:
                strength[step, weakest], pitch_hz[step, weakest] = height, RATE_HZ / period
    return pitch_hz, strength
