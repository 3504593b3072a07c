"""Start times of recordings without a clap, from all of their sound."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.sync.gcc import delay_of_spectra, spectrum
from headcap.sync.offsets import TimeOffsets
from headcap.sync.pairs import from_pair_medians, residuals, solve_pairs
from headcap.sync.settings import SyncSettings
from headcap.sync.solve import times_of_flight_s

Array = NDArray[np.float64]

# above this many, each recording is compared with the longest one and one more only: pairs grow with the square
ALL_PAIRS_UP_TO = 8
# codecs keep the phase of voices, not of what is above
VOICE_HZ = 8000.0
# the largest of a few million values of chance is under 6 times their scatter
LEAST_PROMINENCE = 8.0
# sounds from many places in a room arrive within a few milliseconds of each other
COARSE_TOLERANCE_S = 5e-3
# windows in which a pair's delay is measured again, and how many must lie in what both heard
WINDOW_S = 2.0
WINDOWS = 16
LEAST_WINDOWS = 4


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
    """Delay between two whole recordings (samples, rate in Hz, own start) by GCC-PHAT over all lags.

    One lag for all of it: where clocks drift it is a mean, which `match_clocks` refines.
    """
    (a, rate, a_start_s), (b, rate_b, b_start_s) = first, second
    if rate != rate_b:
        raise ValueError(f"sounds of one rate, got {rate} and {rate_b} Hz")
    size = scipy.fft.next_fast_len(len(a) + len(b), real=True)
    spectra = spectrum(a, size), spectrum(b, size)
    band_hz = (settings.band_hz[0], min(settings.band_hz[1], VOICE_HZ))
    delay = delay_of_spectra(*spectra, size, rate, max_lag_s=size / rate / 2, band_hz=band_hz, upsampling=1)
    # what b holds at n, a holds at n - lag
    into_s = -delay.lag_s
    inside = (min(band_hz[1], 0.45 * rate) - band_hz[0]) * size / rate
    # phases at random make a correlation of variance 1 / (2 * frequencies) where a perfect copy makes 1
    return Lag(a_start_s + into_s - b_start_s, into_s, delay.sharpness * float(np.sqrt(2 * inside)))


def align_recordings(
    audio: Mapping[str, tuple[NDArray, int, float]],
    *,
    take: str,
    camera_centres: Mapping[str, Array] | None = None,
    source_m: Array | None = None,
    settings: SyncSettings | None = None,
) -> TimeOffsets:
    """Start times and drifts from everything heard, for a take without a clap: speech, steps, the room.

    `audio` as for `synchronise`. Drift is measured where recordings overlap by `drift_min_span_s`, against the cameras'
    median clock. Time of flight is taken off for sound from `source_m` (a speaker's mouth; metres, in the frame of
    `camera_centres`) where both are given; else it stays in, 3 ms per metre by which cameras differ in their distance.
    Raises `InputError` where a recording has no more in common with the others than chance.
    """
    settings = settings or SyncSettings()
    cameras = tuple(audio)
    weights, matches = _compare_all(audio, cameras, settings)
    alone = [camera for camera, row in zip(cameras, weights, strict=True) if not row.any()]
    if alone:
        expected = f"a correlation {LEAST_PROMINENCE:g} times that of chance"
        remedy = "Give start times by hand (`offsets_s` in the session file)"
        raise InputError(
            f"{take}: the sound of {', '.join(alone)} has nothing in common with the others", expected=expected, remedy=remedy
        )
    drift = _drifts(matches, weights, settings)
    differences = _antisymmetric(
        {(i, j): (1 + drift[i]) * match.first_s - (1 + drift[j]) * match.second_s for (i, j), match in matches.items()},
        len(cameras),
    )
    start_s = solve_pairs(differences, weights, from_pair_medians(differences), 1e-3)
    residual = np.where(weights > 0, residuals(differences, start_s), np.inf)
    agreement = (np.abs(residual) < COARSE_TOLERANCE_S).sum(axis=1) / np.maximum((weights > 0).sum(axis=1), 1)
    start_s = start_s + times_of_flight_s(cameras, camera_centres, source_m, settings)
    start_s = start_s - start_s.max()
    columns = (start_s.tolist(), (1e6 * drift).tolist(), agreement.tolist())
    return TimeOffsets(take, cameras, *(tuple(map(float, column)) for column in columns), ("sound",) * len(cameras))


@dataclass(frozen=True)
class Match:
    """One moment on the clocks of two recordings, and how much faster the second's clock runs."""

    first_s: float
    second_s: float
    """The same moment's own times."""
    faster: float | None
    """Own seconds of the second per own second of the first, less 1; None where the overlap is too short to tell."""


