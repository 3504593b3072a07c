"""Speech coefficients from the vertices that were seen: the others tell nothing, and what they hide does not bend the rest."""

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.neck import SpeechFitter
from headcap.neck.fitting.speech import seen_directions


@pytest.fixture(scope="module")
def half(model):
    """Everything but the left side from 25 mm on, the nape and the crown."""
    vertices = model.vertices
    return (vertices[:, 0] < 0.025) & (vertices[:, 2] > -0.02) & (vertices[:, 1] < 0.05)


def test_unseen_vertices_tell_nothing(trained, spoken, half):
    one = spoken[0]
    fitter = SpeechFitter(trained.model.head, trained.model.person("s1"), seen=half)
    meshes = one.subject.meshes[200:230]
    spoilt = meshes.copy()
    spoilt[:, ~half] += np.float32(0.02)
    plain, other = fitter.fit(meshes), fitter.fit(spoilt)
    assert np.allclose(plain.tau_m, other.tau_m, atol=1e-9)
    assert np.allclose(plain.alpha, other.alpha, atol=1e-9)
    assert np.allclose(plain.phi, other.phi, atol=1e-9)


def test_what_was_seen_gives_what_all_would(trained, spoken, half):
    one = spoken[0]
    person, head, meshes = trained.model.person("s1"), trained.model.head, one.subject.meshes[200:]
    whole, part = SpeechFitter(head, person).fit(meshes), SpeechFitter(head, person, seen=half).fit(meshes)
    assert np.corrcoef(part.tau_m, one.tau_m[200:])[0, 1] > 0.9
    shown = np.tensordot(part.phi - whole.phi, head.speech_basis, axes=1)[:, half]
    # noise of 0.05 mm over thousands of vertices leaves micrometres; what differs is what the model does not explain
    assert np.sqrt((shown**2).sum(axis=2).mean()) < 0.05e-3
    spoilt = meshes.copy()
    spoilt[:, ~half] += np.float32(0.02)
    assert np.abs(SpeechFitter(head, person).fit(spoilt).phi - whole.phi).max() > 10 * np.abs(part.phi - whole.phi).max()


def test_weights_are_those_of_masked_least_squares(trained, spoken, half):
    person, head = trained.model.person("s1"), trained.model.head
    mesh = spoken[0].subject.meshes[210:211]
    fit = SpeechFitter(head, person, seen=half).fit(mesh)
    left = mesh[0] - person.base
    left[person.larynx.vertices] -= person.larynx.offset(fit.tau_m[0], fit.alpha[0]).values
    basis = head.speech_basis.astype(float)[:, half].reshape(len(head.speech_basis), -1)
    assert np.allclose(fit.phi[0], np.linalg.lstsq(basis.T, left[half].ravel(), rcond=None)[0], atol=1e-7)


def test_a_blendshape_that_was_not_seen_stays_at_rest(model):
    basis = np.zeros((2, len(model.vertices), 3))
    seen = np.arange(len(model.vertices)) < 100
    basis[0, :50, 2], basis[1, 150:200, 1] = 0.1, 0.1
    rows, turn = seen_directions(basis, seen)
    assert rows.shape[0] == 1
    displacement = basis.sum(axis=0).ravel()
    assert np.allclose(rows @ displacement @ turn, [1.0, 0.0])


def test_a_mask_of_another_length_or_of_nothing_is_refused(trained):
    head, person = trained.model.head, trained.model.person("s1")
    for mask in (np.ones(5, bool), np.zeros(len(head.vertices), bool)):
        with pytest.raises(InputError, match="mask of seen vertices"):
            SpeechFitter(head, person, seen=mask)
