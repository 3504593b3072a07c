import numpy as np
import pytest

from headcap.errors import InputError
from headcap.speech.framing import HOP_SAMPLES, RATE_HZ
from headcap.speech.level import speech_level
from headcap.speech.pitch import PitchStream, track_pitch
from headcap.speech.settings import PitchSettings


def _buzz(pitch_hz, seconds=0.5):
    """All harmonics below 7 kHz, falling by 6 dB per octave, phases at random."""
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    harmonics = np.arange(1, int(7000 / pitch_hz))
    phases = np.random.default_rng(1).uniform(0, 2 * np.pi, len(harmonics))
    return 0.1 * (np.cos(2 * np.pi * pitch_hz * harmonics[:, None] * time + phases[:, None]) / harmonics[:, None]).sum(0)


@pytest.mark.parametrize("pitch_hz", [80.5, 97.3, 123.4, 200.0, 261.6, 347.0])
def test_a_periodic_sound_has_its_pitch_between_samples(pitch_hz):
    inner = track_pitch(_buzz(pitch_hz)).pitch_hz[5:-5]
    # 0.05 % are 0.1 samples of the shortest period's 46; the parabola on quarter lags leaves less
    np.testing.assert_allclose(inner, pitch_hz, rtol=5e-4)


def _compare(found, truth_hz, voicing):
    sure = (voicing > 0.3) | (voicing < 0.02)
    voiced = voicing > 0.3
    both = voiced & (found > 0)
    return (np.abs(found[both] / truth_hz[both] - 1) > 0.2).mean(), ((found > 0) == voiced)[sure].mean()


@pytest.mark.parametrize("pitch_hz", [95.0, 130.0, 190.0, 260.0])
@pytest.mark.parametrize("damage", ["none", "noise", "clipped", "offset"])
def test_a_synthetic_voice_has_the_pitch_it_was_made_with(voice, pitch_hz, damage, rng):
    sound, tracks = voice(4.0, pitch_hz, seed=round(pitch_hz))
    level = speech_level(sound)
    damages = {
        "none": lambda: sound,
        "noise": lambda: sound + rng.normal(0, level * 10 ** (-20 / 20), len(sound)),
        "clipped": lambda: np.clip(sound, -level, level),
        "offset": lambda: sound + 0.5,
    }
    track = track_pitch(damages[damage]())
    truth = tracks.at(track.time_s, "pitch_hz", "voicing")
    silent = (track.time_s < tracks.time_s[0]) | (track.time_s > tracks.time_s[-1])
    gross, agreement = _compare(track.pitch_hz, truth[:, 0], np.where(silent, 0, truth[:, 1]))
    assert gross <= 0.01
    assert agreement >= 0.92


def test_noise_and_silence_are_unvoiced(rng):
    assert (track_pitch(rng.normal(0, 0.1, 2 * RATE_HZ)).pitch_hz == 0).all()
    assert (track_pitch(np.zeros(RATE_HZ)).pitch_hz == 0).all()


def test_volume_does_not_matter(speech):
    np.testing.assert_allclose(track_pitch(speech * 0.05).pitch_hz, track_pitch(speech).pitch_hz, rtol=1e-4)


@pytest.mark.parametrize("lookahead_s", [0.0, 0.08, 0.5])
def test_portions_give_the_same_as_the_whole_and_memory_stays(speech, lookahead_s, rng):
    settings, level = PitchSettings(lookahead_s=lookahead_s), speech_level(speech)
    stream, parts, start = PitchStream(settings, level), [], 0
    while start < len(speech):
        size = int(rng.integers(0, 4000))
        parts.append(stream.push(speech[start : start + size]))
        start += size
        assert len(stream._samples) < 2 * 1024
        assert len(stream._best) <= lookahead_s * 125 + 2
    parts.append(stream.finish())
    assert [part.first for part in parts] == np.cumsum([0] + [len(part.pitch_hz) for part in parts])[:-1].tolist()
    whole = track_pitch(speech, settings, level)
    np.testing.assert_array_equal(np.concatenate([part.pitch_hz for part in parts]), whole.pitch_hz)
    assert len(whole.pitch_hz) == -(-len(speech) // HOP_SAMPLES)


def test_between_steps_pitch_is_linear_in_octaves_and_does_not_bleed_into_the_unvoiced():
    track = track_pitch(_buzz(100.0))
    np.testing.assert_allclose(track.at(np.arange(1000, 3000, 37)), 100.0, rtol=5e-4)
    assert track.at(np.array([-1, 10**6])).tolist() == [0, 0]


def test_what_is_no_sound_is_refused():
    with pytest.raises(InputError, match="2 of 100 sound samples are no numbers, the first is sample 7"):
        track_pitch(np.where(np.isin(np.arange(100), [7, 50]), np.nan, 0.1))
    with pytest.raises(InputError, match="mono"):
        track_pitch(np.zeros((100, 2)))
    with pytest.raises(InputError, match="samples of type int16"):
        track_pitch(np.zeros(100, np.int16))
