"""Which sudden sounds of different cameras are the same event, before anything is known of the start times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft, next_fast_len, rfft

from headcap.sync.clap import STRONGEST_DB, Onset, clap_energy, find_claps, onset_strength_db
from headcap.sync.pairs import from_pair_medians
from headcap.sync.settings import SyncSettings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Sound:
    """One camera's sound on its own clock."""

    samples: NDArray[np.float32]
    rate_hz: int
    start_s: float


@dataclass(frozen=True)
class Event:
    """A sudden sound that several cameras heard."""

    own_time_s: Array
    """(cameras,) onset on each camera's own clock; where no onset was found, when it should have been."""
    heard: NDArray[np.bool_]
    """(cameras,) whether an onset was found."""
    score: float
    """Sum of the onsets' strengths in dB."""


def find_events(sounds: list[Sound], settings: SyncSettings) -> list[Event]:
    """Events heard by enough cameras, best first; empty where there is none.

    The recordings are first aligned to a few milliseconds by their onset strengths as a whole, all pairs against all, so
    a cough at one camera or a clap that another has missed does not shift anything. Onsets that then coincide are one
    event.
    """
    shifts = coarse_alignment(sounds, settings)
    onsets = sudden_sounds(sounds, settings)
    listed = [(onset.time_s - shifts[c], c, onset) for c, found in enumerate(onsets) for onset in found]
    listed.sort(key=lambda entry: entry[0])
    events, least = [], max(2, round(settings.least_cameras_share * len(sounds)))
    while listed:
        cluster = max((_cluster(listed, time_s, settings.cluster_s) for time_s, _, _ in listed), key=_score)
        listed = [entry for entry in listed if entry not in cluster]
        if len(cluster) >= least:
            events.append(_event(cluster, shifts))
    return sorted(events, key=lambda event: -event.score)


def sudden_sounds(sounds: list[Sound], settings: SyncSettings) -> list[tuple[Onset, ...]]:
    """`find_claps` of each sound."""
    return [find_claps(sound.samples, sound.rate_hz, sound.start_s, settings) for sound in sounds]


def coarse_alignment(sounds: list[Sound], settings: SyncSettings) -> Array:
    """(cameras,) own time minus common time, up to a constant, from the correlation of onset strengths; good to ~5 ms."""
    step_s = settings.coarse_step_s
    strengths = [_sampled_strength(sound, settings) for sound in sounds]
    size = next_fast_len(2 * max(len(strength) for strength in strengths), real=True)
    spectra = [rfft(strength, size) for strength in strengths]
    n = len(sounds)
    differences = np.full((n, n), np.nan)
    for i in range(n):
        differences[i, i] = 0.0
        for j in range(i + 1, n):
            correlation = irfft(spectra[j] * spectra[i].conj(), size)
            if correlation.max() <= 1e-6:
                continue
            lag = int(correlation.argmax())
            lag_s = (lag if lag < size // 2 else lag - size) * step_s
            differences[i, j] = lag_s + sounds[j].start_s - sounds[i].start_s
            differences[j, i] = -differences[i, j]
    return from_pair_medians(differences)


def _sampled_strength(sound: Sound, settings: SyncSettings) -> Array:
    """Onset strength above half the threshold at coarse steps: the largest in each step, spread over its neighbours."""
    jump_db, loud = onset_strength_db(clap_energy(sound.samples, sound.rate_hz, settings), sound.rate_hz, settings)
    strong = loud * np.maximum(np.minimum(jump_db, STRONGEST_DB) - settings.onset_jump_db / 2, 0)
    width = max(round(settings.coarse_step_s * sound.rate_hz), 1)
    steps = np.pad(strong, (0, -len(strong) % width)).reshape(-1, width).max(axis=1)
    return np.convolve(steps, [0.5, 1.0, 0.5], mode="same")


def _cluster(listed: list, time_s: float, width_s: float) -> list:
    """Per camera the strongest onset within `width_s` behind a time (listed is sorted by time)."""
    best: dict[int, tuple] = {}
    for entry in listed:
        if 0 <= entry[0] - time_s <= width_s and (entry[1] not in best or entry[2].strength_db > best[entry[1]][2].strength_db):
            best[entry[1]] = entry
    return list(best.values())


def _score(cluster: list) -> float:
    return sum(entry[2].strength_db for entry in cluster)


def _event(cluster: list, shifts: Array) -> Event:
    common_s = float(np.median([entry[0] for entry in cluster]))
    own_s, heard = shifts + common_s, np.zeros(len(shifts), bool)
    for _, camera, onset in cluster:
        own_s[camera], heard[camera] = onset.time_s, True
    return Event(own_s, heard, _score(cluster))
