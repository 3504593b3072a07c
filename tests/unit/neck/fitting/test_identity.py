"""Shape coefficients come back from a neutral mesh, a sequence and landmarks, wherever the head stands; energy never rises."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.geometry.transforms import from_vector, transform
from headcap.heads import HeadCoefficients, procedural_model
from headcap.neck.fitting.identity import IdentitySettings, fit_identity, fit_identity_to_points, fit_identity_to_sequence

PLACED = from_vector(np.array([0.4, -2.0, 0.3, 0.5, 1.4, -0.2]))


@pytest.fixture(scope="module")
def many():
    """The base head with modes of both kinds."""
    return procedural_model(12, 10, np.float64)


@pytest.fixture(scope="module")
def beta():
    return np.random.default_rng(4).normal(0, 1.0, 12)


def test_a_neutral_mesh_gives_its_shape_back_from_anywhere(many, beta, rng):
    mesh = transform(PLACED, many.identity(beta)) + rng.normal(0, 2e-4, many.vertices.shape)
    found = fit_identity(many, mesh, IdentitySettings(noise_mm=0.2))
    # a mode is 1 to 3 mm over 12,813 vertices: noise of 0.2 mm tells each to a hundredth at worst; the prior pulls by less
    assert np.abs(found.beta - beta).max() < 0.02
    assert np.linalg.norm(transform(found.placement, found.identity) - mesh, axis=1).mean() < 1.05 * 1.6 * 2e-4
    assert found.error_mm == pytest.approx(1e3 * np.linalg.norm(transform(found.placement, found.identity) - mesh, axis=1).mean())
    assert (np.diff(found.energy) <= 1e-9 * found.energy[0]).all()


def test_unseen_and_missing_vertices_tell_nothing(many, beta):
    mesh = transform(PLACED, many.identity(beta))
    seen = many.vertices[:, 2] > -0.02
    spoilt = mesh.copy()
    spoilt[~seen] += 0.05
    spoilt[::50] = np.nan
    found = fit_identity(many, spoilt, IdentitySettings(noise_mm=0.05), seen)
    assert np.abs(found.beta - beta).max() < 0.02


def test_landmarks_give_what_they_can_of_the_shape(many, beta, rng):
    vertices = np.array(sorted(many.landmarks.values()))
    true = transform(PLACED, many.identity(beta))
    found = fit_identity_to_points(many, vertices, true[vertices] + rng.normal(0, 3e-4, (len(vertices), 3)))
    mean = fit_identity_to_points(many, vertices, true[vertices], IdentitySettings(noise_mm=1e4))
    face = many.regions["face"]

    def error(fit) -> float:
        return float(np.linalg.norm(transform(fit.placement, fit.identity) - true, axis=1)[face].mean())

    assert error(found) < 0.35 * error(mean)
    assert found.error_mm < 1.0


def test_a_moving_face_gives_the_shape_of_the_still_one(many, beta, rng):
    f = 24
    pose = np.zeros((f, 2, 3))
    pose[:, 0] = 0.2 * rng.normal(size=(f, 3))
    pose[:, 1, 0] = 0.15 * rng.random(f)
    placement = np.tile(PLACED, (f, 1, 1))
    psi = rng.normal(0, 1.0, (f, 10))
    psi -= psi.mean(axis=0)
    meshes = many.evaluate(HeadCoefficients(shape=beta, expression=psi, pose=pose, placement=placement))
    meshes += rng.normal(0, 2e-4, meshes.shape)
    found = fit_identity_to_sequence(many, meshes, IdentitySettings(noise_mm=0.2, rounds=4))
    # shape and mean expression overlap in the face; the mean psi of 24 frames is taken as 0 within 1 / sqrt(24) = 0.2
    assert np.abs(found.beta - beta).max() < 0.2
    away = np.linalg.norm(found.identity - many.identity(beta), axis=1)
    assert away.mean() < 0.3e-3
    assert found.error_mm < 0.5
    broken = np.concatenate([meshes, np.full((1, *meshes.shape[1:]), np.nan)])
    assert np.isfinite(fit_identity_to_sequence(many, broken, IdentitySettings(rounds=2)).beta).all()


def test_what_cannot_be_fitted_is_refused(many, model):
    mesh = np.array(many.vertices)
    with pytest.raises(InputError, match="topology"):
        fit_identity(many, mesh[:-1])
    with pytest.raises(InputError, match="no shape basis"):
        fit_identity(many.personal(mesh), mesh)
    with pytest.raises(InputError, match="3 points"):
        fit_identity_to_points(many, np.arange(3), mesh[:3])
    with pytest.raises(InputError, match="is finite"):
        fit_identity_to_sequence(many, np.full((2, *mesh.shape), np.nan))
    with pytest.raises(InputError, match="shape basis"):
        fit_identity_to_sequence(replace(many, shape_basis=many.shape_basis[:0]), mesh[None])
