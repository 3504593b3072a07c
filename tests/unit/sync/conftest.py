"""Synthetic sounds of one room heard by cameras with known start times and clocks."""

from collections.abc import Callable

import numpy as np
import pytest

RATE = 48000


def place(samples: np.ndarray, sound: np.ndarray, time_s: float, gain: float = 1.0) -> None:
    """Add a sound at a fractional sample by a phase ramp (exact for band-limited sounds)."""
    begin = int(np.floor(time_s * RATE))
    size = 2 * len(sound)
    turned = np.fft.rfft(sound, size) * np.exp(-2j * np.pi * np.fft.rfftfreq(size) * (time_s * RATE - begin))
    shifted = np.fft.irfft(turned, size)
    low, high = max(begin, 0), min(begin + size, len(samples))
    if high > low:
        samples[low:high] += gain * shifted[low - begin : high - begin]


def clap(rng: np.random.Generator, decay_s: float = 0.03) -> np.ndarray:
    """A decaying burst with a sharp attack, below 20 kHz, 0.25 s."""
    n = RATE // 4
    burst = rng.standard_normal(n) * np.exp(-np.arange(n) / (decay_s * RATE))
    burst = np.fft.irfft(np.fft.rfft(burst) * (np.fft.rfftfreq(n, 1 / RATE) < 20000), n)
    return burst / np.abs(burst).max()


def cough(rng: np.random.Generator) -> np.ndarray:
    """A dull burst that swells over 30 ms."""
    n = RATE // 4
    envelope = np.minimum(np.arange(n) / (0.03 * RATE), np.exp(-np.arange(n) / (0.08 * RATE)))
    spectrum = np.fft.rfft(rng.standard_normal(n) * envelope)
    return np.fft.irfft(spectrum / (1 + (np.fft.rfftfreq(n, 1 / RATE) / 1200) ** 4), n)


@pytest.fixture
def listen(rng) -> Callable:
    """Record events: `events` lists (sound, common time, flight per camera or None); returns audio per camera."""

    def make(
        starts_s: np.ndarray,
        events: list,
        *,
        duration_s: float = 0.7,
        noise: float = 1e-3,
        drift_ppm: np.ndarray | None = None,
        gains: np.ndarray | None = None,
    ) -> dict:
        n = len(starts_s)
        drift = np.zeros(n) if drift_ppm is None else np.asarray(drift_ppm) * 1e-6
        audio = {}
        for c in range(n):
            samples = noise * rng.standard_normal(round(duration_s * RATE))
            for sound, common_s, flight_s in events:
                flight = 0.0 if flight_s is None else flight_s[c]
                if np.isnan(flight):
                    continue
                place(samples, sound, (common_s + flight - starts_s[c]) / (1 + drift[c]), 1.0 if gains is None else gains[c])
            audio[f"cam{c}"] = (samples.astype(np.float32), RATE, 0.0)
        return audio

    return make


@pytest.fixture
def sounds() -> dict[str, Callable]:
    """Makers of sounds by name."""
    return {"clap": clap, "cough": cough}
