"""Audio features of visual frames: the paper's filter and source windows, and a pooled set beside them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.recordings.audio import read_audio
from headcap.speech.articulation import articulation_features, cosines
from headcap.speech.framing import CONTEXT_FRAMES, CONTEXT_SAMPLES, FRAME_SAMPLES, RATE_HZ, frame_starts
from headcap.speech.level import check_samples, speech_level
from headcap.speech.lpc import linear_prediction
from headcap.speech.pitch import PitchTrack, speaker_pitch, track_pitch
from headcap.speech.settings import FeatureSettings, PitchSettings

_FRAMES_AT_A_TIME = 16384  # what is computed on the way is ten times what is kept
_PAUSE_BELOW_SPEECH, _SILENCE_BELOW_SPEECH = 10 ** (-30 / 20), 10 ** (-20 / 20)


class FeatureSet(StrEnum):
    """Which windows a regressor sees."""

    PAPER = "paper"
    """64 frames of the filter (2048) and of the source (192), eq. 21 to 23."""
    POOLED = "pooled"
    """Cosine courses over the 64 frames: of articulation features (50) for phi, and of these beside loudness, pitch and voicing
    (4) for the larynx, which a speaker also lowers for rounded vowels and raises for spread ones (Hoole and Kroos 1998)."""


@dataclass(frozen=True)
class Speaker:
    """What a voice is measured against."""

    level: float
    """Root mean square of its active speech, full scale 1."""
    pitch_hz: float
    """Its median pitch."""


@dataclass(frozen=True)
class SpeechFeatures:
    """Features of n visual frames. Audio frames that visual frames share are held once, so windows cost no memory."""

    filters: NDArray[np.float32]
    """(u, 32) filter a of each audio frame."""
    sources: NDArray[np.float32]
    """(u, 3) source b: gain in units of active speech's rms, pitch with 80 to 350 Hz as 0 to 1, voiced 1 or 0."""
    articulation: NDArray[np.float32]
    """(u, 50), see `articulation_features`."""
    prosody: NDArray[np.float32]
    """(u, 4): log of gain and of rms above the pause, octaves of pitch above the speaker's (0 unvoiced), voiced 1 or 0."""
    windows: NDArray[np.int64]
    """(n, 64) audio frames of each visual frame."""
    settings: FeatureSettings
    """How they were made."""
    first: int = 0
    """Number of the first visual frame."""

    def __len__(self) -> int:
        return len(self.windows)

    @property
    def voiced_share(self) -> float:
        """Share of the audio frames that are voiced; 0 for silence and whispering, where only loudness drives the larynx."""
        return float(self.sources[:, 2].mean()) if len(self.sources) else 0.0

    def filter_windows(self, feature_set: FeatureSet = FeatureSet.PAPER) -> NDArray[np.float32]:
        """What the speech coefficients are regressed from: abar of eq. 21 (n, 2048), or pooled (n, 50 orders)."""
        if feature_set is FeatureSet.PAPER:
            return _rows(self.filters[self.windows])
        return self._pooled(self.articulation)

    def source_windows(self, feature_set: FeatureSet = FeatureSet.PAPER) -> NDArray[np.float32]:
        """What the larynx is regressed from: bbar of eq. 22 and 23 (n, 192), or pooled (n, 54 orders)."""
        if feature_set is FeatureSet.PAPER:
            return _rows(self.sources[self.windows])
        return np.hstack([self._pooled(self.prosody), self._pooled(self.articulation)])

    @property
    def pauses(self) -> NDArray[np.bool_]:
        """(n,) visual frames that hear a pause: 20 dB below active speech all over the middle half of their window, 0.26 s."""
        quiet = np.log1p((_SILENCE_BELOW_SPEECH / _PAUSE_BELOW_SPEECH) ** 2)
        middle = slice(CONTEXT_FRAMES // 4, CONTEXT_FRAMES - CONTEXT_FRAMES // 4)
        return (self.prosody[:, 1] < quiet)[self.windows[:, middle]].all(axis=1)

    def blocks(self, frames: int = 1024) -> Iterator[SpeechFeatures]:
        """The same features in parts of so many visual frames, for windows that would not fit memory at once."""
        for start in range(0, len(self), frames):
            yield replace(self, windows=self.windows[start : start + frames], first=self.first + start)

    def _pooled(self, frames: NDArray[np.float32]) -> NDArray[np.float32]:
        table = cosines(self.settings.pooled_orders, CONTEXT_FRAMES).astype(np.float32)
        return _rows(np.matmul(table, frames[self.windows]))


def _rows(values: NDArray) -> NDArray:
    return values.reshape(len(values), int(np.prod(values.shape[1:])))


def read_speech(path: Path | str) -> tuple[NDArray[np.float32], float]:
    """Sound of any file that PyAV reads as (mono samples (n,) at 16 kHz, own time of the first sample in seconds).

    Any rate and channel layout: channels are averaged, the rate is changed without delay. Raises `InputError` as
    `headcap.recordings.audio.read_audio`.
    """
    samples, _, start_s = read_audio(path, rate_hz=RATE_HZ)
    return check_samples(samples), start_s


def speech_features(
    samples: NDArray,
    centres: NDArray[np.int64],
    settings: FeatureSettings | None = None,
    level: float | None = None,
    pitch_hz: float | None = None,
) -> SpeechFeatures:
    """Features of visual frames centred on samples number `centres` (n,) of a recording (m,) at 16 kHz.

    `centres` come from `visual_centres` or `centres_at`; around the recording is silence. `level` is the rms of active speech
    in units of the samples and `pitch_hz` the speaker's median pitch; both are measured where None, so a recording's volume does
    not matter, nor, to pooled features, how low a voice is: a larynx moves with its own pitch. Paper sections 6.1 and 7.
    Raises `InputError` for sound shorter than one window of 520 ms, samples that are no numbers, or frames none of which
    hears any sound.
    """
    settings = settings or FeatureSettings()
    samples = check_length(check_samples(samples))
    starts = frame_starts(centres)
    if len(starts) == 0 or starts.min() >= len(samples) or starts.max() + FRAME_SAMPLES <= 0:
        raise InputError(
            f"none of {len(starts)} visual frames lies in {len(samples) / RATE_HZ:.2f} s of sound",
            expected="a take with its own sound",
            remedy="Give the moment of the first visual frame on the sound's clock",
        )
    level = speech_level(samples) if level is None else level
    unique, windows = np.unique(starts, return_inverse=True)
    pitch = track_pitch(samples, settings.pitch, level)
    speaker = Speaker(level, speaker_pitch(pitch) if pitch_hz is None else pitch_hz)
    frames = frame_features(samples, unique, pitch, settings.pitch, speaker)
    return SpeechFeatures(*frames, windows.reshape(starts.shape), settings)


def check_length(samples: NDArray) -> NDArray:
    """The samples; raises `InputError` where they are shorter than a visual frame's window."""
    if len(samples) < CONTEXT_SAMPLES:
        raise InputError(
            f"{len(samples) / RATE_HZ:.3f} s of sound",
            expected=f"at least {CONTEXT_SAMPLES / RATE_HZ:.3f} s, one visual frame's window",
            remedy="Record on, or pad the sound with silence",
        )
    return samples


def frame_features(
    samples: NDArray, starts: NDArray[np.int64], pitch: PitchTrack, settings: PitchSettings, speaker: Speaker, offset: int = 0
) -> tuple[NDArray[np.float32], ...]:
    """Filters (u, 32), sources (u, 3), articulation (u, 50) and prosody (u, 4) of audio frames that begin at `starts` (u,).

    The first of `samples` has number `offset`. An unvoiced frame has pitch 0 and voiced 0 (paper section 7, audio feature).
    """
    samples = np.ascontiguousarray(samples, np.float64)  # once, and not for each part
    parts = [starts[k : k + _FRAMES_AT_A_TIME] for k in range(0, max(len(starts), 1), _FRAMES_AT_A_TIME)]
    found = [_frame_features(samples, part, pitch, settings, speaker, offset) for part in parts]
    return tuple(np.concatenate(arrays) for arrays in zip(*found, strict=True))


def _frame_features(
    samples: NDArray, starts: NDArray[np.int64], pitch: PitchTrack, settings: PitchSettings, speaker: Speaker, offset: int
) -> tuple[NDArray[np.float32], ...]:
    prediction = linear_prediction(samples, starts, offset)
    pitch_hz = pitch.at(starts + FRAME_SAMPLES // 2)
    voiced = pitch_hz > 0
    low, high, level = settings.lowest_hz, settings.highest_hz, speaker.level
    linear = np.clip((pitch_hz - low) / (high - low), 0, 1)
    octaves = np.where(voiced, np.log2(np.clip(pitch_hz, low, high) / speaker.pitch_hz), 0.0)
    loudness = (np.log1p((value / (level * _PAUSE_BELOW_SPEECH)) ** 2) for value in (prediction.gain, np.sqrt(prediction.power)))
    sources = np.column_stack([prediction.gain / level, linear, voiced])
    prosody = np.column_stack([*loudness, octaves, voiced])
    return (
        prediction.filters.astype(np.float32),
        sources.astype(np.float32),
        articulation_features(prediction, level),
        prosody.astype(np.float32),
    )
