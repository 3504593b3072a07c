"""Laws of rigid transforms: inverse, composition, bijective vectors, recovered fits."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from headcap.geometry.transforms import fit_rigid, fit_similarity, from_vector, invert, rotation_angle, to_vector, transform

# float64 chains of a few products of unit-sized numbers keep 1e-12
EXACT = 1e-12


@pytest.fixture
def poses() -> np.ndarray:
    random = np.random.default_rng(7)
    vectors = random.normal(size=(2, 5, 6))
    vectors[0, 0, :3] *= 1e-7  # near the identity, where logarithms lose digits
    return from_vector(vectors)


def test_inverse_undoes(poses):
    assert np.abs(invert(poses) @ poses - np.eye(4)).max() < EXACT


def test_vector_form_is_bijective(poses):
    assert np.abs(from_vector(to_vector(poses)) - poses).max() < EXACT


def test_transform_composes(poses):
    points = np.random.default_rng(1).normal(size=(9, 3))
    chained = transform(poses[0, 1], transform(poses[1, 2], points))
    assert np.abs(chained - transform(poses[0, 1] @ poses[1, 2], points)).max() < EXACT


def test_rotation_angle_is_the_rotvec_length():
    angle = 0.3
    rotation = Rotation.from_rotvec([0, angle, 0]).as_matrix()
    assert abs(float(rotation_angle(rotation)) - angle) < EXACT


def test_fits_recover_what_moved_the_points(poses):
    source = np.random.default_rng(2).normal(size=(20, 3))
    found = fit_rigid(source, transform(poses[0, 3], source))
    assert np.abs(found - poses[0, 3]).max() < 1e-10
    rigid, scale = fit_similarity(source, transform(poses[0, 4], 1000 * source))
    assert abs(scale - 1000) < 1e-7
    assert np.abs(rigid - poses[0, 4]).max() < 1e-7


def test_planar_points_never_give_a_reflection():
    source = np.random.default_rng(3).normal(size=(20, 3)) * [1, 1, 0]
    found = fit_rigid(source, source + 1e-9)
    assert np.linalg.det(found[:3, :3]) == pytest.approx(1.0)


def test_too_few_points_are_refused():
    with pytest.raises(ValueError, match=r"n >= 3"):
        fit_rigid(np.zeros((2, 3)), np.zeros((2, 3)))
