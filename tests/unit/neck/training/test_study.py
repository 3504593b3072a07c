"""A study's neck model: the same larynx wherever heads go, people who share blendshapes, kept in files, and clear refusals."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.artifacts import ArtifactError
from headcap.errors import InputError
from headcap.evaluation.neck import larynx_correlation
from headcap.geometry.transforms import from_vector, transform
from headcap.heads import base_head
from headcap.neck.fits import NeckFits
from headcap.neck.fitting.compensation import without_expressions
from headcap.neck.fitting.speech import SpeechFit
from headcap.neck.fitting.subject import fit_subject
from headcap.neck.subjects import NeckSubject
from headcap.neck.training.speech import SpeechTrainingSettings
from headcap.neck.training.study import NeckTrainingSettings, person_of, train_neck
from headcap.registration.sequence import MeshSequence
from headcap.synthetic.mesh_takes import mesh_subject

SETTINGS = NeckTrainingSettings(speech=SpeechTrainingSettings(iterations=3, reduced=12))
FRAMES = 90


def tracked_subject(head, one, folder) -> NeckSubject:
    """A take whose head also turns and drifts by centimetres; the template in the world."""
    turns = [
        from_vector(np.array([0.1 * np.sin(k / 20), 0.05 * k / FRAMES, 0.0, 0.1, 0.2 + 1e-4 * k, -0.3])) for k in range(FRAMES)
    ]
    meshes = np.array([transform(turn, mesh) for turn, mesh in zip(turns, one.subject.meshes[:FRAMES], strict=True)], np.float32)
    np.save(folder / f"{one.subject.name}.npy", meshes)
    template = replace(base_head(), vertices=transform(turns[0], one.subject.neutral))
    sequence = MeshSequence("talk", np.arange(FRAMES) / 60, (folder / f"{one.subject.name}.npy",))
    return NeckSubject.of(head, one.subject.name, template, {"talk": sequence}, {"talk": "speech"})


@pytest.fixture(scope="module")
def head(model):
    return without_expressions(model)


@pytest.fixture(scope="module")
def subjects(head, spoken, tmp_path_factory):
    return [tracked_subject(head, one, tmp_path_factory.mktemp("takes")) for one in spoken]


@pytest.fixture(scope="module")
def training(head, subjects):
    return train_neck(head, subjects, SETTINGS)


@pytest.fixture(scope="module")
def fits(training, head, subjects):
    return [fit_subject(training.model, head, subject, held_out=False) for subject in subjects]


@pytest.mark.parametrize("person", [0, 1])
def test_the_larynx_is_found_under_a_moving_head(fits, spoken, person):
    (take,) = fits[person].takes
    true_tau = spoken[person].tau_m[:FRAMES]
    assert larynx_correlation(take, np.arange(FRAMES) / 60 - 0.25, true_tau, clock_shift_s=0.25) > 0.93


def test_errors_are_what_the_model_leaves_of_the_neck(fits):
    figures = fits[0].figures()
    # the neck moves by more than a millimetre; what is left is noise of 0.08 mm in length and what six blendshapes leave
    assert figures["neck.error_mm"] < 0.25 < 0.5 < figures["neck.base_error_mm"]
    (take,) = fits[0].takes
    assert (take.error_mm <= take.base_error_mm + 0.05).all()


def test_fits_travel_in_a_file(fits, training, tmp_path):
    fits[0].save(tmp_path / "fits.npz")
    read = NeckFits.load(tmp_path / "fits.npz")
    assert read.person == fits[0].person
    assert np.array_equal(read.takes[0].speech.phi, fits[0].takes[0].speech.phi)
    assert np.array_equal(read.takes[0].placement, fits[0].takes[0].placement)
    training.model.save(tmp_path / "model.npz")
    with pytest.raises(ArtifactError, match="neck_fits"):
        NeckFits.load(tmp_path / "model.npz")


def test_no_scratch_file_stays(head, subjects, tmp_path):
    train_neck(head, subjects[:1], SETTINGS, scratch=tmp_path)
    assert not list(tmp_path.iterdir())


def test_short_takes_train_fewer_blendshapes(head, subjects):
    training = train_neck(head, [shortened(subjects[0], 10)], SETTINGS)
    # two frames for each: ten frames carry two steps of two
    assert len(training.model.head.speech_basis) == 4


def test_what_cannot_be_trained_is_refused(head, subjects):
    with pytest.raises(InputError, match="no speech take"):
        train_neck(head, [])
    with pytest.raises(InputError, match="no speech take"):
        train_neck(head, [replace(subjects[0], takes=())])
    with pytest.raises(InputError, match="4 frames of speech"):
        train_neck(head, [subjects[0], shortened(subjects[1], 4)], SETTINGS)


def shortened(subject: NeckSubject, frames: int) -> NeckSubject:
    (take,) = subject.takes
    return replace(subject, takes=(replace(take, time_s=take.time_s[:frames], meshes=take.meshes[:frames]),))


def test_a_still_larynx_has_no_correlation(fits):
    take = fits[0].takes[0]
    still = replace(take, speech=SpeechFit(np.zeros(FRAMES), take.speech.alpha, take.speech.phi))
    assert np.isnan(larynx_correlation(still, np.arange(FRAMES) / 60, np.arange(float(FRAMES)), clock_shift_s=0.0))


def test_people_are_those_of_the_model_and_else_found_from_their_neutral_head(training, subjects):
    assert person_of(training.model, subjects[0], SETTINGS) is training.model.people[0]
    stranger = mesh_subject(5)
    found = person_of(training.model, NeckSubject("stranger", stranger.neutral_m, ()), SETTINGS)
    # eq. 1: the base with its larynx at rest is the neutral head, up to what the map's pixels cannot hold
    assert 1e3 * np.abs(found.neutral - stranger.neutral_m).max() < 0.1
