"""A source-filter voice: glottal pulses at a known pitch through resonances at known formants, and friction noise."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.synthetic.articulation import Tracks

# bandwidths of the three moving formants and two fixed ones that give the voice its timbre
_BANDWIDTHS_HZ = np.array([70.0, 95.0, 140.0, 220.0, 300.0])
_FIXED_FORMANTS_HZ = (3500.0, 4500.0)


def synthesise(tracks: Tracks, random: np.random.Generator, time_s: NDArray, rate_hz: int) -> NDArray[np.float64]:
    """Sound pressure at regular times (n,) of the utterance in `tracks`; peak about 0.5.

    Source: Rosenberg's pulse, its open phase 60 % of the period (Rosenberg 1971), differentiated for the lips' radiation;
    filter: second-order resonators in cascade whose frequencies follow the tracks sample by sample (Klatt 1980).
    """
    rows = tracks.at(time_s, "pitch_hz", "voicing", "friction", "friction_hz", "f1_hz", "f2_hz", "f3_hz")
    formants = np.column_stack([rows[:, 4:7], np.broadcast_to(_FIXED_FORMANTS_HZ, (len(time_s), 2))])
    noise = random.normal(0, 1, len(time_s))
    silent = (time_s < tracks.time_s[0]) | (time_s > tracks.time_s[-1])
    voicing, friction = (np.where(silent, 0, np.clip(rows[:, k], 0, None)) for k in (1, 2))
    jitter = 1 + 0.004 * random.normal(0, 1, len(time_s))
    voiced = _voice(rows[:, 0] * jitter, voicing, noise, formants, _BANDWIDTHS_HZ, float(rate_hz))
    hissed = _friction(noise * friction, rows[:, 3], float(rate_hz))
    return 0.5 * voiced + 0.25 * hissed


@njit(cache=True)
def _voice(pitch_hz, voicing, noise, formants_hz, bandwidths_hz, rate_hz):
    out = np.zeros(len(pitch_hz))
    n_formants = formants_hz.shape[1]
    state = np.zeros((n_formants, 2))
    phase, flow_before = 0.0, 0.0
    for k in range(len(pitch_hz)):
        phase = (phase + pitch_hz[k] / rate_hz) % 1.0
        if phase < 0.4:
            flow = 0.5 * (1 - np.cos(np.pi * phase / 0.4))
        elif phase < 0.6:
            flow = np.cos(0.5 * np.pi * (phase - 0.4) / 0.2)
        else:
            flow = 0.0
        sample = voicing[k] * (12.0 * (flow - flow_before) + 0.01 * noise[k])
        flow_before = flow
        for f in range(n_formants):
            radius = np.exp(-np.pi * bandwidths_hz[f] / rate_hz)
            b = 2 * radius * np.cos(2 * np.pi * formants_hz[k, f] / rate_hz)
            c = -radius * radius
            value = (1 - b - c) * sample + b * state[f, 0] + c * state[f, 1]
            state[f, 1], state[f, 0] = state[f, 0], value
            sample = value
        out[k] = sample
    return out


@njit(cache=True)
def _friction(noise, centre_hz, rate_hz):
    out = np.zeros(len(noise))
    first, second = 0.0, 0.0
    radius = np.exp(-np.pi * 1500.0 / rate_hz)
    for k in range(len(noise)):
        b = 2 * radius * np.cos(2 * np.pi * min(centre_hz[k], 0.45 * rate_hz) / rate_hz)
        value = (1 - radius) * noise[k] + b * first - radius * radius * second
        out[k] = value - second  # a zero at rest and at the Nyquist rate leaves the hiss alone
        second, first = first, value
    return out
