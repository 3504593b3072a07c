import numpy as np
import pytest
from scipy.linalg import solve_toeplitz
from scipy.signal import lfilter

from headcap.speech.lpc import LPC_ORDER, QUANTISATION_VARIANCE, WHITE_NOISE_CORRECTION, linear_prediction

_WINDOW = 0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(256) + 0.5) / 256)


def _autocorrelation(frame):
    frame = (frame - frame.mean()) * _WINDOW
    r = np.array([frame[: 256 - k] @ frame[k:] for k in range(LPC_ORDER + 1)]) / (_WINDOW @ _WINDOW)
    r[0] = r[0] * (1 + WHITE_NOISE_CORRECTION) + QUANTISATION_VARIANCE
    return r


@pytest.fixture
def noisy(speech, rng):
    """Speech over room noise 60 dB below full scale, far above the power that is added for regularity."""
    return speech + rng.normal(0, 1e-3, len(speech))


def test_the_filter_solves_the_normal_equations_and_the_gain_is_what_they_leave(noisy):
    starts = np.arange(8000, 40000, 977)
    found = linear_prediction(noisy, starts)
    for k, start in enumerate(starts):
        r = _autocorrelation(noisy[start : start + 256])
        np.testing.assert_allclose(found.filters[k], solve_toeplitz(r[:-1], -r[1:]), rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(found.gain[k] ** 2, r[0] + found.filters[k] @ r[1:], rtol=1e-6)


def test_an_all_pole_process_gives_its_filter_back(rng):
    truth = np.poly([0.9 * np.exp(0.4j), 0.9 * np.exp(-0.4j), 0.7 * np.exp(1.9j), 0.7 * np.exp(-1.9j)]).real
    sound = lfilter([0.1], truth, rng.normal(0, 1, 256 * 800))
    found = linear_prediction(sound, np.arange(0, len(sound) - 255, 128))
    filters = np.pad(truth[1:], (0, LPC_ORDER - 4))
    # 1,600 frames of about 96 effective samples: deviation of a mean coefficient 1 / sqrt(800 * 96) = 0.0036; the window
    # blurs the two resonances by its bandwidth, which moves coefficients by about as much again
    np.testing.assert_allclose(found.filters.mean(axis=0), filters, atol=0.06)
    assert found.gain.mean() == pytest.approx(0.1, rel=0.2)  # 32 of about 96 degrees of freedom are spent on the filter


def test_the_lattice_is_stable_and_says_the_same(speech):
    found = linear_prediction(speech, np.arange(-300, len(speech), 128))
    assert np.abs(found.reflections).max() < 1
    np.testing.assert_allclose(found.filters[:, -1], found.reflections[:, -1], atol=1e-12)
    power = found.power * (1 + WHITE_NOISE_CORRECTION) + QUANTISATION_VARIANCE
    np.testing.assert_allclose(found.gain**2, power * np.prod(1 - found.reflections**2, axis=1), rtol=1e-9)


def test_volume_moves_the_gain_alone_and_an_offset_nothing(noisy):
    starts = np.arange(0, 60000, 512)
    plain, louder = linear_prediction(noisy, starts), linear_prediction(noisy * 1.9, starts)
    # a 16 bit step's power, 1e-10, is all that does not scale: 1e-4 of the noise's; coefficients reach 10
    np.testing.assert_allclose(louder.filters, plain.filters, atol=5e-3)
    np.testing.assert_allclose(louder.gain, 1.9 * plain.gain, rtol=1e-3)
    np.testing.assert_allclose(linear_prediction(noisy + 0.3, starts).filters, plain.filters, atol=1e-6)


def test_silence_has_the_filter_one_and_a_gain_below_sixteen_bit():
    found = linear_prediction(np.zeros(1000), np.array([-500, 0, 900, 5000]))
    np.testing.assert_array_equal(found.filters, 0)
    np.testing.assert_allclose(found.gain, 2**-15 / np.sqrt(12))


def test_numbering_from_an_offset_is_a_matter_of_names(speech):
    np.testing.assert_array_equal(
        linear_prediction(speech[5000:], np.array([7000]), offset=5000).filters,
        linear_prediction(speech, np.array([7000])).filters,
    )
