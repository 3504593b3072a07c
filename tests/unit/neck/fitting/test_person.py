"""A held-out person under a trained model: their larynx from the neutral head, better with speech, never worse in energy."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.heads import HeadCoefficients
from headcap.neck import SpeechFitter
from headcap.neck.fitting.person import PersonFittingSettings, empty_larynx, fit_person
from headcap.neck.subjects import JoinedMeshes, NeckSubject

from ..conftest import speak

TOLD = 160
"""Frames that the person is fitted on; the rest are judged."""


@pytest.fixture(scope="module")
def stranger(model, larynx):
    """Somebody the model was not trained on, with a larynx of another height."""
    return speak(model, larynx, 7, 220)


@pytest.fixture(scope="module")
def subject(stranger):
    return NeckSubject("stranger", stranger.subject.neutral, ())


def judged(trained, person, stranger) -> tuple[float, float]:
    """Correlation of slides, and the mean error over L in metres, on frames that the person was not fitted on."""
    meshes = stranger.subject.meshes[TOLD:]
    fit = SpeechFitter(trained.model.head, person).fit(meshes)
    found = trained.model.evaluate(person, HeadCoefficients(speech=fit.phi), fit.tau_m, fit.alpha)
    error = np.linalg.norm(found - meshes, axis=2)[:, person.larynx.vertices].mean()
    return float(np.corrcoef(fit.tau_m, stranger.tau_m[TOLD:])[0, 1]), float(error)


def test_speech_makes_the_person_better_and_the_energy_never_rises(trained, stranger, subject):
    told = []
    first = fit_person(trained.model, subject)
    settings = PersonFittingSettings(rounds=3, settled=0.0)
    better = fit_person(
        trained.model, subject, stranger.subject.meshes[:TOLD], settings, progress=lambda step, energy: told.append(energy)
    )
    assert len(told) == 7
    assert (np.diff(told) <= 1e-9 * told[0]).all()
    noise = TOLD * subject.neutral.size * 5e-5**2
    assert told[-1] - noise < 0.95 * (told[0] - noise)
    (before, error_before), (after, error_after) = judged(trained, first, stranger), judged(trained, better, stranger)
    assert min(before, after) > 0.9
    assert error_after < error_before
    # noise of 0.05 mm on each axis is 0.08 mm in length
    assert error_after < 0.13e-3


def test_at_rest_the_person_is_their_neutral_head(trained, stranger, subject):
    person = fit_person(trained.model, subject, stranger.subject.meshes[:TOLD])
    whole = trained.model.evaluate(person, HeadCoefficients(), 0.0, 1.0)
    away = np.linalg.norm(whole - subject.neutral, axis=1)
    # smooth motions that N lacks of this person are shared between T_0 and W; the bump is 3.5 to 5.5 mm high
    assert away[person.larynx.vertices].mean() < 0.2e-3
    assert away[np.setdiff1d(np.arange(len(away)), person.larynx.vertices)].max() < 1e-6
    at_rest = SpeechFitter(trained.model.head, person).fit(np.array(subject.neutral)[None])
    assert abs(at_rest.tau_m[0]) < 0.5e-3


def test_the_speech_blendshapes_and_the_other_people_stay(trained, stranger, subject):
    person = fit_person(trained.model, subject, stranger.subject.meshes[:TOLD])
    more = trained.model.with_person(person)
    assert more.version == trained.model.version
    assert [one.name for one in more.people] == ["s1", "s2", "stranger"]


def test_frames_are_read_in_blocks_and_bad_ones_are_left_out(trained, stranger, subject):
    meshes = stranger.subject.meshes[:TOLD]
    whole = fit_person(trained.model, subject, meshes)
    parts = JoinedMeshes([meshes[:50], meshes[50:51], meshes[51:]], meshes.shape[1])
    read = fit_person(trained.model, subject, parts)
    assert np.array_equal(read.larynx.weights_m, whole.larynx.weights_m)
    broken = np.concatenate([meshes, np.full((3, *meshes.shape[1:]), np.nan, np.float32)])
    assert np.allclose(fit_person(trained.model, subject, broken).larynx.weights_m, whole.larynx.weights_m, atol=1e-12)


def test_what_was_not_seen_tells_nothing(trained, stranger, subject):
    seen = np.ones(len(subject.neutral), bool)
    seen[subject.neutral[:, 0] > 0.03] = False
    meshes, spoilt = stranger.subject.meshes[:TOLD], stranger.subject.meshes[:TOLD].copy()
    spoilt[:, ~seen] += np.float32(0.01)
    half = replace(subject, seen=seen)
    plain, other = fit_person(trained.model, half, meshes), fit_person(trained.model, half, spoilt)
    assert np.allclose(plain.base, other.base, atol=1e-8)
    assert np.allclose(plain.larynx.weights_m, other.larynx.weights_m, atol=1e-8)


@pytest.mark.parametrize("frames", [0, 10])
def test_little_speech_leaves_what_the_neutral_head_says(trained, stranger, subject, frames):
    person = fit_person(trained.model, subject, stranger.subject.meshes[:frames])
    assert np.array_equal(person.larynx.weights_m, fit_person(trained.model, subject).larynx.weights_m)


def test_another_topology_is_refused(trained, stranger, subject):
    with pytest.raises(InputError, match="topology"):
        fit_person(trained.model, replace(subject, neutral=subject.neutral[:-1]))
    with pytest.raises(InputError, match="topology"):
        fit_person(trained.model, subject, stranger.subject.meshes[:, :-1])


def test_a_model_without_people_lays_a_new_map_out(trained):
    alone = empty_larynx(replace(trained.model, people=()))
    shared = empty_larynx(trained.model)
    assert np.array_equal(alone.vertices, shared.vertices)
    assert np.allclose(alone.uv_m, shared.uv_m, atol=1e-6)
    assert not alone.weights_m.any()
