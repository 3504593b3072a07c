"""The sound of a take: which camera heard the voice best, and when its samples were spoken on the take's common clock."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_arrays, save_arrays
from headcap.errors import InputError
from headcap.recordings.probe import Recording
from headcap.recordings.takes import IngestedTake
from headcap.speech.features import SpeechFeatures, read_speech, speech_features
from headcap.speech.framing import CONTEXT_SAMPLES, FRAME_SAMPLES, RATE_HZ, centres_at
from headcap.speech.settings import FeatureSettings
from headcap.sync.offsets import TimeOffsets

KIND, SCHEMA = "take_sound", 1

_FULL_SCALE, _CLIPPED_SHARE = 0.999, 1e-3
_FAINTEST_POWER = (0.5 / 32768) ** 2  # half a step of 16 bit: digital silence is no better than that


@dataclass(frozen=True, eq=False)
class TakeSound:
    """What one microphone heard of a take; all that is needed of its recording from here on."""

    person: str
    take: str
    camera: str
    """Whose microphone."""
    samples: NDArray[np.float32]
    """(n,) at 16 kHz, full scale 1."""
    first_sample_s: float = 0.0
    """When pictures show, on the take's common clock, what the first sample holds."""
    drift_ppm: float = 0.0
    """By how much more time passes on the common clock than on the sound's own."""
    clarity_db: float = 0.0
    """Loud over quiet moments, see `clarity_db`."""

    def sound_time_s(self, common_time_s: NDArray) -> NDArray[np.float64]:
        """Moments of the common clock, at which pictures show what is said, on the sound's clock: 0 at its first sample.

        The clap's time of flight is off the offsets already, and a mouth is about as far from the cameras as a clapper is: what
        is left is below the 8 ms by which audio frames step.
        """
        return (np.asarray(common_time_s, float) - self.first_sample_s) / (1 + 1e-6 * self.drift_ppm)

    def covers(self, common_time_s: NDArray) -> NDArray[np.bool_]:
        """(n,) moments of the common clock at which the microphone was recording; elsewhere there is nothing to learn from."""
        at = centres_at(self.sound_time_s(common_time_s))
        return (at >= 0) & (at < len(self.samples))

    def features(self, common_time_s: NDArray, settings: FeatureSettings | None = None) -> SpeechFeatures:
        """Features of visual frames at moments (n,) of the common clock; raises `InputError` as `speech_features`."""
        try:
            return speech_features(self.samples, centres_at(self.sound_time_s(common_time_s)), settings)
        except InputError as error:
            raise InputError(
                f"{self.person} {self.take}, {self.camera}: {error.found}", expected=error.expected, remedy=error.remedy
            ) from error

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.take_sound/1`."""
        meta = {name: value for name, value in vars(self).items() if name != "samples"}
        save_arrays(path, KIND, SCHEMA, {"samples": np.asarray(self.samples, np.float32)}, meta | {"rate_hz": RATE_HZ})

    @classmethod
    def load(cls, path: Path | str) -> TakeSound:
        """Read what `save` wrote; raises `ArtifactError`."""
        arrays, meta = load_arrays(path, KIND, SCHEMA)
        del meta["rate_hz"]
        return cls(samples=arrays["samples"], **meta)


def recorded_sound(person: str, take: str, path: Path | str) -> TakeSound:
    """The sound of one recording whose clock is that of the take's frames; raises `InputError` as `read_speech`."""
    samples, start_s = read_speech(path)
    return TakeSound(person, take, Path(path).stem, samples, first_sample_s=start_s, clarity_db=clarity_db(samples))


def clearest_sound(
    person: str,
    take: IngestedTake,
    offsets: TimeOffsets,
    common_time_s: NDArray,
    av_offset_s: Mapping[str, float] | None = None,
) -> TakeSound:
    """The sound of the camera in which the voice stands out most during moments (n,) of the common clock.

    Each camera has its own microphone, distance and gain; the voice's height over the room's noise is what features lose by, so
    the camera of the largest `clarity_db` is taken, and one whose sound is clipped only where all are. The camera that frames are
    numbered by (`TakeTimeline.reference_camera`) is merely the one that started last. One camera, and no mean of all: arrivals
    differ by milliseconds, and their sum would comb the spectrum. `av_offset_s` as `sync` uses it, per camera. Raises
    `InputError` where no camera has sound of the take.
    """
    heard = _best(_sounds(person, take, offsets, np.asarray(common_time_s, float), av_offset_s or {}))
    if heard is None:
        raise InputError(
            f"{take.take}: no camera has sound of its frames",
            expected="one recording with sound, for a take of kind speech",
            remedy="Switch a microphone on; a session without sound sets `train_speech: null`",
        )
    return heard


def _sounds(
    person: str, take: IngestedTake, offsets: TimeOffsets, time_s: NDArray, av_offset_s: Mapping[str, float]
) -> Iterable[tuple[bool, TakeSound]]:
    """Whether it is free of clipping, and the sound of each camera that has any during the moments; held one at a time."""
    for recording in take.recordings:
        if recording.audio_rate_hz is None or recording.camera not in offsets.cameras:
            continue
        sound = _of_camera(person, recording, offsets, float(av_offset_s.get(recording.camera, 0.0)))
        first, last = centres_at(sound.sound_time_s(time_s[[0, -1]])) + np.array([-1, 1]) * (CONTEXT_SAMPLES // 2)
        spoken = sound.samples[max(first, 0) : max(last, 0)]
        if len(spoken) < CONTEXT_SAMPLES // 2:
            continue
        clean = float((np.abs(spoken) >= _FULL_SCALE).mean()) <= _CLIPPED_SHARE
        yield clean, replace(sound, clarity_db=clarity_db(spoken))


def _of_camera(person: str, recording: Recording, offsets: TimeOffsets, av_offset_s: float) -> TakeSound:
    """A camera's whole sound; its pictures are `av_offset_s` later on the common clock than its sound says."""
    samples, start_s = read_speech(recording.path)
    first_sample_s = float(offsets.common_time(recording.camera, np.array(start_s))) - av_offset_s
    drift_ppm = offsets.drift_ppm[offsets.cameras.index(recording.camera)]
    return TakeSound(person, offsets.take, recording.camera, samples, first_sample_s, float(drift_ppm))


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
