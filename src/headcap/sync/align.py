"""Start times of recordings without a clap, from all of their sound."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from headcap.errors import InputError
from headcap.sync.gcc import delay_of_spectra, spectrum
from headcap.sync.offsets import TimeOffsets
from headcap.sync.pairs import from_pair_medians, residuals, solve_pairs
from headcap.sync.settings import SyncSettings

Array = NDArray[np.float64]

# above this many, each recording is compared with the longest one and one more only: pairs grow with the square
ALL_PAIRS_UP_TO = 8
# codecs keep the phase of voices, not of what is above
VOICE_HZ = 8000.0
# the largest of a few million values of chance is under 6 times their scatter
LEAST_PROMINENCE = 8.0
# sounds from many places in a room arrive within a few milliseconds of each other
COARSE_TOLERANCE_S = 5e-3


@dataclass(frozen=True)
class Lag:
    """Where one recording lies in another's own time."""

    start_s: float
    """Own time of the first at which the second's own time is zero."""
    into_s: float
    """How much of the first recording passes before the second begins, first sample to first sample."""
    prominence: float
    """Peak of the correlation over its own scatter; chance alone stays under 6."""


def recording_lag(first: tuple[NDArray, int, float], second: tuple[NDArray, int, float], settings: SyncSettings) -> Lag:
    """Delay between two whole recordings (samples, rate in Hz, own start) by GCC-PHAT over all lags; no drift is modelled."""
    (a, rate, a_start_s), (b, rate_b, b_start_s) = first, second
    if rate != rate_b:
        raise ValueError(f"sounds of one rate, got {rate} and {rate_b} Hz")
    size = next_fast_len(len(a) + len(b), real=True)
    spectra = spectrum(a, size), spectrum(b, size)
    band_hz = (settings.band_hz[0], min(settings.band_hz[1], VOICE_HZ))
    delay = delay_of_spectra(*spectra, size, rate, max_lag_s=size / rate / 2, band_hz=band_hz, upsampling=1)
    # what b holds at n, a holds at n - lag
    into_s = -delay.lag_s
    inside = (min(band_hz[1], 0.45 * rate) - band_hz[0]) * size / rate
    # phases at random make a correlation of variance 1 / (2 * frequencies) where a perfect copy makes 1
    return Lag(a_start_s + into_s - b_start_s, into_s, delay.sharpness * float(np.sqrt(2 * inside)))


def align_recordings(
    audio: Mapping[str, tuple[NDArray, int, float]], *, take: str, settings: SyncSettings | None = None
) -> TimeOffsets:
    """Start times from everything heard, for a take without a clap: speech, steps, the room.

    Time of flight is not taken off (the sounds come from many places), so expect 1 to 3 ms between cameras metres apart.
    Raises `InputError` where a recording has no more in common with the others than chance.
    """
    settings = settings or SyncSettings()
    cameras = tuple(audio)
    n = len(cameras)
    differences, weights = np.full((n, n), np.nan), np.zeros((n, n))
    for i, j in _pairs([len(audio[camera][0]) for camera in cameras]):
        lag = recording_lag(audio[cameras[i]], audio[cameras[j]], settings)
        if lag.prominence >= LEAST_PROMINENCE:
            differences[i, j], differences[j, i] = lag.start_s, -lag.start_s
            weights[i, j] = weights[j, i] = lag.prominence
    np.fill_diagonal(differences, 0.0)
    alone = [cameras[c] for c in range(n) if not weights[c].any()]
    if alone:
        expected = f"a correlation {LEAST_PROMINENCE:g} times that of chance"
        remedy = "Give start times by hand (`offsets` in the session file)"
        raise InputError(
            f"{take}: the sound of {', '.join(alone)} has nothing in common with the others", expected=expected, remedy=remedy
        )
    start_s = solve_pairs(differences, weights, from_pair_medians(differences), 1e-3)
    residual = np.where(weights > 0, residuals(differences, start_s), np.inf)
    agreement = (np.abs(residual) < COARSE_TOLERANCE_S).sum(axis=1) / np.maximum((weights > 0).sum(axis=1), 1)
    start_s = start_s - start_s.max()
    columns = (start_s.tolist(), [0.0] * n, agreement.tolist())
    return TimeOffsets(take, cameras, *(tuple(map(float, column)) for column in columns), ("sound",) * n)


def _pairs(lengths: list[int]) -> list[tuple[int, int]]:
    n = len(lengths)
    if n <= ALL_PAIRS_UP_TO:
        return [(i, j) for i in range(n) for j in range(i + 1, n)]
    hubs = np.argsort(lengths)[-2:]
    return sorted({(min(int(hub), c), max(int(hub), c)) for hub in hubs for c in range(n) if c != hub})
