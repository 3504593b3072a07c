import numpy as np
import pytest

from headcap.synthetic.articulation import ONSET_S, speak
from headcap.synthetic.rig import build_clocks, build_rig
from headcap.synthetic.settings import ArcSettings, ClockSettings, RehearsalSettings, SoundSettings
from headcap.synthetic.sound import record, take_sources
from headcap.synthetic.voice import synthesise


def _delay_samples(heard, reference):
    """Lag of `heard` behind `reference` by cross-correlation, to a fraction of a sample."""
    size = 1 << int(np.ceil(np.log2(2 * len(heard))))
    padded = 16 * size
    cross = np.fft.rfft(heard, size) * np.conj(np.fft.rfft(reference, size))
    correlation = np.fft.irfft(cross, padded)  # zero-padding the spectrum samples the correlation 16 times as densely
    peak = int(np.argmax(correlation))
    before, at, after = correlation[peak - 1], correlation[peak], correlation[(peak + 1) % padded]
    lag = peak + 0.5 * (before - after) / (before - 2 * at + after)
    return (lag - padded if lag > padded / 2 else lag) / 16


def test_each_camera_hears_the_clap_at_its_distance_and_on_its_clock():
    settings = RehearsalSettings(
        arc=ArcSettings(cameras=6), sound=SoundSettings(echoes=0, noise=0.0005), clock=ClockSettings(drift_ppm_sigma=40)
    )
    rig, rate = build_rig(settings), settings.sound.rate_hz
    clocks = build_clocks(settings, 1, 24, rig.names)
    sources = take_sources(settings, 1, 0.8, None, np.zeros(3))
    heard = [
        record(settings, sources, clock, camera.centre, 24000, (1, c))
        for c, (clock, camera) in enumerate(zip(clocks, rig, strict=True))
    ]
    clapper, clap_s = np.array(settings.sound.clap_position_m), settings.sound.clap_time_s
    expected = []
    for clock, camera in zip(clocks, rig, strict=True):
        common = clap_s + np.linalg.norm(camera.centre - clapper) / settings.sound.speed_m_s
        expected.append((common - clock.start_s) / (1 + clock.drift_ppm * 1e-6) * rate)
    measured = [_delay_samples(h.astype(float), heard[0].astype(float)) for h in heard]
    # band to 15 kHz, clap 40 dB above the noise: the bound on a delay's deviation is below 0.01 samples; the parabola adds
    # as much. 0.05 samples are a microsecond.
    np.testing.assert_allclose(measured, np.array(expected) - expected[0], atol=0.05)


def test_recording_is_the_same_each_time_and_differs_between_cameras():
    settings = RehearsalSettings()
    rig = build_rig(settings)
    clocks = build_clocks(settings, 1, 24, rig.names)
    sources = take_sources(settings, 1, 0.8, None, np.zeros(3))
    first = record(settings, sources, clocks[0], rig[0].centre, 9600, (1, 0))
    np.testing.assert_array_equal(first, record(settings, sources, clocks[0], rig[0].centre, 9600, (1, 0)))
    assert np.abs(first - record(settings, sources, clocks[0], rig[0].centre, 9600, (1, 1))).max() > 0
    assert np.abs(first).max() <= 1.0


@pytest.mark.parametrize("seed", [0, 3])
def test_voice_has_the_pitch_and_first_formant_of_its_tracks(seed):
    rate, tracks = 16000, speak(np.random.default_rng(seed), 3.0, pitch_hz=120.0)
    sound = synthesise(tracks, np.random.default_rng(1), np.arange(3 * rate) / rate, rate)
    voiced = [t for t in np.arange(0.5, 2.9, 0.05) if tracks.at(np.linspace(t - 0.03, t + 0.03, 7), "voicing").min() > 0.9]
    assert len(voiced) > 5
    for t in voiced:
        window = sound[int((t - 0.03) * rate) : int((t + 0.03) * rate)]
        correlation = np.correlate(window, window, "full")[len(window) :]
        low, high = int(rate / 220), int(rate / 70)
        pitch = rate / (low + 1 + np.argmax(correlation[low:high]))
        ratio = pitch / tracks.at(t, "pitch_hz")[0]
        # a period is about 133 samples; pitch glides by up to 5 % within the window; an octave down is a fair answer too
        assert min(abs(ratio - 1), abs(ratio - 0.5) * 2) < 0.06


def test_nothing_is_said_and_nothing_moves_before_the_onset():
    tracks = speak(np.random.default_rng(2), 1.0, pitch_hz=110.0)
    still = tracks.at(np.linspace(0, ONSET_S, 50), "voicing", "friction", "jaw", "rounding", "closure", "larynx_mm")
    np.testing.assert_allclose(still, 0, atol=1e-9)
