"""The sounds of a take and what each camera's microphone records of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.signal import butter, lfilter

from headcap.synthetic.articulation import Tracks
from headcap.synthetic.rig import NOISE_STREAM, SOUND_STREAM, Clock, random_stream
from headcap.synthetic.settings import RehearsalSettings, SoundSettings
from headcap.synthetic.voice import synthesise

_TAPS = 32
_PHASES = 1024  # between them the kernel is linear: error (pi / 1024)^2 / 8, -118 dB
_LEAD_S = 0.25
"""The scene's sound starts this long before time zero, room for sound on its way and for filters to settle."""


@dataclass(frozen=True)
class Source:
    """One sound and the place it comes from."""

    samples: NDArray[np.float64]
    """At `rate_hz`, the first one `_LEAD_S` before common time zero."""
    rate_hz: int
    position_m: NDArray[np.float64]

    def heard(self, time_s: NDArray, position_m: NDArray, speed_m_s: float) -> NDArray:
        """Pressure at common times (n,) at another place: time of flight and 1/r from one metre."""
        distance = float(np.linalg.norm(position_m - self.position_m))
        index = (time_s - distance / speed_m_s + _LEAD_S) * self.rate_hz
        return _sinc_interpolate(self.samples, index) / max(distance, 0.1)


def clap(random: np.random.Generator, rate_hz: int) -> NDArray[np.float64]:
    """A wooden clap from its first sample on: a click of broad band that dies away within some milliseconds."""
    time = np.arange(int(0.12 * rate_hz)) / rate_hz
    noise = random.normal(0, 1, len(time))
    bright = lfilter(*butter(2, [900, min(15000, 0.45 * rate_hz)], "bandpass", fs=rate_hz), noise)
    body = lfilter(*butter(2, [350, 1800], "bandpass", fs=rate_hz), noise)
    pulse = bright * np.exp(-time / 0.0035) + 0.6 * body * np.exp(-time / 0.012)
    return 0.85 * pulse / np.abs(pulse).max()


def cough(random: np.random.Generator, rate_hz: int) -> NDArray[np.float64]:
    """A cough: noise below 3 kHz that swells in 15 ms, no sharp onset."""
    time = np.arange(int(0.2 * rate_hz)) / rate_hz
    noise = lfilter(*butter(2, [250, 3000], "bandpass", fs=rate_hz), random.normal(0, 1, len(time)))
    burst = noise * (1 - np.exp(-time / 0.015)) * np.exp(-time / 0.05)
    return 0.5 * burst / np.abs(burst).max()


def take_sources(
    settings: RehearsalSettings, recording: int, duration_s: float, speech: Tracks | None, mouth_m: NDArray
) -> tuple[Source, ...]:
    """All sounds of one recording: claps, a cough, speech from the mouth."""
    sound, rate = settings.sound, settings.sound.rate_hz
    random = random_stream(settings.seed, SOUND_STREAM, recording)
    length = int((duration_s + 2 * _LEAD_S + 0.2) * rate)
    hands = np.zeros(length)
    _add(hands, clap(random, rate), sound.clap_time_s, rate)
    if sound.second_clap_s is not None:
        _add(hands, clap(random, rate), sound.second_clap_s, rate)
    sources = [Source(hands, rate, np.array(sound.clap_position_m))]
    mouth = np.zeros(length)
    if sound.cough:
        _add(mouth, cough(random, rate), max(sound.clap_time_s - 0.13, 0.0), rate)
    if speech is not None:
        mouth += synthesise(speech, random, np.arange(length) / rate - _LEAD_S, rate)
    if mouth.any():
        sources.append(Source(mouth, rate, mouth_m))
    return tuple(sources)


def record(
    settings: RehearsalSettings,
    sources: tuple[Source, ...],
    clock: Clock,
    position_m: NDArray,
    samples: int,
    purpose: tuple[int, int],
) -> NDArray[np.float32]:
    """What the microphone at `position_m` records: (samples,), sample k presented at k / rate on the camera's own clock.

    Direct sound with its time of flight, weaker reflections off the walls (image sources) and noise; gain so that the loudest
    sound stays below full scale. `purpose` (recording, camera) seeds the noise.
    """
    sound = settings.sound
    own = np.arange(samples) / sound.rate_hz - clock.audio_lag_s
    time = clock.common_time(own)
    random = random_stream(settings.seed, NOISE_STREAM, 1, *purpose)
    out = np.zeros(samples)
    for source in sources:
        out += source.heard(time, position_m, sound.speed_m_s)
        for wall, strength in _walls(settings.seed, sound):
            image = Source(source.samples, source.rate_hz, wall * 2 - source.position_m * np.where(wall != 0, 1, -1))
            out += strength * image.heard(time, position_m, sound.speed_m_s)
    out = out / max(1.2 * np.abs(out).max(), 1.0) + random.normal(0, sound.noise, samples)
    return out.astype(np.float32)


def _walls(seed: int, sound: SoundSettings) -> list[tuple[NDArray, float]]:
    """Walls as the foot of their normal from the origin, and how much they reflect."""
    random = random_stream(seed, SOUND_STREAM, 1000)
    axes = np.array([[0, -1, 0], [0, 1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1]], float)
    return [(axes[k % 6] * random.uniform(1.3, 2.6) * (1 + k // 6), random.uniform(0.2, 0.4)) for k in range(sound.echoes)]


def _add(track: NDArray, event: NDArray, time_s: float, rate_hz: int) -> None:
    """Add an event whose first sample falls at `time_s`, between samples where it must."""
    start = (time_s + _LEAD_S) * rate_hz
    first = int(np.floor(start))
    padded = np.concatenate([np.zeros(_TAPS), event, np.zeros(_TAPS)])
    shifted = _sinc_interpolate(padded, np.arange(len(padded)) - (start - first))
    begin = first - _TAPS
    end = min(begin + len(shifted), len(track))
    track[begin:end] += shifted[: end - begin]


def _kernel() -> NDArray[np.float64]:
    """Windowed sinc (phases + 1, taps): Hann window, error below -70 dB up to 0.8 of the Nyquist rate."""
    phase = np.arange(_PHASES + 1)[:, None] / _PHASES
    x = np.arange(-_TAPS // 2 + 1, _TAPS // 2 + 1)[None] - phase
    return np.sinc(x) * 0.5 * (1 + np.cos(np.pi * x / (_TAPS // 2 + 1)))


_KERNEL = _kernel()


def _sinc_interpolate(samples: NDArray, index: NDArray) -> NDArray:
    """Band-limited values (n,) at fractional positions."""
    return _interpolate(samples, index, _KERNEL)


@njit(cache=True)
def _interpolate(samples, index, kernel):
    out = np.zeros(len(index))
    phases, taps = kernel.shape[0] - 1, kernel.shape[1]
    for k in range(len(index)):
        base = int(np.floor(index[k]))
        phase = (index[k] - base) * phases
        row = min(int(phase), phases - 1)
        second = phase - row
        first = base - taps // 2 + 1
        if first < 0 or first + taps > len(samples):
            continue  # beyond the recorded sound it is silent
        total = 0.0
        for tap in range(taps):
            total += samples[first + tap] * ((1 - second) * kernel[row, tap] + second * kernel[row + 1, tap])
        out[k] = total
    return out
