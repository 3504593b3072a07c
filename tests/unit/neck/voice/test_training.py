"""Regressors of one person: errors of what was left out, short takes, and clear refusals."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.neck.fits import NeckFits, TakeFit
from headcap.neck.fitting.speech import SpeechFit
from headcap.neck.voice.figure import save_voice_figure
from headcap.neck.voice.training import VoiceTrainingSettings, train_voice
from headcap.speech import FeatureSet, SpeechCoefficients, SpeechRegressor


def _cut(take: TakeFit, frames: int) -> TakeFit:
    arrays = {name: getattr(take, name)[:frames] for name in ("time_s", "theta", "psi", "placement")}
    errors_mm = {stage: error[:frames] for stage, error in take.errors_mm.items()}
    return replace(take, speech=take.speech.frames(slice(0, frames)), errors_mm=errors_mm, **arrays)


def test_left_out_takes_are_predicted_better_than_by_the_mean(voice_training):
    errors = voice_training.errors.kept.errors
    assert errors.phi < 0.8 * errors.phi_of_mean
    assert errors.tau < 0.8 * errors.tau_of_mean
    assert errors.alpha < 0.8 * errors.alpha_of_mean
    assert voice_training.errors.shared_sound == 0
    assert voice_training.errors.left_out == "takes"
    assert voice_training.errors.remarks == ()


def test_figures_are_those_of_the_predictions_drawn(voice_training):
    """Table 2 by hand from the curves, in millimetres."""
    takes, figures = voice_training.predictions, voice_training.figures()
    away = np.concatenate([take.predicted.phi - take.fitted.phi for take in takes])
    assert figures["speech.phi_error"] == pytest.approx(1e3 * np.linalg.norm(away, axis=1).mean())
    slide = np.concatenate([take.predicted.tau - take.fitted.tau for take in takes])
    assert figures["speech.tau_error"] == pytest.approx(1e6 * (slide**2).mean())
    assert figures["speech.frames"] == sum(len(take.time_s) for take in takes)
    assert figures["speech.takes"] == 3


def test_the_regressor_belongs_to_the_model_and_drives_all(voice_training, neck, heard, tmp_path):
    voice_training.regressor.save(tmp_path / "regressor.npz")
    read = SpeechRegressor.load(tmp_path / "regressor.npz", neck.version)
    assert read.group == "somebody"
    fit, sound = heard[3]
    found = read.coefficients(sound.features(fit.time_s), neck.version)
    for name, truth in (("tau", fit.speech.tau_m), ("alpha", fit.speech.alpha)):
        assert np.mean((getattr(found, name) - truth) ** 2) < 0.8 * np.var(truth)


@pytest.mark.parametrize("frames", [72, 12])
def test_one_short_take_is_enough_and_says_how_little_it_shows(neck, heard, frames):
    fit, sound = heard[0]
    found = train_voice(neck, NeckFits("somebody", (_cut(fit, frames),)), {fit.take: sound})
    figures = found.figures()
    assert figures["speech.takes"] == 1
    assert figures["speech.frames"] == frames
    # of five stretches of 72 frames at 30 per second, all but a few frames of each lie within 0.52 s of another stretch
    assert figures["speech.shared_sound_share"] > 0.9
    assert np.isfinite(list(figures.values())).all()
    assert len(found.predictions[0].predicted.tau) == frames
    assert "how another take would be predicted is not known" in found.errors.remarks[0]


def test_what_sound_does_not_tell_is_told(neck, heard, rng):
    """A slide that has nothing to do with the voice."""
    fits = [replace(fit, speech=replace(fit.speech, tau_m=0.003 * rng.normal(size=len(fit.time_s)))) for fit, _ in heard[:3]]
    found = train_voice(neck, NeckFits("somebody", tuple(fits)), {fit.take: sound for fit, sound in heard[:3]})
    errors = found.errors.kept.errors
    assert errors.tau == pytest.approx(errors.tau_of_mean, rel=0.1)
    assert ("tau no better than by the mean" in "".join(found.errors.remarks)) == (errors.tau >= errors.tau_of_mean)


def test_long_stretches_share_little_sound(neck, heard):
    """Five stretches of 48 frames, 1.6 s: windows of 0.52 s, 15.6 frames, reach over a border from 15 frames on each side."""
    fit, sound = heard[0]
    found = train_voice(neck, NeckFits("somebody", (fit,)), {fit.take: sound})
    assert found.errors.shared_sound == pytest.approx(8 * 15 / 240)


def test_frames_that_were_not_fitted_are_skipped_and_counted(neck, heard):
    fit, sound = heard[0]
    gone = np.arange(len(fit.time_s)) % 10 == 3
    speech = SpeechFit(*(np.where(gone.reshape(-1, *[1] * (a.ndim - 1)), np.nan, a) for a in vars(fit.speech).values()))
    found = train_voice(neck, NeckFits("somebody", (replace(fit, speech=speech),)), {fit.take: sound})
    figures = found.figures()
    assert (figures["speech.frames"], figures["speech.skipped_frames"]) == (216, 24)
    assert np.isfinite(found.predictions[0].predicted.tau).all()


def test_frames_at_which_no_sound_was_recorded_are_skipped_and_counted(neck, heard):
    """A recorder that was stopped after 4 s of 8: silence in its place would be learnt."""
    fit, sound = heard[0]
    stopped = replace(sound, samples=sound.samples[: 4 * 16000])
    found = train_voice(neck, NeckFits("somebody", (fit,)), {fit.take: stopped})
    figures = found.figures()
    assert (figures["speech.frames"], figures["speech.skipped_frames"]) == (120, 120)
    assert found.errors.kept.errors.frames == 120
    assert np.isnan(found.predictions[0].fitted.tau[120:]).all()


def test_a_take_without_any_frame_fitted_and_heard_is_told(neck, heard):
    (fit, sound), (other, later) = heard[:2]
    gone = replace(later, samples=later.samples[:16000], first_sample_s=7.2)
    nothing = replace(other, speech=SpeechFit(*(np.full_like(part, np.nan) for part in vars(other.speech).values())))
    for left, heard_of_it in ((nothing, later), (_cut(other, 60), gone)):
        sounds = {fit.take: sound, other.take: heard_of_it}
        if heard_of_it is gone:
            with pytest.raises(InputError, match="somebody talk_2, cam: none of 60 visual frames lies in"):
                train_voice(neck, NeckFits("somebody", (fit, left)), sounds)
            continue
        found = train_voice(neck, NeckFits("somebody", (fit, left)), sounds)
        assert "somebody talk_2: no frame was fitted and heard" in found.errors.remarks
        assert (found.figures()["speech.takes"], found.figures()["speech.skipped_frames"]) == (1, 240)
    with pytest.raises(InputError, match="no frame of talk_2 was both fitted and heard"):
        train_voice(neck, NeckFits("somebody", (nothing,)), {other.take: later})


def test_takes_in_which_nothing_is_said_are_left_aside(neck, heard):
    fit, sound = heard[0]
    silent = replace(heard[1][0], kind="pose")
    found = train_voice(neck, NeckFits("somebody", (_cut(fit, 72), silent)), {fit.take: sound})
    assert found.figures()["speech.takes"] == 1
    with pytest.raises(InputError, match="none of 1 fitted takes is of kind speech"):
        train_voice(neck, NeckFits("somebody", (silent,)), {})


def test_each_training_states_the_papers_features_beside_ours(voice_training):
    ours, paper = voice_training.errors.rows
    assert (ours.feature_set, paper.feature_set) == (FeatureSet.POOLED, FeatureSet.PAPER)
    assert paper.errors.phi < paper.errors.phi_of_mean == pytest.approx(ours.errors.phi_of_mean)


def test_a_person_whom_the_model_has_not_seen_has_a_voice_of_their_own(neck, heard):
    fit, sound = heard[0]
    found = train_voice(neck, NeckFits("somebody", (_cut(fit, 72),), held_out=True), {fit.take: sound})
    assert found.errors.trained == found.errors.tested == ("somebody",)


def test_a_voiceless_take_still_trains(neck, heard, rng):
    """Whispering: noise whose loudness goes with the slide; no pitch anywhere."""
    fit, sound = heard[0]
    loud = np.interp(np.arange(len(sound.samples)) / 16000, fit.time_s, fit.speech.tau_m - fit.speech.tau_m.min())
    whisper = replace(sound, samples=(3 * loud * rng.normal(size=len(loud))).astype(np.float32))
    found = train_voice(neck, NeckFits("somebody", (fit,)), {fit.take: whisper})
    assert found.figures()["speech.voiced_share"] < 0.05
    assert np.isfinite(found.predictions[0].predicted.tau).all()


def test_what_cannot_be_trained_is_refused(neck, heard):
    fit, sound = heard[0]
    with pytest.raises(InputError, match="somebody: no sound of talk_1"):
        train_voice(neck, NeckFits("somebody", (fit,)), {})
    wide = replace(fit, speech=replace(fit.speech, phi=np.zeros((len(fit.time_s), 20))))
    with pytest.raises(InputError, match="20 blendshape weights, and a model of 3"):
        train_voice(neck, NeckFits("somebody", (wide,)), {fit.take: sound})
    with pytest.raises(InputError, match="4 fitted frames and no other take"):
        train_voice(neck, NeckFits("somebody", (_cut(fit, 4),)), {fit.take: sound})
    with pytest.raises(InputError, match=r"somebody talk_1, cam: .* of sound"):
        train_voice(neck, NeckFits("somebody", (fit,)), {fit.take: replace(sound, samples=sound.samples[:1000])})


def test_the_picture_is_drawn(voice_training, tmp_path):
    save_voice_figure(tmp_path / "prediction.png", voice_training)
    assert (tmp_path / "prediction.png").read_bytes().startswith(b"\x89PNG")


def test_the_papers_features_may_be_chosen(neck, heard):
    fits = NeckFits("somebody", tuple(_cut(fit, 60) for fit, _ in heard[:3]))
    settings = VoiceTrainingSettings(feature_set="paper", ridge={"least": 0.01, "most": 1.0, "per_decade": 1})
    found = train_voice(neck, fits, {fit.take: sound for fit, sound in heard[:3]}, settings)
    assert found.regressor.speech.weights.shape[0] == 2048
    assert isinstance(found.predictions[0].predicted, SpeechCoefficients)
