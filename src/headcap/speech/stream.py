"""Audio features of visual frames while the sound is still growing."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from headcap.speech.features import Speaker, SpeechFeatures, check_length, frame_features
from headcap.speech.framing import (
    CONTEXT_SAMPLES,
    FRAME_SAMPLES,
    HOP_SAMPLES,
    RATE_HZ,
    frame_starts,
    visual_centres,
)
from headcap.speech.level import NOMINAL_LEVEL, check_samples
from headcap.speech.pitch import NOMINAL_PITCH_HZ, PitchStream, PitchTrack
from headcap.speech.settings import FeatureSettings

# from a visual frame's centre to the middle of its last audio frame
_LAST_FRAME_CENTRE = CONTEXT_SAMPLES // 2 - FRAME_SAMPLES // 2


class FeatureStream:
    """Features of new visual frames from sound as it comes, the same as `speech_features` gives of the whole.

    A visual frame is ready about 0.37 s after its moment: half its window, and what pitch looks ahead. Nothing is computed
    twice and memory does not grow. Sound is mono at 16 kHz; `level` is the rms of active speech in its units, as
    `speech_level` measures it on an earlier recording of the same microphone, and `pitch_hz` the speaker's median pitch, as
    `speaker_pitch` finds it. `start_s` is the moment of visual frame 0 on the sound's clock.
    """

    def __init__(
        self,
        fps: float,
        settings: FeatureSettings | None = None,
        *,
        level: float = NOMINAL_LEVEL,
        pitch_hz: float = NOMINAL_PITCH_HZ,
        start_s: float = 0.0,
    ) -> None:
        self._fps, self._start_s, self._speaker = fps, start_s, Speaker(level, pitch_hz)
        self._settings = settings or FeatureSettings()
        self._pitch_stream = PitchStream(self._settings.pitch, level)
        self._pitch = PitchTrack(np.zeros(0))
        self._samples, self._offset, self._received = np.zeros(0), 0, 0
        self._next = 0
        # audio frames that the next visual frame shares with the ones before it
        self._starts = np.zeros(0, np.int64)
        self._frames = frame_features(self._samples, self._starts, self._pitch, self._settings.pitch, self._speaker)

    def push(self, samples: NDArray) -> SpeechFeatures:
        """Take the next samples (n,) and return the visual frames that they complete, often none.

        Raises `InputError` for samples that are no numbers.
        """
        samples = check_samples(samples)
        self._samples = np.concatenate([self._samples, samples])
        self._received += len(samples)
        self._extend(self._pitch_stream.push(samples))
        decided = (self._pitch.first + len(self._pitch.pitch_hz) - 1) * HOP_SAMPLES
        return self._emit(min(self._received - CONTEXT_SAMPLES // 2, decided - 1 - _LAST_FRAME_CENTRE))

    def finish(self) -> SpeechFeatures:
        """The remaining visual frames, those with a moment inside the sound; silence follows it.

        Raises `InputError` where all sound was shorter than one window of 520 ms.
        """
        check_length(np.empty(self._received, np.bool_))
        self._extend(self._pitch_stream.finish())
        return self._emit(self._received - 1)

    def _extend(self, decided: PitchTrack) -> None:
        self._pitch = PitchTrack(np.concatenate([self._pitch.pitch_hz, decided.pitch_hz]), self._pitch.first)

    def _emit(self, last_centre: int) -> SpeechFeatures:
        """Visual frames with centres up to `last_centre`."""
        first, most = self._next, math.ceil(max(last_centre / RATE_HZ - self._start_s, 0) * self._fps) + 2
        centres = visual_centres(max(most - first, 0), self._fps, start_s=self._start_s, first=first)
        wanted = frame_starts(centres[centres <= last_centre])
        unique, windows = np.unique(wanted, return_inverse=True)
        self._compute(np.setdiff1d(unique, self._starts, assume_unique=True))
        chosen = np.searchsorted(self._starts, unique)
        parts = (part[chosen] for part in self._frames)
        self._next += len(wanted)
        found = SpeechFeatures(*parts, windows.reshape(wanted.shape), self._settings, first)
        self._forget()
        return found

    def _compute(self, starts: NDArray[np.int64]) -> None:
        """Add audio frames to the held ones, in order of their beginnings."""
        settings = self._settings.pitch
        fresh = frame_features(self._samples, starts, self._pitch, settings, self._speaker, self._offset)
        starts = np.concatenate([self._starts, starts])
        order = np.argsort(starts)
        self._starts = starts[order]
        self._frames = tuple(np.concatenate(both)[order] for both in zip(self._frames, fresh, strict=True))

    def _forget(self) -> None:
        """Drop what no later visual frame sees."""
        first = int(frame_starts(visual_centres(1, self._fps, start_s=self._start_s, first=self._next))[0, 0])
        kept = self._starts >= first
        self._starts, self._frames = self._starts[kept], tuple(part[kept] for part in self._frames)
        drop = min(max(first - self._offset, 0), len(self._samples))
        self._samples, self._offset = self._samples[drop:], self._offset + drop
        step = min(max(first // HOP_SAMPLES - self._pitch.first, 0), len(self._pitch.pitch_hz))
        self._pitch = PitchTrack(self._pitch.pitch_hz[step:], self._pitch.first + step)
