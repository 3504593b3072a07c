"""The clearest of a take's sounds, and the moments of pictures on it."""

import numpy as np
import pytest
from scipy.io import wavfile

from headcap.artifacts import ArtifactError, save_arrays
from headcap.errors import InputError
from headcap.recordings.probe import Recording
from headcap.recordings.takes import IngestedTake
from headcap.speech import RATE_HZ, speech_features
from headcap.speech.framing import centres_at
from headcap.speech.take_sound import TakeSound, clarity_db, clearest_sound
from headcap.sync.offsets import TimeOffsets

MOMENTS_S = 1.0 + np.arange(60) / 30


def _take(folder, sounds: dict[str, np.ndarray | None], start_s, drift_ppm=None):
    recordings = []
    for camera, samples in sounds.items():
        path = folder / f"{camera}.wav"
        if samples is not None:
            wavfile.write(path, RATE_HZ, np.round(32767 * np.clip(samples, -1, 1)).astype(np.int16))
        recordings.append(Recording(camera, path, 8, 8, 30.0, (0.0,), 0, None if samples is None else RATE_HZ))
    n = len(sounds)
    offsets = TimeOffsets("talk", tuple(sounds), tuple(start_s), tuple(drift_ppm or (0.0,) * n), (1.0,) * n, ("clap",) * n)
    return IngestedTake("talk", "speech", tuple(recordings)), offsets


def test_the_camera_that_hears_the_voice_over_the_least_noise_is_taken(tmp_path, speech, rng):
    noise = rng.normal(0, 1, len(speech))
    sounds = {"far": 0.2 * speech + 0.02 * noise, "near": 0.1 * speech + 1e-4 * noise, "deaf": None}
    found = clearest_sound("ann", *_take(tmp_path, sounds, (-0.2, -0.1, 0.0)), MOMENTS_S)
    assert found.camera == "near"
    # of the two seconds that the pictures show, with a window's half around them
    assert found.clarity_db == pytest.approx(clarity_db(sounds["near"][17600 - 4160 : 17600 + 31467 + 4160]), abs=1.0)


def test_clipped_sound_is_taken_only_where_all_is_clipped(tmp_path, speech, rng):
    noise = 1e-3 * rng.normal(0, 1, len(speech))
    sounds = {"clipped": 20 * speech, "clean": 0.5 * speech + noise}
    assert clearest_sound("ann", *_take(tmp_path, sounds, (0.0, 0.0)), MOMENTS_S).camera == "clean"
    assert clearest_sound("ann", *_take(tmp_path, {"clipped": 20 * speech}, (0.0,)), MOMENTS_S).camera == "clipped"


def test_pictures_hear_what_was_said_when_they_were_taken(tmp_path, speech):
    """A camera that started 0.3 s before the common zero, runs 200 ppm fast and whose pictures lag its sound by 40 ms."""
    take, offsets = _take(tmp_path, {"one": 0.5 * speech}, (-0.3,), (200.0,))
    found = clearest_sound("ann", take, offsets, MOMENTS_S, {"one": 0.04})
    spoken_s = (MOMENTS_S + 0.3 + 0.04) / (1 + 200e-6)
    np.testing.assert_allclose(found.sound_time_s(MOMENTS_S), spoken_s, atol=1e-12)
    direct = speech_features(found.samples, centres_at(spoken_s))
    np.testing.assert_array_equal(found.features(MOMENTS_S).filters, direct.filters)


def test_a_sound_returns_as_it_was_saved(tmp_path, speech):
    """Its features to the bit: what a stage reads is what another heard."""
    take, offsets = _take(tmp_path, {"one": 0.5 * speech}, (-0.3,), (200.0,))
    found = clearest_sound("ann", take, offsets, MOMENTS_S, {"one": 0.04})
    found.save(tmp_path / "talk.npz")
    read = TakeSound.load(tmp_path / "talk.npz")
    assert (read.person, read.take, read.camera) == ("ann", "talk", "one")
    assert read.clarity_db == found.clarity_db
    np.testing.assert_array_equal(read.features(MOMENTS_S).articulation, found.features(MOMENTS_S).articulation)


def test_another_kind_or_version_of_file_is_refused(tmp_path):
    save_arrays(tmp_path / "a.npz", "take_sound", 2, {"samples": np.zeros(3)}, {})
    with pytest.raises(ArtifactError, match=r"take_sound/2, expected headcap\.take_sound/1"):
        TakeSound.load(tmp_path / "a.npz")


def test_moments_outside_of_the_recording_are_told(speech):
    """Recorded from 0.5 s on, for as long as it is."""
    sound = TakeSound("ann", "talk", "one", speech, first_sample_s=0.5)
    seconds = len(speech) / RATE_HZ
    assert sound.covers(np.array([0.0, 0.49, 0.5, 2.0, 0.49 + seconds, 0.51 + seconds])).tolist() == [0, 0, 1, 1, 1, 0]


def test_clarity_is_free_of_volume_and_falls_with_noise(speech, rng):
    noise = rng.normal(0, 1, len(speech))
    clear, loud, noisy = (clarity_db(s) for s in (speech + 1e-3 * noise, 2 * (speech + 1e-3 * noise), speech + 0.05 * noise))
    assert loud == pytest.approx(clear, abs=1e-9)
    assert noisy < clear - 10
    assert clarity_db(np.zeros(16000)) == 0


def test_a_take_without_sound_of_its_frames_is_refused(tmp_path, speech):
    with pytest.raises(InputError, match=r"talk: no camera has sound.*train_speech: null"):
        clearest_sound("ann", *_take(tmp_path, {"deaf": None}, (0.0,)), MOMENTS_S)
    with pytest.raises(InputError, match="no camera has sound of its frames"):
        clearest_sound("ann", *_take(tmp_path, {"one": speech}, (100.0,)), MOMENTS_S)
