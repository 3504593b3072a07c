"""A person's neck from tracked takes: the same larynx wherever the head goes, kept in files, and clear refusals."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.artifacts import ArtifactError
from headcap.errors import InputError
from headcap.evaluation.neck import larynx_correlation
from headcap.geometry.transforms import from_vector, transform
from headcap.heads import base_head
from headcap.neck.fits import NeckFits
from headcap.neck.person_training import NeckTrainingSettings, train_person
from headcap.neck.speech_fitting import SpeechFit
from headcap.neck.speech_training import SpeechTrainingSettings
from headcap.registration.sequence import MeshSequence

SETTINGS = NeckTrainingSettings(expressions=0, speech=SpeechTrainingSettings(iterations=3, reduced=12))


@pytest.fixture(scope="module")
def tracked(spoken, tmp_path_factory):
    """A take of 90 frames whose head also turns and drifts by centimetres; the template in the world."""
    one, folder = spoken[0], tmp_path_factory.mktemp("take")
    turns = [from_vector(np.array([0.1 * np.sin(k / 20), 0.05 * k / 90, 0.0, 0.1, 0.2 + 1e-4 * k, -0.3])) for k in range(90)]
    meshes = np.array([transform(turn, mesh) for turn, mesh in zip(turns, one.subject.meshes[:90], strict=True)], np.float32)
    np.save(folder / "chunk_000.npy", meshes)
    template = replace(base_head(), vertices=transform(turns[0], one.subject.neutral))
    return one, template, MeshSequence("talk", np.arange(90) / 60, (folder / "chunk_000.npy",))


@pytest.fixture(scope="module")
def found(tracked):
    _, template, sequence = tracked
    return train_person("somebody", template, {"talk": sequence}, SETTINGS)


def test_the_larynx_is_found_under_a_moving_head(found, tracked):
    training, fits = found
    (take,) = fits.takes
    assert training.model.person("somebody").name == "somebody"
    assert larynx_correlation(take, np.arange(90) / 60 - 0.25, tracked[0].tau_m[:90], clock_shift_s=0.25) > 0.93


def test_errors_are_what_the_model_leaves_of_the_neck(found):
    fits = found[1]
    figures = fits.figures()
    # the neck moves by more than a millimetre; what is left is noise of 0.08 mm in length and what six blendshapes leave
    assert figures["neck.error_mm"] < 0.25 < 0.5 < figures["neck.base_error_mm"]
    assert np.isclose(figures["neck.speech_error_drop_mm"], figures["neck.base_error_mm"] - figures["neck.error_mm"])
    assert (fits.takes[0].error_mm <= fits.takes[0].base_error_mm + 0.05).all()


def test_fits_travel_in_a_file(found, tmp_path):
    fits = found[1]
    fits.save(tmp_path / "fits.npz")
    read = NeckFits.load(tmp_path / "fits.npz")
    assert read.person == "somebody"
    assert np.array_equal(read.takes[0].speech.phi, fits.takes[0].speech.phi)
    assert np.array_equal(read.takes[0].placement, fits.takes[0].placement)
    found[0].model.save(tmp_path / "model.npz")
    with pytest.raises(ArtifactError, match="neck_fits"):
        NeckFits.load(tmp_path / "model.npz")


def test_short_takes_train_fewer_blendshapes(tracked, tmp_path):
    _, template, sequence = tracked
    np.save(tmp_path / "short.npy", sequence.positions()[:10])
    short = MeshSequence("talk", sequence.time_s[:10], (tmp_path / "short.npy",))
    training, _ = train_person("somebody", template, {"talk": short}, SETTINGS)
    # two frames for each: ten frames carry two steps of two
    assert len(training.model.head.speech_basis) == 4


def test_what_cannot_be_trained_is_refused(tracked):
    _, template, sequence = tracked
    with pytest.raises(InputError, match="no speech take"):
        train_person("somebody", template, {})
    with pytest.raises(InputError, match="topology"):
        train_person("somebody", replace(template, triangles=template.triangles[::-1]), {"talk": sequence})


def test_a_still_larynx_has_no_correlation(found):
    take = found[1].takes[0]
    still = replace(take, speech=SpeechFit(np.zeros(90), take.speech.alpha, take.speech.phi))
    assert np.isnan(larynx_correlation(still, np.arange(90) / 60, np.arange(90.0), clock_shift_s=0.0))
