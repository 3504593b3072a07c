from fractions import Fraction

import av
import numpy as np
import pytest
from scipy.signal import resample_poly

from headcap.errors import InputError
from headcap.speech.features import FeatureSet, read_speech, speech_features
from headcap.speech.framing import RATE_HZ, visual_centres
from headcap.speech.level import speech_level
from headcap.speech.stream import FeatureStream

WINDOWS = [(name, chosen) for name in ("filter_windows", "source_windows") for chosen in FeatureSet]


def _buzz(pitch_hz, seconds=1.0):
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    return 0.05 * sum(np.cos(2 * np.pi * pitch_hz * k * time + k * k) / k for k in range(1, int(7000 / pitch_hz)))


def test_windows_have_the_papers_sizes_and_order(speech):
    features = speech_features(speech, visual_centres(60, 30.0))
    assert features.filter_windows().shape == (60, 2048)
    assert features.source_windows().shape == (60, 192)
    window = features.filter_windows()[40].reshape(64, 32)
    np.testing.assert_array_equal(window[32], features.filters[features.windows[40, 32]])
    assert features.filter_windows(FeatureSet.POOLED).shape == (60, 300)
    assert features.source_windows(FeatureSet.POOLED).shape == (60, 24 + 300)


def test_audio_frames_that_visual_frames_share_are_held_once(speech):
    features = speech_features(speech, visual_centres(100, 25.0))
    assert len(features.filters) == 99 * 5 + 64


@pytest.mark.parametrize(("pitch_hz", "expected"), [(80.0, 0.0), (215.0, 0.5), (350.0, 1.0)])
def test_pitch_is_normalised_and_voiced_tells_80_hz_from_unvoiced(pitch_hz, expected):
    low, high = speech_features(_buzz(pitch_hz), visual_centres(1, 30.0, start_s=0.5)).sources[20:44, 1:].T
    np.testing.assert_allclose(low, expected, atol=2e-3)
    assert (high == 1).all()


def test_volume_does_not_matter(speech, rng):
    sound = speech + rng.normal(0, 1e-2, len(speech))  # louder than a 16 bit step at either volume
    loud, soft = (speech_features(sound * scale, visual_centres(90, 30.0, start_s=0.3)) for scale in (1.0, 0.1))
    for name, chosen in WINDOWS:
        first, second = getattr(loud, name)(chosen), getattr(soft, name)(chosen)
        assert np.abs(first - second).max() <= 2e-3 * np.abs(first).max()


def test_a_clap_does_not_set_the_level(speech):
    clapped = speech.copy()
    clapped[3200:3260] = 5.0
    assert speech_level(clapped) == pytest.approx(speech_level(speech), rel=0.02)


