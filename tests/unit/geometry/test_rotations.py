"""The exponential map is a rotation at every angle, and its derivative is that of finite differences."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from headcap.geometry.rotations import cross_matrices, rotation_derivatives, rotation_matrices

# both sides of where series take over, and where a naive quotient breaks
ANGLES = (0.0, 1e-12, 1e-8, 1e-4, 0.3, 0.4999, 0.5001, 2.0, np.pi, 6.0)


@pytest.fixture
def directions(rng):
    v = rng.normal(size=(3, 5, 3))
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


@pytest.mark.parametrize("angle", ANGLES)
def test_matrices_agree_with_quaternions(directions, angle):
    expected = Rotation.from_rotvec((angle * directions).reshape(-1, 3)).as_matrix().reshape(3, 5, 3, 3)
    assert np.allclose(rotation_matrices(angle * directions), expected, atol=4e-16 * 8, rtol=0)


@pytest.mark.parametrize("angle", ANGLES)
def test_derivative_is_that_of_finite_differences(directions, angle):
    vectors, step = angle * directions, 1e-5
    rotation, derivative = rotation_derivatives(vectors)
    assert np.array_equal(rotation, rotation_matrices(vectors))
    moved = [rotation_matrices(vectors + step * e) - rotation_matrices(vectors - step * e) for e in np.eye(3)]
    # central differences err by step^2 / 6 of a third derivative (at most a few) and by rounding, eps / step
    assert np.abs(derivative - np.stack(moved, axis=-3) / (2 * step)).max() < 5 * step**2 + 2e-16 / step * 4


def test_derivative_is_smooth_where_series_take_over():
    below, above = (rotation_derivatives(np.array([angle, 0.0, 0.0]))[1] for angle in (0.5 - 1e-13, 0.5 + 1e-13))
    assert np.abs(below - above).max() < 1e-12


def test_single_precision_stays_single(directions):
    vectors = (0.7 * directions).astype(np.float32)
    rotation, derivative = rotation_derivatives(vectors)
    assert rotation.dtype == derivative.dtype == np.float32
    assert np.abs(rotation - rotation_matrices(vectors.astype(float))).max() < 5e-7


def test_cross_matrix(rng):
    a, b = rng.normal(size=(2, 4, 3))
    assert np.allclose(np.einsum("nij,nj->ni", cross_matrices(a), b), np.cross(a, b))
