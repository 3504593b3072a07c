import numpy as np
import pytest

from headcap.artifacts import ArtifactError, save_arrays
from headcap.errors import InputError
from headcap.speech import (
    FeatureSet,
    FeatureSettings,
    FeatureStream,
    RidgeSettings,
    SpeechCoefficients,
    SpeechRegressor,
    SpeechTake,
    speaker_pitch,
    speech_errors,
    speech_features,
    speech_level,
    track_pitch,
    train_speech_regressor,
    visual_centres,
)

FPS, START_S = 30.0, 0.3
FEW = RidgeSettings(least=0.01, most=1.0, per_decade=1)  # with 2048 inputs each penalty takes time


def _coefficients(features, rng, law, noise):
    """Coefficients that follow the middle of each window's pooled features, with noise."""
    inputs = np.column_stack([features.articulation[features.windows[:, 32], :6], features.prosody[features.windows[:, 32]]])
    values = inputs @ law + 3.0
    values += noise * values.std(0) * rng.normal(0, 1, values.shape)
    return SpeechCoefficients(values[:, :4], values[:, 4], values[:, 5])


@pytest.fixture(scope="module")
def takes(voice):
    rng = np.random.default_rng(3)
    law = rng.normal(0, 1, (10, 6))
    found = []
    for k in range(4):
        features = speech_features(voice(6.0, 110.0 + 10 * k, seed=k)[0], visual_centres(160, FPS, start_s=START_S))
        found.append(SpeechTake(f"speech_{k}", features, _coefficients(features, rng, law, 0.1)))
    return found


@pytest.fixture(scope="module", params=list(FeatureSet))
def regressor(request, takes):
    return train_speech_regressor(takes[:3], "abc123", request.param, group="male", settings=FEW)


def test_a_held_out_take_is_predicted_better_than_by_the_mean(regressor, takes):
    errors = speech_errors(regressor, takes[3:])
    assert errors.frames == 160
    assert errors.phi < 0.8 * errors.phi_of_mean
    assert errors.tau < errors.tau_of_mean
    assert errors.alpha < errors.alpha_of_mean


def test_errors_are_those_of_table_2(regressor, takes):
    take = takes[3]
    found = regressor.coefficients(take.features, "abc123")
    errors = speech_errors(regressor, [take])
    assert errors.phi == pytest.approx(np.linalg.norm(found.phi - take.coefficients.phi, axis=1).mean())
    assert errors.tau == pytest.approx(((found.tau - take.coefficients.tau) ** 2).mean())
    assert errors.alpha_of_mean == pytest.approx(((regressor.larynx.mean[1] - take.coefficients.alpha) ** 2).mean())


def test_the_paper_regressor_is_the_papers(takes):
    found = train_speech_regressor(takes[:3], "abc123", FeatureSet.PAPER, settings=FEW)
    assert found.speech.weights.shape == (2048, 4)
    assert found.larynx.weights.shape == (192, 2)
    assert (found.speech.bias == 0).all()
    assert len(np.unique(found.speech.penalties)) == 1
    assert (found.larynx.bias != 0).all()


def test_a_regressor_returns_as_it_was_saved(regressor, takes, tmp_path):
    regressor.save(tmp_path / "a.npz")
    loaded = SpeechRegressor.load(tmp_path / "a.npz", "abc123")
    for name in ("model_version", "feature_set", "features", "group", "figures"):
        assert getattr(loaded, name) == getattr(regressor, name)
    first, second = (one.coefficients(takes[3].features, "abc123") for one in (regressor, loaded))
    np.testing.assert_array_equal(first.phi, second.phi)
    np.testing.assert_array_equal(first.tau, second.tau)


def test_another_model_version_is_refused(regressor, takes, tmp_path):
    regressor.save(tmp_path / "a.npz")
    with pytest.raises(InputError, match="regressor of neck model abc123 beside neck model def"):
        SpeechRegressor.load(tmp_path / "a.npz", "def")
    with pytest.raises(InputError, match="regressor of neck model abc123 beside neck model def"):
        regressor.coefficients(takes[0].features, "def")
    save_arrays(tmp_path / "b.npz", "neck_model", 1, {})
    with pytest.raises(ArtifactError, match=r"headcap\.neck_model/1"):
        SpeechRegressor.load(tmp_path / "b.npz")


def test_features_of_other_settings_are_refused(regressor, voice):
    other = speech_features(voice(1.0, 120.0)[0], visual_centres(5, FPS), FeatureSettings(pooled_orders=9))
    with pytest.raises(InputError, match="features made with pitch="):
        regressor.coefficients(other, "abc123")


