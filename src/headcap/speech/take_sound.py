"""The sound of a take: which camera heard the voice best, and when its samples were spoken on the take's common clock."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.recordings.takes import IngestedTake
from headcap.speech.features import SpeechFeatures, read_speech, speech_features
from headcap.speech.framing import CONTEXT_SAMPLES, FRAME_SAMPLES, centres_at
from headcap.speech.settings import FeatureSettings
from headcap.sync.offsets import TimeOffsets

_FULL_SCALE, _CLIPPED_SHARE = 0.999, 1e-3
_FAINTEST_POWER = (0.5 / 32768) ** 2  # half a step of 16 bit: digital silence is no better than that


@dataclass(frozen=True, eq=False)
class TakeSound:
    """What one camera heard of a take."""

    take: str
    camera: str
    samples: NDArray[np.float32]
    """(n,) at 16 kHz."""
    start_s: float
    """The camera's own time of the first sample."""
    clarity_db: float
    """Loud over quiet moments, see `clarity_db`."""
    offsets: TimeOffsets
    av_offset_s: float = 0.0
    """By how much the camera's pictures are later on the common clock than its sound says."""

    def sound_time_s(self, common_time_s: NDArray) -> NDArray[np.float64]:
        """Moments of the common clock, at which pictures show what is said, on the sound's clock: 0 at its first sample.

        The clap's time of flight is off the offsets already, and a mouth is about as far from the cameras as a clapper is: what
        is left is below the 8 ms by which audio frames step.
        """
        return self.offsets.own_time(self.camera, np.asarray(common_time_s, float) + self.av_offset_s) - self.start_s

    def features(self, common_time_s: NDArray, settings: FeatureSettings | None = None) -> SpeechFeatures:
        """Features of visual frames at moments (n,) of the common clock; raises `InputError` as `speech_features`."""
        try:
            return speech_features(self.samples, centres_at(self.sound_time_s(common_time_s)), settings)
        except InputError as error:
            raise InputError(
                f"{self.take}, {self.camera}: {error.found}", expected=error.expected, remedy=error.remedy
            ) from error


def clearest_sound(
    take: IngestedTake, offsets: TimeOffsets, common_time_s: NDArray, av_offset_s: Mapping[str, float] | None = None
) -> TakeSound:
    """The sound of the camera in which the voice stands out most during moments (n,) of the common clock.

    Each camera has its own microphone, distance and gain; the voice's height over the room's noise is what features lose by, so
    the camera of the largest `clarity_db` is taken, and one whose sound is clipped only where all are. The camera that frames are
    numbered by (`TakeTimeline.reference_camera`) is merely the one that started last. One camera, and no mean of all: arrivals
    differ by milliseconds, and their sum would comb the spectrum. `av_offset_s` as `sync` uses it, per camera. Raises
    `InputError` where no camera has sound of the take.
    """
    heard = _best(_sounds(take, offsets, np.asarray(common_time_s, float), av_offset_s or {}))
    if heard is None:
        raise InputError(
            f"{take.take}: no camera has sound of its frames",
            expected="one recording with sound, for a take of kind speech",
            remedy="Switch a microphone on; a session without sound sets `train_speech: null`",
        )
    return heard


def _sounds(
    take: IngestedTake, offsets: TimeOffsets, time_s: NDArray, av_offset_s: Mapping[str, float]
) -> Iterable[tuple[bool, TakeSound]]:
    """Whether it is free of clipping, and the sound of each camera that has any during the moments; held one at a time."""
    for recording in take.recordings:
        if recording.audio_rate_hz is None or recording.camera not in offsets.cameras:
            continue
        samples, start_s = read_speech(recording.path)
        sound = TakeSound(
            take.take, recording.camera, samples, start_s, 0.0, offsets, float(av_offset_s.get(recording.camera, 0.0))
        )
        first, last = centres_at(sound.sound_time_s(time_s[[0, -1]])) + np.array([-1, 1]) * (CONTEXT_SAMPLES // 2)
        spoken = samples[max(first, 0) : max(last, 0)]
        if len(spoken) < CONTEXT_SAMPLES // 2:
            continue
        clean = float((np.abs(spoken) >= _FULL_SCALE).mean()) <= _CLIPPED_SHARE
        yield clean, replace(sound, clarity_db=clarity_db(spoken))


def _best(found: Iterable[tuple[bool, TakeSound]]) -> TakeSound | None:
    best = None
    for clean, sound in found:
        if best is None or (clean, sound.clarity_db) > (best[0], best[1].clarity_db):
            best = (clean, sound)
    return best and best[1]


def clarity_db(samples: NDArray) -> float:
    """Power of the loud over the quiet 16 ms frames of samples (n,), 95th over 5th percentile, dB.

    Speech has pauses and closures of more than a twentieth of its time: what is heard in them is the room.
    """
    whole = len(samples) // FRAME_SAMPLES * FRAME_SAMPLES
    powers = np.asarray(samples[:whole], float).reshape(-1, FRAME_SAMPLES).var(axis=1)
    loud, quiet = np.quantile(powers, [0.95, 0.05])
    return float(10 * np.log10(max(loud, _FAINTEST_POWER) / max(quiet, _FAINTEST_POWER)))
