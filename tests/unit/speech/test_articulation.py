import numpy as np
from scipy.fft import dct, irfft

from headcap.speech.articulation import MEL_CEPSTRA, PREDICTION_CEPSTRA, articulation_features, cosines
from headcap.speech.lpc import linear_prediction


def test_prediction_cepstra_are_the_cepstrum_of_the_envelope(speech, rng):
    model = linear_prediction(speech + rng.normal(0, 1e-3, len(speech)), np.arange(8000, 40000, 900))
    found = articulation_features(model, 0.1)[:, MEL_CEPSTRA : MEL_CEPSTRA + PREDICTION_CEPSTRA]
    inverse = np.column_stack([np.ones(len(model.filters)), model.filters])
    # log |1/A| on 32768 points: aliasing of the cepstrum is below single precision
    cepstrum = 2 * irfft(-np.log(np.abs(np.fft.rfft(inverse, 32768, axis=1))), axis=1)
    np.testing.assert_allclose(found, cepstrum[:, 1 : PREDICTION_CEPSTRA + 1], atol=1e-4)


def test_a_pause_is_zero_whatever_noise_it_holds(rng):
    silent, noisy = (
        articulation_features(linear_prediction(rng.normal(0, sigma, 16000), np.arange(0, 15000, 128)), 0.1)
        for sigma in (1e-6, 1e-4)
    )
    mel = np.r_[0:MEL_CEPSTRA, MEL_CEPSTRA + PREDICTION_CEPSTRA : silent.shape[1]]
    # noise 60 dB below speech is 30 dB below the pause: log(1 + 1e-3) in 26 bands
    assert np.abs(silent[:, mel]).max() < 1e-3
    assert np.abs(noisy[:, mel]).max() < 0.1


def test_products_are_those_of_the_first_mel_cepstra(speech):
    found = articulation_features(linear_prediction(speech, np.array([20000])), 0.1)[0]
    rows, columns = np.triu_indices(6)
    np.testing.assert_allclose(found[29:], found[rows] * found[columns], rtol=1e-5)


def test_cosines_are_the_orthonormal_transform():
    np.testing.assert_allclose(cosines(6, 64), dct(np.eye(64), axis=0, norm="ortho")[:6], atol=1e-12)
