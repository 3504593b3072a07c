"""What the mouth does, from an all-pole model: mel cepstrum above the pause, prediction cepstrum, products."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.speech.framing import RATE_HZ
from headcap.speech.lpc import LinearPrediction

MEL_CEPSTRA, PREDICTION_CEPSTRA, PRODUCTS_OF = 13, 16, 6
ARTICULATION_FEATURES = MEL_CEPSTRA + PREDICTION_CEPSTRA + PRODUCTS_OF * (PRODUCTS_OF + 1) // 2
_BINS, _BANDS = 129, 26
_LOWEST_HZ = 50.0
_PAUSE_BELOW_SPEECH_DB = 30.0  # the range of running speech


def articulation_features(prediction: LinearPrediction, level: float) -> NDArray[np.float32]:
    """Features of audio frames (n, 50) from their all-pole models; `level` is the rms of active speech.

    13 cepstra of log(1 + P / pause) with P the model's power in 26 mel bands and the pause 30 dB below active speech: a
    pause is zero, whatever noise it holds; 16 cepstra of log |1/A|, the envelope without loudness; the 21 products of the first
    six mel cepstra, by which a linear map bends. An addition to the paper's a, whose entries jump between frames of one
    sound: they are the same filter's, but far from linear in its resonances.
    """
    pause = (max(level, 1e-12) * 10 ** (-_PAUSE_BELOW_SPEECH_DB / 20)) ** 2
    return _articulation(prediction.filters, prediction.gain**2 / pause, _COSINES, _MEL, _DCT, PREDICTION_CEPSTRA, PRODUCTS_OF)


def _mel_bands() -> NDArray[np.float64]:
    """Triangles of unit sum over frequency bins (bands, bins)."""
    to_mel = 2595 * np.log10(1 + np.array([_LOWEST_HZ, RATE_HZ / 2]) / 700)
    edges = (700 * (10 ** (np.linspace(*to_mel, _BANDS + 2) / 2595) - 1))[:, None]
    bins = np.linspace(0, RATE_HZ / 2, _BINS)
    rise, fall = (bins - edges[:-2]) / np.diff(edges[:-1], axis=0), (edges[2:] - bins) / np.diff(edges[1:], axis=0)
    triangles = np.clip(np.minimum(rise, fall), 0, None)
    return triangles / triangles.sum(axis=1, keepdims=True)


def cosines(orders: int, n: int) -> NDArray[np.float64]:
    """The first orthonormal cosines (DCT-II) over n places, (orders, n)."""
    table = np.cos(np.pi * np.arange(orders)[:, None] * (np.arange(n) + 0.5) / n) * np.sqrt(2 / n)
    table[0] /= np.sqrt(2)
    return table


_MEL = _mel_bands()
_DCT = cosines(MEL_CEPSTRA, _BANDS)
_COSINES = np.cos(np.pi * np.arange(33)[None] * np.linspace(0, 1, _BINS)[:, None])
_COSINES[:, 1:] *= 2


@njit(cache=True, fastmath=True)
def _articulation(filters, power, cosine, mel, dct, n_prediction, n_products):
    n, order = filters.shape
    n_mel, bands, bins = len(dct), len(mel), len(cosine)
    out = np.zeros((n, n_mel + n_prediction + n_products * (n_products + 1) // 2), np.float32)
    inverse, lags = np.ones(order + 1), np.zeros(order + 1)
    envelope, bands_log, cepstrum = np.zeros(bins), np.zeros(bands), np.zeros(max(n_prediction, n_mel))
    for f in range(n):
        inverse[1:] = filters[f]
        for lag in range(order + 1):
            total = 0.0
            for k in range(order + 1 - lag):
                total += inverse[k] * inverse[k + lag]
            lags[lag] = total
        for b in range(bins):
            total = 0.0
            for k in range(order + 1):
                total += cosine[b, k] * lags[k]
            envelope[b] = power[f] / max(total, 1e-12)
        for m in range(bands):
            total = 0.0
            for b in range(bins):
                total += mel[m, b] * envelope[b]
            bands_log[m] = np.log1p(total)
        for c in range(n_mel):
            total = 0.0
            for m in range(bands):
                total += dct[c, m] * bands_log[m]
            cepstrum[c] = total
            out[f, c] = total
        place = n_mel + n_prediction
        for i in range(n_products):
            for j in range(i, n_products):
                out[f, place] = cepstrum[i] * cepstrum[j]
                place += 1
        for k in range(n_prediction):
            total = -inverse[k + 1]
            for j in range(k):
                total -= (j + 1) / (k + 1) * cepstrum[j] * inverse[k - j]
            cepstrum[k] = total
            out[f, n_mel + k] = total
    return out
