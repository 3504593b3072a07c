"""Pitch of a voice: the cheapest path through candidates, decided with bounded look-ahead."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.speech.framing import HOP_SAMPLES, RATE_HZ
from headcap.speech.level import NOMINAL_LEVEL, check_samples, speech_level
from headcap.speech.pitch_candidates import PitchCandidates
from headcap.speech.settings import PitchSettings

NOMINAL_PITCH_HZ = 150.0
"""A speaker's pitch where it was not measured: between a man's usual 120 and a woman's 200."""
_COSTS_STEP_S = 0.01  # Boersma 1993 gives costs for steps of this length


@dataclass(frozen=True)
class PitchTrack:
    """Pitch every 8 ms; entry k belongs to sample 128 k."""

    pitch_hz: NDArray[np.float64]
    """(n,) 0 where unvoiced."""
    first: int = 0
    """Number k of the first entry."""

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Moments of the entries (n,)."""
        return (self.first + np.arange(len(self.pitch_hz))) * (HOP_SAMPLES / RATE_HZ)

    def at(self, samples: NDArray[np.int64]) -> NDArray[np.float64]:
        """Pitch at sample numbers (n,), 0 unvoiced: linear in log pitch between voiced entries, else the nearest entry's.

        Before the first entry and behind the last everything is unvoiced.
        """
        place = np.asarray(samples, np.float64) / HOP_SAMPLES - self.first
        known = np.concatenate([self.pitch_hz, np.zeros(2)])
        low = np.clip(np.floor(place), 0, len(self.pitch_hz)).astype(np.int64)
        before, after, share = known[low], known[low + 1], place - low
        with np.errstate(divide="ignore", invalid="ignore"):
            between = np.exp((1 - share) * np.log(before) + share * np.log(after))
        nearest = np.where(share < 0.5, before, after)
        found = np.where((before > 0) & (after > 0), between, nearest)
        return np.where((place >= 0) & (place < len(self.pitch_hz)), found, 0.0)


def track_pitch(samples: NDArray, settings: PitchSettings | None = None, level: float | None = None) -> PitchTrack:
    """Pitch of a whole recording, samples (n,) at 16 kHz; `level` as `PitchStream` takes it, measured where None.

    The same as a `PitchStream` gives of the same samples in any portions. Paper section 7: 80 to 350 Hz, autocorrelation.
    Raises `InputError` for samples that are not mono or not finite.
    """
    stream = PitchStream(settings, speech_level(samples) if level is None else level)
    found = (stream.push(samples), stream.finish())
    return PitchTrack(np.concatenate([part.pitch_hz for part in found]))


def speaker_pitch(track: PitchTrack) -> float:
    """Median pitch of what is voiced, hertz; `NOMINAL_PITCH_HZ` where nothing is."""
    voiced = track.pitch_hz[track.pitch_hz > 0]
    return float(np.median(voiced)) if len(voiced) else NOMINAL_PITCH_HZ


class PitchStream:
    """Pitch of sound as it comes, decided `lookahead_s` behind it and never changed afterwards.

    Each step sees 40 ms under a Hann window, so it holds at least two periods of 80 Hz. Of the candidates of all steps
    and the unvoiced state the best path is taken (Viterbi): strengths summed, less the costs of voicing changes and of jumps
    per octave as in Boersma 1993. A step is decided by the best path to the step `lookahead_s` later, in recordings and in
    streams alike. `level` is the rms of active speech in units of the samples (`speech_level`).

    The paper infers pitch from its 16 ms frames by autocorrelation; those cannot hold two periods below 125 Hz.
    """

    def __init__(self, settings: PitchSettings | None = None, level: float = NOMINAL_LEVEL) -> None:
        self._settings = settings = settings or PitchSettings()
        self._candidates = PitchCandidates(settings, level)
        self._lookahead = round(settings.lookahead_s * RATE_HZ / HOP_SAMPLES)
        scale = _COSTS_STEP_S * RATE_HZ / HOP_SAMPLES
        self._costs = settings.octave_jump_cost * scale, settings.voicing_change_cost * scale
        states = settings.candidates + 1
        self._samples, self._offset, self._received = np.zeros(0), 0, 0
        self._analysed, self._decided = 0, 0
        self._scores = np.zeros(states)
        # of the steps that are analysed and not decided, and the last decided one
        self._pitch_hz, self._origins = np.zeros((0, states)), np.zeros((0, states), np.int64)
        self._best = np.zeros(0, np.int64)

    def push(self, samples: NDArray) -> PitchTrack:
        """Take the next samples (n,) and return the entries that they decide; raises `InputError` as `track_pitch`."""
        samples = check_samples(samples)
        self._samples = np.concatenate([self._samples, samples])
        self._received += len(samples)
        self._analyse(max((self._received - self._candidates.reach) // HOP_SAMPLES + 1, self._analysed))
        return self._decide(max(self._analysed - self._lookahead, self._decided))

    def finish(self) -> PitchTrack:
        """The remaining entries; what follows the last sample is silence."""
        self._analyse(max(-(-self._received // HOP_SAMPLES), self._analysed))
        return self._decide(self._analysed)

    def _analyse(self, end: int) -> None:
        """Candidates of the steps before `end`, and the best ways to them."""
        if end > self._analysed:
            centres = np.arange(self._analysed, end) * HOP_SAMPLES - self._offset
            pitch_hz, strength = self._candidates.find(self._samples, centres)
            last = self._pitch_hz[-1] if self._analysed else np.zeros_like(self._scores)
            origins, best = _advance(last, self._scores, pitch_hz, strength, *self._costs)
            self._pitch_hz = np.concatenate([self._pitch_hz, pitch_hz])
            self._origins = np.concatenate([self._origins, origins])
            self._best = np.concatenate([self._best, best])
            self._analysed = end
        keep = max(self._analysed * HOP_SAMPLES - self._candidates.reach - self._offset, 0)
        self._samples, self._offset = self._samples[keep:], self._offset + keep

    def _decide(self, end: int) -> PitchTrack:
        """Entries of the steps before `end`."""
        held = self._analysed - len(self._best)
        found = _trace(self._pitch_hz, self._origins, self._best, self._decided - held, end - held, self._lookahead)
        decided = PitchTrack(found, self._decided)
        self._decided = end
        keep = max(min(end, self._analysed - 1) - held, 0)  # the next step continues from the last one
        self._pitch_hz, self._origins, self._best = self._pitch_hz[keep:], self._origins[keep:], self._best[keep:]
        return decided


@njit(cache=True)
def _advance(last_hz, scores, pitch_hz, strength, octave_jump, voicing_change):
    """Best predecessor of each state (n, states) and the best state of each step (n,); `scores` is carried on."""
    n, states = pitch_hz.shape
    origins, best = np.zeros((n, states), np.int64), np.zeros(n, np.int64)
    gained = np.empty(states)
    for step in range(n):
        before = last_hz if step == 0 else pitch_hz[step - 1]
        for state in range(states):
            value, chosen = -np.inf, 0
            for origin in range(states):
                cost = 0.0
                if (before[origin] > 0) != (pitch_hz[step, state] > 0):
                    cost = voicing_change
                elif before[origin] > 0:
                    cost = octave_jump * abs(np.log2(before[origin] / pitch_hz[step, state]))
                if scores[origin] - cost > value:
                    value, chosen = scores[origin] - cost, origin
            gained[state], origins[step, state] = value + strength[step, state], chosen
        scores[:] = gained - gained.max()  # differences alone matter; the sum would grow with the recording
        best[step] = np.argmax(gained)
    return origins, best


@njit(cache=True)
def _trace(pitch_hz, origins, best, first, end, lookahead):
    """Pitch of steps `first` ... `end` - 1, each by the best way to the step `lookahead` later, or to the last one."""
    found = np.zeros(max(end - first, 0))
    for step in range(first, end):
        later = min(step + lookahead, len(best) - 1)
        state = best[later]
        for k in range(later, step, -1):
            state = origins[k, state]
        found[step - first] = pitch_hz[step, state]
    return found
