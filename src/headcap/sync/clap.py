"""Sudden sounds in one recording: where the energy above a few kilohertz jumps."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.sync.settings import SyncSettings

# stronger jumps say no more about the event, only about how silent it was before
STRONGEST_DB = 40.0
STEP_S = 0.00025
# a clap is at its strongest within this time, and its beginning this share (in dB) as strong
RISE_S = 0.010
RISE_SHARE = 0.4


@dataclass(frozen=True)
class Onset:
    """A sudden sound on a recording's own clock."""

    time_s: float
    strength_db: float
    """Energy behind the onset over energy before, at most 40 dB."""


def clap_energy(samples: NDArray, rate_hz: int, settings: SyncSettings) -> NDArray[np.float64]:
    """Square of the samples (n,) above `highpass_hz`, by a causal filter: nothing of a clap appears before it."""
    if len(samples) == 0:
        return np.zeros(0)
    corner_hz = min(settings.highpass_hz, 0.25 * rate_hz)
    # takes a second to import, which every job would pay that reads start times
    from scipy.signal import butter, sosfilt

    filtered = sosfilt(butter(4, corner_hz, "highpass", fs=rate_hz, output="sos"), np.asarray(samples, np.float64))
    return filtered**2


def onset_strength_db(energy: NDArray, rate_hz: int, settings: SyncSettings) -> tuple[NDArray, NDArray, int]:
    """Energy jump in dB (steps,), at least 0, at every `step`-th sample; where it is loud (steps,); and `step`.

    Loud is what is not weak beside the recording's loudest. Where less than `min_background_s` of sound lies before a
    sample the jump is 0: a recording may begin in a sound.
    """
    step = max(round(STEP_S * rate_hz), 1)
    if len(energy) == 0:
        return np.zeros(0), np.zeros(0, bool), step
    total = np.concatenate([[0.0], np.cumsum(energy)])
    n = np.arange(0, len(energy), step)
    end = np.minimum(n + max(round(settings.attack_s * rate_hz), 1), len(energy))
    begin = np.maximum(n - round(settings.background_s * rate_hz), 0)
    behind = (total[end] - total[n]) / (end - n)
    before = (total[n] - total[begin]) / np.maximum(n - begin, 1)
    # 90 dB under the loudest counts as silence, so that digital zeros do not make every tick a clap
    floor = max(float(behind.max()) * 1e-9, 1e-16)
    jump_db = np.maximum(10 * np.log10((behind + floor) / (np.maximum(before, 0) + floor)), 0.0)
    jump_db[n < settings.min_background_s * rate_hz] = 0.0
    return jump_db, behind > behind.max() * 10 ** (-settings.onset_below_loudest_db / 10), step


def find_claps(samples: NDArray, rate_hz: int, start_s: float, settings: SyncSettings | None = None) -> tuple[Onset, ...]:
    """Sudden sounds of a recording, in order of time, on its own clock (`start_s` is its first sample's time).

    Claps are among them; so may be coughs and plosives, which `synchronise` tells apart by strength and by the other
    cameras.
    """
    settings = settings or SyncSettings()
    energy = clap_energy(samples, rate_hz, settings)
    return onsets_of(energy, onset_strength_db(energy, rate_hz, settings), rate_hz, start_s, settings)


def onsets_of(
    energy: NDArray, strength: tuple[NDArray, NDArray, int], rate_hz: int, start_s: float, settings: SyncSettings
) -> tuple[Onset, ...]:
    """`find_claps` from the energy (n,) and what `onset_strength_db` made of it."""
    jump_db, loud, step = strength
    candidates = np.flatnonzero(loud & (jump_db > settings.onset_jump_db))
    hold, found = settings.onset_hold_s * rate_hz / step, []
    for group in np.split(candidates, np.flatnonzero(np.diff(candidates) > hold) + 1):
        if len(group):
            best = int(group[np.argmax(jump_db[group])])
            rise = step * _rise(jump_db, best, round(RISE_S * rate_hz / step))
            first = _pick(energy, rise, round(settings.attack_s * rate_hz))
            found.append(Onset(float(start_s + first / rate_hz), min(float(jump_db[best]), STRONGEST_DB)))
    return tuple(found)


def _rise(jump_db: NDArray, peak: int, reach: int) -> int:
    """First step before a peak of the jump that is nearly as strong: some claps come with a weaker touch just before."""
    begin = max(peak - reach, 0)
    return begin + int(np.argmax(jump_db[begin : peak + 1] >= RISE_SHARE * jump_db[peak]))


def _pick(energy: NDArray, rise: int, attack: int) -> int:
    """Sample at which the energy's level changes, near a rise of the jump (Akaike's criterion, Maeda 1985).

    The jump looks `attack` samples ahead, so the sound begins up to that much behind its rise. The criterion finds the
    direct sound even where a louder echo follows within milliseconds.
    """
    low, high = max(rise - attack, 0), min(rise + attack + attack // 2, len(energy))
    part = energy[low:high] + 1e-9 * float(energy[low:high].max())
    n, total = len(part), np.cumsum(part)
    split = np.arange(8, n - 8)
    if len(split) == 0:
        return rise
    left = split * np.log(total[split - 1] / split)
    right = (n - split) * np.log((total[-1] - total[split - 1]) / (n - split))
    return low + int(split[np.argmin(left + right)])
