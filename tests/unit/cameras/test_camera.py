"""Laws of one camera: Jacobian, ray through pixel, scaling, JSON."""

import numpy as np
import pytest

from headcap.cameras import Camera, Rig
from headcap.geometry.transforms import from_vector


@pytest.fixture
def camera() -> Camera:
    matrix = np.array([[1630.0, 0, 262.0], [0, 1633.0, 488.0], [0, 0, 1]])
    pose = from_vector(np.array([0.1, 2.8, -0.2, 0.02, -0.03, 0.9]))
    return Camera("cam00", 540, 960, matrix, [-0.1, 0.05, 0.001, -0.002, 0.02], pose)


@pytest.fixture
def points(camera) -> np.ndarray:
    local = np.random.default_rng(0).uniform([-0.1, -0.2, 0.8], [0.1, 0.2, 1.0], (50, 3))
    return (local - camera.camera_from_world[:3, 3]) @ camera.camera_from_world[:3, :3]


def test_jacobian_is_the_finite_difference(camera, points):
    pixels, jacobian = camera.project_with_jacobian(points)
    step = 1e-6  # metres; central differences err by step^2 * third derivative (~1e4 px/m^3) plus 1e-12/step rounding
    numeric = np.stack(
        [(camera.project(points + step * axis)[0] - camera.project(points - step * axis)[0]) / (2 * step) for axis in np.eye(3)],
        -1,
    )
    assert np.abs(jacobian - numeric).max() < 1e-5 * np.abs(jacobian).max()
    np.testing.assert_allclose(pixels, camera.project(points)[0], atol=1e-9)


def test_the_ray_of_a_pixel_meets_its_point(camera, points):
    pixels, _ = camera.project(points)
    towards = points - camera.centre
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    # the iterative undistortion stops at 1e-12 of the image plane; 1e-9 rad is a nanometre at a metre
    assert np.abs(camera.rays(pixels) - towards).max() < 1e-9


def test_scaling_follows_image_resizing(camera, points):
    # cv2.resize maps pixel x to (x + 0.5) * factor - 0.5
    pixels, _ = camera.project(points)
    half, _ = camera.scaled(0.5).project(points)
    np.testing.assert_allclose(half, (pixels + 0.5) * 0.5 - 0.5, atol=1e-9)


def test_points_behind_the_camera_have_no_pixel(camera):
    behind = camera.centre - camera.axis
    assert np.isnan(camera.project(behind[None])[0]).all()


def test_moving_the_world_leaves_the_images(camera, points):
    new_from_world = from_vector(np.array([0.3, -0.2, 0.9, 1.0, 2.0, 3.0]))
    moved = Rig((camera,)).transformed(new_from_world)[0]
    shifted = points @ new_from_world[:3, :3].T + new_from_world[:3, 3]
    np.testing.assert_allclose(moved.project(shifted)[0], camera.project(points)[0], atol=1e-8)


def test_json_round_trip_is_exact(camera):
    again = Rig.from_json(Rig((camera,)).to_json())["cam00"]
    assert np.array_equal(again.matrix, camera.matrix)
    assert np.array_equal(again.camera_from_world, camera.camera_from_world)


def test_bad_shapes_are_named(camera):
    with pytest.raises(ValueError, match="cam00: distortion"):
        Camera("cam00", 540, 960, camera.matrix, np.zeros(4), camera.camera_from_world)


def test_equal_names_are_refused(camera):
    with pytest.raises(ValueError, match="names must differ"):
        Rig((camera, camera))
