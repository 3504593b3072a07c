"""Sudden sounds in one recording: where the energy above a few kilohertz jumps."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt

from headcap.sync.settings import SyncSettings

# stronger jumps say no more about the event, only about how silent it was before
STRONGEST_DB = 40.0
# a clap is at its strongest within this time, and its beginning this share (in dB) as strong
RISE_S = 0.010
RISE_SHARE = 0.4


@dataclass(frozen=True)
class Onset:
    """A sudden sound on a recording's own clock."""

    time_s: float
    strength_db: float
    """Energy behind the onset over energy before, at most 40 dB."""


def onset_strength_db(samples: NDArray, rate_hz: int, settings: SyncSettings) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Energy jump at each sample (n,) in dB, at least 0, and the energy behind it (n,), both above `highpass_hz`.

    Where less than `min_background_s` of sound lies before a sample the jump is 0: a recording may begin in a sound.
    """
    corner_hz = min(settings.highpass_hz, 0.25 * rate_hz)
    energy = sosfilt(butter(4, corner_hz, "highpass", fs=rate_hz, output="sos"), np.asarray(samples, np.float64)) ** 2
    total = np.concatenate([[0.0], np.cumsum(energy)])
    n = np.arange(len(energy))
    end = np.minimum(n + max(round(settings.attack_s * rate_hz), 1), len(energy))
    begin = np.maximum(n - round(settings.background_s * rate_hz), 0)
    behind = (total[end] - total[n]) / np.maximum(end - n, 1)
    before = (total[n] - total[begin]) / np.maximum(n - begin, 1)
    # 90 dB under the loudest counts as silence, so that digital zeros do not make every tick a clap
    floor = max(float(behind.max(initial=0.0)) * 1e-9, 1e-16)
    jump_db = np.maximum(10 * np.log10((behind + floor) / (np.maximum(before, 0) + floor)), 0.0)
    jump_db[: min(round(settings.min_background_s * rate_hz), len(jump_db))] = 0.0
    return jump_db, behind


def find_claps(samples: NDArray, rate_hz: int, start_s: float, settings: SyncSettings | None = None) -> tuple[Onset, ...]:
    """Sudden sounds of a recording, in order of time, on its own clock (`start_s` is its first sample's time).

    Claps are among them; so may be coughs and plosives, which `synchronise` tells apart by strength and by the other
    cameras.
    """
    settings = settings or SyncSettings()
    jump_db, behind = onset_strength_db(samples, rate_hz, settings)
    loud = behind > behind.max(initial=0.0) * 10 ** (-settings.onset_below_loudest_db / 10)
    candidates = np.flatnonzero(loud & (jump_db > settings.onset_jump_db))
    hold, found = round(settings.onset_hold_s * rate_hz), []
    for group in np.split(candidates, np.flatnonzero(np.diff(candidates) > hold) + 1):
        if len(group):
            best = group[np.argmax(jump_db[group])]
            first = _rise(jump_db, int(best), rate_hz, settings)
            found.append(Onset(float(start_s + first / rate_hz), min(float(jump_db[best]), STRONGEST_DB)))
    return tuple(found)


def _rise(jump_db: NDArray, peak: int, rate_hz: int, settings: SyncSettings) -> int:
    """Sample at which the sound that peaks in `jump_db` begins: some claps come with a weaker touch just before."""
    begin = max(peak - round(RISE_S * rate_hz), 0)
    enough = max(settings.onset_jump_db, RISE_SHARE * float(jump_db[peak]))
    first = begin + int(np.argmax(jump_db[begin : peak + 1] >= enough))
    # the energy behind a sample reaches `attack_s` ahead, so the jump is seen that much before the sound
    return min(first + round(settings.attack_s * rate_hz), peak)