def match_clocks(
    first: tuple[NDArray, int, float], second: tuple[NDArray, int, float], lag: Lag, settings: SyncSettings
) -> Match:
    """Refine a pair's lag by delays in windows spread over what both heard: their line is offset and drift.

    Over the whole of a long recording drift smears the correlation: 50 ppm in a minute are 3 ms.
    """
    (a, rate, a_start_s), (b, _, b_start_s) = first, second
    begin, end = max(lag.into_s, 0.0), min(len(a) / rate, lag.into_s + len(b) / rate)
    span_s = end - begin
    coarse = Match(a_start_s + lag.into_s, b_start_s, None)
    if span_s < settings.drift_min_span_s:
        return coarse
    reach_s = settings.max_lag_s + 1e-6 * settings.max_drift_ppm * span_s
    width = round(min(WINDOW_S, span_s / 4) * rate)
    size = scipy.fft.next_fast_len(width + round(2 * reach_s * rate), real=True)
    band_hz = (settings.band_hz[0], min(settings.band_hz[1], VOICE_HZ))
    moments, delays, weights = [], [], []
    for place in np.linspace(begin * rate, end * rate - width, WINDOWS).round().astype(int):
        other = place - round(lag.into_s * rate)
        if other < 0 or other + width > len(b) or place + width > len(a):
            continue
        spectra = spectrum(a[place : place + width], size), spectrum(b[other : other + width], size)
        delay = delay_of_spectra(*spectra, size, rate, max_lag_s=reach_s, band_hz=band_hz, upsampling=4)
        moments.append(a_start_s + (place + width / 2) / rate)
        delays.append((other - place) / rate + b_start_s - a_start_s + delay.lag_s)
        weights.append(delay.sharpness)
    return _line(np.array(moments), np.array(delays), np.array(weights), coarse)


def _line(moments_s: Array, delays_s: Array, weights: Array, coarse: Match) -> Match:
    """The robust line of second minus first own time over the first's own time (Cauchy, iteratively reweighted)."""
    if len(moments_s) < LEAST_WINDOWS:
        return coarse
    middle = float(moments_s.mean())
    fitted, scale = np.array([0.0, np.median(delays_s)]), 1e-2
    for _ in range(20):
        residual = delays_s - np.polyval(fitted, moments_s - middle)
        scale = max(1e-4, min(scale, 2 * float(np.median(np.abs(residual)))))
        fitted = np.polyfit(moments_s - middle, delays_s, 1, w=np.sqrt(weights / (1 + (residual / scale) ** 2) + 1e-9))
    return Match(middle, middle + float(fitted[1]), float(fitted[0]))


def _compare_all(
    audio: Mapping[str, tuple[NDArray, int, float]], cameras: tuple[str, ...], settings: SyncSettings
) -> tuple[Array, dict[tuple[int, int], Match]]:
    """Weights (n, n), 0 for pairs with nothing in common, and what the others have in common."""
    weights, matches = np.zeros((len(cameras), len(cameras))), {}
    for i, j in _pairs([len(audio[camera][0]) for camera in cameras]):
        first, second = audio[cameras[i]], audio[cameras[j]]
        lag = recording_lag(first, second, settings)
        if lag.prominence >= LEAST_PROMINENCE:
            weights[i, j] = weights[j, i] = lag.prominence
            matches[i, j] = match_clocks(first, second, lag, settings)
    return weights, matches


def _drifts(matches: Mapping[tuple[int, int], Match], weights: Array, settings: SyncSettings) -> Array:
    """(n,) relative drift of each clock, the median clock being right; 0 where too little is known or it is too much."""
    known = {pair: -match.faster for pair, match in matches.items() if match.faster is not None}
    if len(known) < len(matches):
        return np.zeros(len(weights))
    differences = _antisymmetric(known, len(weights))
    drift = solve_pairs(differences, weights, from_pair_medians(differences), 1e-6)
    drift = drift - np.median(drift)
    return drift if 1e6 * np.abs(drift).max() <= settings.max_drift_ppm else np.zeros(len(weights))


def _antisymmetric(values: Mapping[tuple[int, int], float], n: int) -> Array:
    """Differences (n, n) as `solve_pairs` takes them, NaN where unknown."""
    table = np.full((n, n), np.nan)
    np.fill_diagonal(table, 0.0)
    for (i, j), value in values.items():
        table[i, j], table[j, i] = value, -value
    return table


def _pairs(lengths: list[int]) -> list[tuple[int, int]]:
    n = len(lengths)
    if n <= ALL_PAIRS_UP_TO:
        return [(i, j) for i in range(n) for j in range(i + 1, n)]
    hubs = np.argsort(lengths)[-2:]
    return sorted({(min(int(hub), c), max(int(hub), c)) for hub in hubs for c in range(n) if c != hub})
