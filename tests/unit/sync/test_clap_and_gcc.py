import numpy as np
import pytest

from headcap.errors import InputError
from headcap.recordings.audio import read_audio
from headcap.sync import SyncSettings, align_recordings
from headcap.sync.align import recording_lag
from headcap.sync.clap import find_claps
from headcap.sync.gcc import gcc_phat
from headcap.sync.pairs import from_pair_medians, solve_pairs

RATE = 48000


def test_onsets_are_found_on_the_own_clock(listen, sounds, rng) -> None:
    audio = listen(np.zeros(1), [(sounds["clap"](rng), t, None) for t in (0.2, 0.9, 1.5)], duration_s=2.0)
    samples, rate, _ = audio["cam0"]
    found = find_claps(samples, rate, 10.0)
    # the energy behind an onset is seen over 2 ms
    assert [onset.time_s for onset in found] == pytest.approx([10.2, 10.9, 11.5], abs=0.002)
    assert all(onset.strength_db > 25 for onset in found)


def test_a_clap_soon_after_the_start_is_found(listen, sounds, rng) -> None:
    audio = listen(np.zeros(1), [(sounds["clap"](rng), 0.02, None)])
    (onset,) = find_claps(*audio["cam0"])
    assert onset.time_s == pytest.approx(0.02, abs=0.002)


def test_voices_below_two_kilohertz_and_silence_are_no_claps(sounds, rng) -> None:
    samples = np.zeros(RATE)
    samples[10000:22000] += sounds["cough"](rng)
    assert find_claps(samples + 1e-2 * rng.standard_normal(RATE), RATE, 0.0) == ()
    assert find_claps(np.zeros(RATE), RATE, 0.0) == ()
    assert find_claps(np.zeros(0), RATE, 0.0) == ()


@pytest.mark.parametrize("delay", [0.0, 7.25, -31.6, 140.49])
def test_gcc_phat_finds_fractional_delays(delay, rng) -> None:
    n = 4096
    spectrum = np.fft.rfft(rng.standard_normal(n) * np.hanning(n))
    spectrum[np.fft.rfftfreq(n, 1 / RATE) > 20000] = 0
    first = np.fft.irfft(spectrum, n)
    second = np.fft.irfft(spectrum * np.exp(-2j * np.pi * np.fft.rfftfreq(n) * delay), n)
    found = gcc_phat(first, second, RATE, max_lag_s=0.005, band_hz=(300, 16000))
    # the parabola through an eightfold upsampled peak of a 16 kHz band errs by a few hundredths of an eighth of a sample
    assert found.lag_s * RATE == pytest.approx(delay, abs=0.02)
    assert found.sharpness > 0.7


def test_unlike_sounds_have_a_dull_peak(rng) -> None:
    found = gcc_phat(rng.standard_normal(4096), rng.standard_normal(4096), RATE, max_lag_s=0.005, band_hz=(300, 16000))
    # the largest of 480 values of scatter 1 / sqrt(2 * 2700 frequencies) is about 0.05
    assert found.sharpness < 0.15


def test_pairs_are_solved_in_spite_of_wrong_ones(rng) -> None:
    values = rng.normal(0, 0.1, 10)
    values -= values.mean()
    differences = values[None] - values[:, None] + 1e-6 * rng.standard_normal((10, 10))
    for i, j in [(0, 1), (2, 7), (3, 4), (3, 8), (5, 9), (6, 1), (0, 4), (2, 9)]:
        differences[i, j] += rng.choice([-1, 1]) * rng.uniform(0.001, 0.05)
    differences = np.triu(differences, 1) - np.triu(differences, 1).T
    differences[7, 8] = differences[8, 7] = np.nan
    start = from_pair_medians(differences)
    found = solve_pairs(differences, np.ones((10, 10)), start, 3e-5)
    # 1 us of noise over nine pairs each; the wrong pairs keep (3e-5 / 1e-3)^2 of their weight: 1e-3 * 1e-3 / 9 = 0.1 us
    np.testing.assert_allclose(found, values, atol=3e-6)


def test_whole_recordings_are_aligned_without_a_clap(listen, rng) -> None:
    talk = rng.standard_normal(4 * RATE) * (1 + np.sin(np.arange(4 * RATE) / 3000)) * 0.1
    starts = np.array([0.0, 1.25, 0.4])
    audio = listen(starts, [(talk, 0.5, None)], duration_s=3.0, noise=0.05)
    found = np.array(align_recordings(audio, take="talk").start_s)
    # whole samples at 48 kHz: 0.01 ms
    np.testing.assert_allclose(found - found[0], starts, atol=2e-5)
    audio["cam2"] = (0.1 * rng.standard_normal(3 * RATE).astype(np.float32), RATE, 0.0)
    with pytest.raises(InputError, match="talk: the sound of cam2 has nothing in common with the others"):
        align_recordings(audio, take="talk")


def test_drift_and_flight_are_found_in_a_talk(listen, rng) -> None:
    starts, drift_ppm = np.array([0.0, 0.8, 0.3]), np.array([0.0, 60.0, -40.0])
    centres = {f"cam{c}": np.array([x, 0.0, 1.0]) for c, x in enumerate((0.0, 1.5, -2.5))}
    flight_s = np.array([np.linalg.norm(place) for place in centres.values()]) / SyncSettings().speed_of_sound
    words = [(0.1 * rng.standard_normal(RATE // 4), 0.05 + 0.2 * k, flight_s) for k in range(140)]
    audio = listen(starts, words, duration_s=26.0, noise=0.01, drift_ppm=drift_ppm)
    found = align_recordings(audio, take="talk", camera_centres=centres, source_m=np.zeros(3))
    # 60 ppm smear a window of 2 s over 0.12 ms; its middle is good to a tenth of that, over a lever of 20 s: 0.6 ppm
    np.testing.assert_allclose(found.drift_ppm, drift_ppm - np.median(drift_ppm), atol=0.6)
    # start times are moments at which each clock reads zero, up to 0.8 s before the recordings' middle by 60 ppm of drift
    np.testing.assert_allclose(np.array(found.start_s) - found.start_s[0], starts, atol=5e-5)
    # without places flight stays in: that is all that differs
    heard = align_recordings(audio, take="talk")
    apart = np.array(heard.start_s) - np.array(found.start_s)
    np.testing.assert_allclose(apart - apart[0], -(flight_s - flight_s[0]), atol=1e-6)


@pytest.mark.real
def test_real_hand_claps(test_data) -> None:
    found = [onset.time_s for onset in find_claps(*read_audio(test_data / "sync" / "clap_sample1.wav"))]
    assert found == pytest.approx([2.00, 3.01, 4.00, 4.31], abs=0.010)


@pytest.mark.real
def test_a_real_talk_is_aligned(test_data) -> None:
    first, second, third = (read_audio(test_data / "sync" / f"timbl_{k}.mp3") for k in (1, 2, 3))
    assert recording_lag(first, second, SyncSettings()).into_s == pytest.approx(12.26, abs=0.010)
    assert recording_lag(first, third, SyncSettings()).into_s == pytest.approx(12.24, abs=0.010)