def _write(path, samples, rate, layout, codec):
    """Sound (channels, n) as a file."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate, layout=layout)
        frame = av.AudioFrame.from_ndarray(np.ascontiguousarray(samples, np.float32), format="fltp", layout=layout)
        frame.sample_rate, frame.pts, frame.time_base = rate, 0, Fraction(1, rate)
        fitted = av.AudioResampler(stream.format, layout, rate, frame_size=stream.frame_size or 0)
        for part in [*fitted.resample(frame), *fitted.resample(None)]:
            container.mux(stream.encode(part))
        container.mux(stream.encode(None))


@pytest.mark.parametrize(
    ("name", "rate", "layout", "codec"),
    [
        ("a.wav", 44100, "stereo", "pcm_s16le"),
        ("a.wav", 8000, "mono", "pcm_u8"),
        ("a.wav", 96000, "5.1", "pcm_s24le"),
        ("a.m4a", 48000, "stereo", "aac"),
        ("a.flac", 22050, "mono", "flac"),
    ],
)
def test_any_rate_layout_and_codec_gives_the_same_pitch_and_loudness(voice, tmp_path, name, rate, layout, codec):
    sound, _ = voice(2.0, 140.0)
    ratio = Fraction(rate, RATE_HZ)
    channels = {"mono": 1, "stereo": 2, "5.1": 6}[layout]
    _write(tmp_path / name, np.tile(resample_poly(sound, ratio.numerator, ratio.denominator), (channels, 1)), rate, layout, codec)
    samples, start_s = read_speech(tmp_path / name)
    assert abs(start_s) < 0.03
    centres = visual_centres(40, 30.0, start_s=0.3)
    found = speech_features(samples, centres - round(start_s * RATE_HZ)).sources
    truth = speech_features(sound, centres).sources
    both = (found[:, 2] > 0) & (truth[:, 2] > 0)
    assert (found[:, 2] == truth[:, 2]).mean() > 0.9
    assert np.median(np.abs(found - truth)[both, 1]) < 0.005
    if rate >= RATE_HZ:  # a lower rate has no upper band, and its filter another gain
        assert np.corrcoef(found[:, 0], truth[:, 0])[0, 1] > 0.9


def test_silence_is_no_error():
    features = speech_features(np.zeros(RATE_HZ), visual_centres(30, 30.0))
    assert features.voiced_share == 0
    for name, chosen in WINDOWS:
        values = getattr(features, name)(chosen)
        assert np.isfinite(values).all()
        assert np.abs(values).max() < 5  # the steps of 16 bit over eight frames' sum


def test_too_short_sound_and_sound_of_another_moment_are_refused(speech):
    with pytest.raises(InputError, match=r"0\.500 s of sound; expected at least 0\.520 s"):
        speech_features(np.zeros(8000), visual_centres(10, 30.0))
    with pytest.raises(InputError, match=r"none of 10 visual frames lies in 4\.00 s of sound"):
        speech_features(speech, visual_centres(10, 30.0, start_s=60.0))
    with pytest.raises(InputError, match="no numbers"):
        speech_features(np.full(16000, np.nan), visual_centres(10, 30.0))
    stream = FeatureStream(30.0)
    stream.push(np.zeros(8000))
    with pytest.raises(InputError, match=r"at least 0\.520 s"):
        stream.finish()
    with pytest.raises(InputError, match="no numbers"):
        stream.push(np.array([np.inf]))


@pytest.mark.parametrize("fps", [25.0, 30000 / 1001])
@pytest.mark.parametrize("start_s", [-0.3, 0.0, 0.7])
def test_a_growing_recording_gives_what_the_whole_gives(speech, rng, fps, start_s):
    centres = visual_centres(200, fps, start_s=start_s)
    centres = centres[centres < len(speech)]
    whole = speech_features(speech, centres, level=0.08, pitch_hz=110.0)
    stream, parts, start = FeatureStream(fps, level=0.08, pitch_hz=110.0, start_s=start_s), [], 0
    while start < len(speech):
        size = int(rng.integers(0, 5000))
        parts.append(stream.push(speech[start : start + size]))
        start += size
        newest = parts[-1].first + len(parts[-1])
        late = visual_centres(1, fps, start_s=start_s, first=newest)[0]
        assert late > min(start, len(speech)) - 0.38 * RATE_HZ  # nothing is kept back for longer than it must
        assert len(stream._samples) < 3 * 8320  # nor is more sound kept than three windows
    parts.append(stream.finish())
    for name, chosen in WINDOWS:
        np.testing.assert_array_equal(
            np.concatenate([getattr(part, name)(chosen) for part in parts]), getattr(whole, name)(chosen)
        )
    assert [part.first for part in parts] == np.cumsum([0] + [len(part) for part in parts])[:-1].tolist()


def test_a_lower_voice_that_says_the_same_has_the_same_pooled_prosody(voice):
    """The same intonation an octave and a quarter apart; the filter differs by what harmonics sample of it."""
    centres = visual_centres(110, 30.0)
    low, high = (speech_features(voice(4.0, pitch_hz, seed=5)[0], centres) for pitch_hz in (100.0, 190.0))
    both = (low.prosody[:, 3] > 0) & (high.prosody[:, 3] > 0)
    assert both.mean() > 0.3
    assert np.median(np.abs(low.prosody - high.prosody)[both, 2]) < 0.02
    assert np.median(np.abs(low.sources - high.sources)[both, 1]) > 0.2
    # a voice's own median is where it is measured from
    voiced = low.prosody[:, 3] > 0
    assert abs(np.median(low.prosody[voiced, 2])) < 0.03


def test_pauses_are_heard_through_the_rooms_noise(speech, rng):
    """The voice begins at 0.4 s: frames whose middle 0.26 s ends before that hear the room alone."""
    noisy = speech + 10 ** (-26 / 20) * speech_level(speech) * rng.normal(size=len(speech))
    for sound in (speech, noisy):
        pauses = speech_features(sound, visual_centres(110, 30.0)).pauses
        assert pauses[:8].all()
        assert not pauses[9:].any()


def test_blocks_are_the_same_in_parts(speech):
    features = speech_features(speech, visual_centres(90, 30.0))
    parts = list(features.blocks(32))
    assert [len(part) for part in parts] == [32, 32, 26]
    assert [part.first for part in parts] == [0, 32, 64]
    for name, chosen in WINDOWS:
        joined = np.concatenate([getattr(part, name)(chosen) for part in parts])
        np.testing.assert_array_equal(joined, getattr(features, name)(chosen))