def test_a_stream_drives_the_model_as_the_whole_recording_does(regressor, voice):
    sound = voice(3.0, 125.0, seed=9)[0]
    level, pitch_hz = speech_level(sound), speaker_pitch(track_pitch(sound))
    whole = regressor.coefficients(speech_features(sound, visual_centres(90, FPS)), "abc123")
    stream, parts = FeatureStream(FPS, level=level, pitch_hz=pitch_hz), []
    for start in range(0, len(sound), 1600):
        parts.append(regressor.coefficients(stream.push(sound[start : start + 1600]), "abc123"))
    parts.append(regressor.coefficients(stream.finish(), "abc123"))
    # blocks of other lengths sum in another order
    np.testing.assert_allclose(np.concatenate([part.phi for part in parts]), whole.phi, atol=1e-9 * np.abs(whole.phi).max())
    np.testing.assert_allclose(np.concatenate([part.tau for part in parts]), whole.tau, atol=1e-9 * np.abs(whole.tau).max())


def test_a_group_may_train_phi_alone(takes):
    mute = [SpeechTake(take.name, take.features, SpeechCoefficients(take.coefficients.phi)) for take in takes]
    found = train_speech_regressor(mute[:3], "abc123", group="female")
    assert found.larynx is None
    assert found.coefficients(mute[3].features, "abc123").tau is None
    assert speech_errors(found, mute[3:]).tau is None
    with pytest.raises(InputError, match="speech_1 has other coefficients"):
        train_speech_regressor([takes[0], mute[1]], "abc123")


def test_the_only_take_is_cut_into_stretches(takes):
    found = train_speech_regressor(takes[:1], "abc123")
    assert found.figures["takes"] == 5
    assert found.figures["frames"] == 160
    short = takes[0].part(0, 4)
    with pytest.raises(InputError, match=r"4 fitted frames and no other take; expected at least 5"):
        train_speech_regressor([short], "abc123")
    with pytest.raises(InputError, match="no take with speech"):
        train_speech_regressor([], "abc123")


def test_takes_are_read_one_at_a_time(takes):
    served = []

    def read():
        for take in takes:
            served.append(take.name)
            yield take

    lazily = train_speech_regressor(read(), "abc123")
    np.testing.assert_array_equal(lazily.speech.weights, train_speech_regressor(takes, "abc123").speech.weights)
    assert served == [take.name for take in takes]


def test_frames_that_were_not_fitted_are_skipped_and_counted(takes):
    take = takes[0]
    phi = take.coefficients.phi.copy()
    phi[10:25] = np.nan
    holed = SpeechTake(take.name, take.features, SpeechCoefficients(phi, take.coefficients.tau, take.coefficients.alpha))
    found = train_speech_regressor([holed, *takes[1:3]], "abc123")
    assert found.figures["skipped_frames"] == 15
    assert speech_errors(found, [holed]).skipped == 15
    nothing = SpeechCoefficients(np.full_like(phi, np.nan), take.coefficients.tau, take.coefficients.alpha)
    with pytest.raises(InputError, match="speech_0: 160 frames without a whole set of numbers"):
        train_speech_regressor([SpeechTake(take.name, take.features, nothing), takes[1]], "abc123")


def test_coefficients_of_another_length_are_refused(takes):
    with pytest.raises(InputError, match="speech_0: 3 frames of coefficients and 160 of sound"):
        SpeechTake("speech_0", takes[0].features, SpeechCoefficients(np.zeros((3, 4))))


def test_sound_without_any_voice_trains_on_loudness_and_says_so(rng):
    takes = []
    for k in range(3):
        whisper = rng.normal(0, 0.05, 48000) * np.repeat(rng.uniform(0.2, 1, 30), 1600)
        features = speech_features(whisper, visual_centres(60, FPS, start_s=START_S))
        loud = features.sources[features.windows[:, 32], 0]
        takes.append(SpeechTake(f"whisper_{k}", features, SpeechCoefficients(loud[:, None], loud * 2 + 1, loud - 3)))
    found = train_speech_regressor(takes[:2], "abc123", FeatureSet.PAPER, settings=FEW)
    assert found.figures["voiced_share"] == 0
    weights = found.larynx.weights.reshape(64, 3, 2)
    assert (weights[:, 1:] == 0).all()
    errors = speech_errors(found, takes[2:])
    assert errors.tau < 0.5 * errors.tau_of_mean
