"""Which sudden sounds of different cameras are the same event, before anything is known of the start times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from headcap.sync.clap import STRONGEST_DB, Onset, clap_energy, onset_strength_db, onsets_of
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
    heard_by = [_listen(sound, settings) for sound in sounds]
    onsets = [heard.onsets for heard in heard_by]
    shifts = coarse_alignment(sounds, [heard.strength for heard in heard_by], settings)
    listed = [_Heard(onset.time_s - shifts[c], c, onset) for c, found in enumerate(onsets) for onset in found]
    listed.sort(key=lambda heard: heard.common_s)
    times_s = np.array([heard.common_s for heard in listed])
    ends = np.searchsorted(times_s, times_s + settings.cluster_s, side="right")
    clusters = sorted((_strongest(listed[i:end]) for i, end in enumerate(ends)), key=_score, reverse=True)
    least, used, events = max(2, round(settings.least_cameras_share * len(sounds))), set(), []
    for cluster in clusters:
        members = {id(heard) for heard in cluster}
        if len(cluster) >= least and not members & used:
            used |= members
            events.append(_event(cluster, shifts))
    return events


@dataclass(frozen=True)
class _Listening:
    """What is kept of one camera's sound."""

    onsets: tuple[Onset, ...]
    strength: Array
    """At coarse steps."""


def _listen(sound: Sound, settings: SyncSettings) -> _Listening:
    energy = clap_energy(sound.samples, sound.rate_hz, settings)
    strength = onset_strength_db(energy, sound.rate_hz, settings)
    onsets = onsets_of(energy, strength, sound.rate_hz, sound.start_s, settings)
    return _Listening(onsets, _coarse_strength(*strength, sound.rate_hz, settings))


def coarse_alignment(sounds: list[Sound], strengths: list[Array], settings: SyncSettings) -> Array:
    """(cameras,) own time minus common time, up to a constant, from the correlation of onset strengths; good to ~5 ms."""
    step_s = settings.coarse_step_s
    size = scipy.fft.next_fast_len(2 * max(len(strength) for strength in strengths), real=True)
    spectra = [scipy.fft.rfft(strength, size) for strength in strengths]
    n = len(sounds)
    differences = np.full((n, n), np.nan)
    for i in range(n):
        differences[i, i] = 0.0
        for j in range(i + 1, n):
            correlation = scipy.fft.irfft(spectra[j] * spectra[i].conj(), size)
            if correlation.max() <= 1e-6:
                continue
            lag = int(correlation.argmax())
            lag_s = (lag if lag < size // 2 else lag - size) * step_s
            differences[i, j] = lag_s + sounds[j].start_s - sounds[i].start_s
            differences[j, i] = -differences[i, j]
    return from_pair_medians(differences)


def _coarse_strength(jump_db: Array, loud: NDArray[np.bool_], step: int, rate_hz: int, settings: SyncSettings) -> Array:
    """Onset strength above half the threshold at coarse steps: the largest in each step, spread over its neighbours."""
    strong = loud * np.maximum(np.minimum(jump_db, STRONGEST_DB) - settings.onset_jump_db / 2, 0)
    # by the times of the fine steps, which are whole samples, so that rates that do not divide do not creep
    coarse = (np.arange(len(strong)) * step / rate_hz / settings.coarse_step_s).astype(int)
    steps = np.zeros(int(coarse[-1]) + 1 if len(coarse) else 1)
    np.maximum.at(steps, coarse, strong)
    return np.convolve(steps, [0.5, 1.0, 0.5], mode="same")


@dataclass(frozen=True)
class _Heard:
    """An onset of one camera on the coarse common clock."""

    common_s: float
    camera: int
    onset: Onset


def _strongest(near: list[_Heard]) -> list[_Heard]:
    """Per camera its strongest onset."""
    best: dict[int, _Heard] = {}
    for heard in near:
        if heard.camera not in best or heard.onset.strength_db > best[heard.camera].onset.strength_db:
            best[heard.camera] = heard
    return list(best.values())


def _score(cluster: list[_Heard]) -> float:
    return sum(heard.onset.strength_db for heard in cluster)


def _event(cluster: list[_Heard], shifts: Array) -> Event:
    own_s = shifts + float(np.median([heard.common_s for heard in cluster]))
    found = np.zeros(len(shifts), bool)
    for heard in cluster:
        own_s[heard.camera], found[heard.camera] = heard.onset.time_s, True
    return Event(own_s, found, _score(cluster))
