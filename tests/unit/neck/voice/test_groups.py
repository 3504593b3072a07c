"""Generic regressors: people left out, what is theirs alone, and what is said where there are too few of them."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.artifacts import ArtifactError, save_json
from headcap.errors import InputError
from headcap.neck.fits import NeckFits
from headcap.neck.fitting.speech import SpeechFit
from headcap.neck.voice.errors import VoiceErrors
from headcap.neck.voice.figure import _drawn, save_voice_figure
from headcap.neck.voice.training import Voice, VoiceTrainingSettings, train_group, train_voice_of
from headcap.speech import FeatureSet

FEW = VoiceTrainingSettings(ridge={"least": 0.01, "most": 10.0, "per_decade": 1})
NAMES = ("ann", "bob", "cem", "dee")


def _some(fit, frames):
    arrays = {name: getattr(fit, name)[frames] for name in ("time_s", "theta", "psi", "placement")}
    return replace(fit, speech=fit.speech.frames(frames), errors_mm={s: e[frames] for s, e in fit.errors_mm.items()}, **arrays)


@pytest.fixture(scope="module")
def people(heard):
    """Four people with a take or two of 3 s in a voice of their own, the first with 0.4 s of silence; all obey one law."""
    fits, sounds = [], {}
    for name, (fit, sound) in zip(NAMES, heard, strict=True):
        count = 2 if name == "bob" else 1
        parts = [replace(_some(fit, slice(90 * k, 90 * k + 90)), take=f"talk_{k}") for k in range(count)]
        fits.append(NeckFits(name, tuple(parts)))
        sounds[name] = {part.take: replace(sound, person=name, take=part.take) for part in parts}
    return fits, sounds


def _moved(fits: NeckFits, phi: float, tau: float, alpha: float) -> NeckFits:
    """Of a person whose scan was taken at another moment."""
    takes = [
        replace(take, speech=SpeechFit(take.speech.tau_m + tau, take.speech.alpha + alpha, take.speech.phi + phi))
        for take in fits.takes
    ]
    return replace(fits, takes=tuple(takes))


@pytest.fixture(scope="module")
def moved(people):
    """The same people with constants of their own, as large as what speech moves."""
    constants = [(0.02, 0.004, 0.1), (-0.02, 0.0, -0.1), (0.0, -0.004, 0.05), (0.03, 0.002, 0.0)]
    return [_moved(fits, *own) for fits, own in zip(people[0], constants, strict=True)]


@pytest.fixture(scope="module")
def group(neck, people, moved):
    return train_group(neck, moved, people[1], FEW, group="all")


def test_people_who_were_not_heard_are_predicted_better_than_by_the_mean(group):
    errors = group.errors.kept.errors
    assert (group.errors.kind, group.errors.left_out, group.errors.trained, group.errors.tested) == (
        "generic",
        "people",
        *[NAMES] * 2,
    )
    assert errors.phi < 0.8 * errors.phi_of_mean
    assert errors.tau < 0.8 * errors.tau_of_mean
    assert errors.alpha < 0.8 * errors.alpha_of_mean
    assert (errors.frames, group.errors.kept.training_frames) == (5 * 90, 5 * 90)


def test_both_feature_sets_are_stated_and_ours_with_silence_left_in_too(group):
    ways = [(row.feature_set, row.silence_removed) for row in group.errors.rows]
    assert ways == [(FeatureSet.POOLED, True), (FeatureSet.PAPER, True), (FeatureSet.POOLED, False)]
    assert group.regressor.feature_set is FeatureSet.POOLED
    assert group.regressor.from_silence
    left_in = group.errors.row(FeatureSet.POOLED, silence_removed=False).errors
    # constants that no voice tells
    assert left_in.tau > 1.5 * group.errors.kept.errors.tau
    assert left_in.phi > 1.2 * group.errors.kept.errors.phi


def test_constants_of_people_do_not_matter(neck, people, group):
    """Invariance: who is scanned at another moment is no other speaker."""
    plain = train_group(neck, *people, FEW, group="all")
    np.testing.assert_allclose(plain.regressor.speech.weights, group.regressor.speech.weights, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(plain.regressor.larynx.bias, group.regressor.larynx.bias, rtol=1e-6, atol=1e-9)
    assert plain.errors.kept.errors.tau == pytest.approx(group.errors.kept.errors.tau, rel=1e-6)


def test_a_person_held_out_tests_and_never_trains(neck, people, moved):
    fits, sounds = moved, people[1]
    three = train_group(neck, fits[:3], sounds, FEW, group="all")
    tested = train_group(neck, [*fits[:3], replace(fits[3], held_out=True)], sounds, FEW, group="all")
    np.testing.assert_array_equal(tested.regressor.speech.weights, three.regressor.speech.weights)
    assert (tested.errors.trained, set(tested.errors.tested)) == (NAMES[:3], set(NAMES))
    assert (tested.errors.kept.training_frames, tested.errors.kept.errors.frames) == (4 * 90, 5 * 90)
    own = next(one for one in tested.predictions if one.person == "dee")
    heard = sounds["dee"][own.take].features(own.time_s)
    np.testing.assert_array_equal(own.predicted.tau, three.regressor.coefficients(heard, neck.version).tau)


def test_two_people_predict_each_other(neck, people, moved):
    found = train_group(neck, moved[:2], people[1], FEW, group="pair")
    assert (found.errors.left_out, found.errors.tested) == ("people", NAMES[:2])
    assert found.errors.kept.errors.frames == 3 * 90


def test_one_person_to_train_on_is_told_unless_another_is_held_out(neck, people, moved):
    found = train_group(neck, moved[1:2], people[1], FEW, group="lonely")
    assert found.errors.left_out == "takes"
    assert "only bob speaks" in found.errors.remarks[0]
    tested = train_group(neck, [moved[1], replace(moved[0], held_out=True)], people[1], FEW, group="lonely")
    assert (tested.errors.left_out, tested.errors.tested) == ("people", ("ann",))
    assert not any("only bob speaks" in remark for remark in tested.errors.remarks)


def test_a_group_may_train_phi_alone(neck, people, moved, tmp_path):
    found = train_group(neck, moved[:2], people[1], FEW, group="female", coefficients="phi")
    assert found.regressor.drives == ("phi",)
    assert found.errors.kept.errors.tau is None
    assert not any("tau" in name or "alpha" in name for name in found.figures())
    assert found.predictions[0].predicted.tau is None
    save_voice_figure(tmp_path / "prediction.png", found)
    assert (tmp_path / "prediction.png").read_bytes().startswith(b"\x89PNG")


def test_who_never_pauses_keeps_their_constants_and_that_is_told(neck, people, moved):
    """Frames from 0.5 s on, amid speech."""
    spoken = replace(moved[2], takes=(_some(moved[2].takes[0], slice(20, 80)),))
    found = train_group(neck, [moved[0], spoken], people[1], FEW, group="all")
    assert any("no pause is heard of cem" in remark for remark in found.errors.remarks)
    fitted = [one.fitted for one in found.predictions if one.person == "cem"]
    np.testing.assert_array_equal(fitted[0].tau, spoken.takes[0].speech.tau_m)


def test_errors_return_as_they_were_saved(group, tmp_path):
    group.errors.save(tmp_path / "errors.json")
    read = VoiceErrors.load(tmp_path / "errors.json")
    assert (read.voice, read.left_out, read.tested, read.remarks) == ("all", "people", NAMES, group.errors.remarks)
    for own, other in zip(read.rows, group.errors.rows, strict=True):
        assert (own.feature_set, own.silence_removed, own.training_frames) == (
            other.feature_set, other.silence_removed, other.training_frames,
        )  # fmt: skip
        assert vars(own.errors) == pytest.approx(vars(other.errors))
    save_json(tmp_path / "old.json", "voice_errors", 0, {})
    with pytest.raises(ArtifactError, match=r"expected headcap\.voice_errors/1"):
        VoiceErrors.load(tmp_path / "old.json")


def test_a_study_names_its_voices(neck, people, moved):
    sounds = [sound for own in people[1].values() for sound in own.values()]
    user = train_voice_of(neck, Voice(name="bob", people=("bob",)), moved, sounds, FEW)
    assert (user.errors.kind, user.errors.trained, user.regressor.from_silence) == ("user", ("bob",), False)
    voice = Voice(name="two", people=("dee", "ann"), coefficients="phi")
    both = train_voice_of(neck, voice, moved, sounds, FEW)
    assert (both.errors.trained, both.regressor.group) == (("dee", "ann"), "two")
    # nobody but the person makes a voice the person's own
    kinds = [Voice(name="bob", people=people).kind for people in (("bob",), ("ann", "bob"), ("ann",))]
    assert kinds == ["user", "generic", "generic"]
    with pytest.raises(InputError, match="voice eve: no fits of eve; expected one of ann, bob, cem, dee"):
        train_voice_of(neck, Voice(name="eve", people=("eve",)), moved, sounds, FEW)


def test_what_cannot_be_trained_is_refused(neck, people, moved):
    with pytest.raises(InputError, match="group all: nobody of 1 to train on"):
        train_group(neck, [replace(moved[0], held_out=True)], people[1], FEW, group="all")
    with pytest.raises(InputError, match="no sound of bob"):
        train_group(neck, moved[:2], {"ann": people[1]["ann"]}, FEW, group="all")
    with pytest.raises(InputError, match="bob: no sound of talk_1"):
        train_group(neck, moved[:2], people[1] | {"bob": {"talk_0": people[1]["bob"]["talk_0"]}}, FEW, group="all")


def test_of_many_takes_each_persons_first_is_drawn(group):
    one = group.predictions[0]
    many = [replace(one, person=person, take=f"talk_{k}") for person in ("ann", "bob") for k in range(7)]
    assert [(take.person, take.take) for take in _drawn(many)] == [("ann", "talk_0"), ("bob", "talk_0")]
    assert _drawn(many[:7]) == many[:7]
