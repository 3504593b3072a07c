"""Cameras and clocks against the true ones: gauge freedoms cost nothing, known errors come out as known."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.cameras import Rig
from headcap.errors import InputError
from headcap.evaluation.calibration import _align_centres, compare_rigs
from headcap.evaluation.sync import clock_shift_s, offset_error_ms
from headcap.geometry.transforms import from_vector, invert
from headcap.sync.offsets import TimeOffsets

START_S = {"a": 0.01, "b": 0.05, "c": 0.02}


def offsets(start_s: dict[str, float]) -> TimeOffsets:
    count = len(start_s)
    return TimeOffsets("take", tuple(start_s), tuple(start_s.values()), (0.0,) * count, (1.0,) * count, ("clap",) * count)


def test_a_common_shift_of_the_clock_is_no_error():
    shifted = offsets({camera: start + 0.3 for camera, start in START_S.items()})
    assert offset_error_ms(shifted, START_S) < 1e-10
    assert clock_shift_s(shifted, START_S) == pytest.approx(0.3, abs=1e-12)


def test_known_offsets_give_the_known_error():
    # one of three cameras 0.3 ms late: after the mean (0.1) the errors are 0.2, -0.1, -0.1, rms sqrt(0.06 / 3)
    late = offsets(START_S | {"b": START_S["b"] + 3e-4})
    assert offset_error_ms(late, START_S) == pytest.approx(np.sqrt(0.02), rel=1e-9)


def test_a_camera_the_truth_lacks_is_named():
    with pytest.raises(InputError, match="other"):
        offset_error_ms(offsets({"other": 0.0}), START_S)


def test_another_world_frame_is_no_error_and_is_found(moving_world):
    new_from_world = from_vector(np.array([0.3, -0.8, 0.4, 0.5, -1.0, 0.2]))
    errors = compare_rigs(moving_world.rig.transformed(new_from_world), moving_world.rig)
    assert errors.centre_error_mm < 1e-9
    # the angle of a rotation off by rounding (1e-16) is read through an arc sine of its square root at worst: 1e-8 rad
    assert errors.rotation_error_deg < 1e-6
    np.testing.assert_allclose(errors.truth_world_from_world, invert(new_from_world), atol=1e-12)


def test_a_turned_camera_gives_its_angle_and_no_centre_error(moving_world):
    cameras = list(moving_world.rig.cameras)
    turn = from_vector(np.array([0.0, np.radians(0.5), 0, 0, 0, 0]))
    cameras[2] = cameras[2].moved(turn @ cameras[2].camera_from_world)
    errors = compare_rigs(Rig(tuple(cameras)), moving_world.rig)
    assert errors.centre_error_mm < 1e-9
    assert errors.rotation_error_deg == pytest.approx(0.5 / np.sqrt(5), rel=1e-6)


def test_worlds_are_aligned_by_what_the_cameras_see(moving_world):
    # Every camera is moved back by 1 % of its distance and its focal length made 1 % longer: pictures of the subject's
    # place hardly change, centres do. The alignment of worlds must not follow the centres.
    cameras = []
    for camera in moving_world.rig:
        matrix = camera.matrix * np.array([[1.01], [1.01], [1.0]])
        matrix[:2, 2] = camera.matrix[:2, 2]
        back = np.eye(4)
        back[2, 3] = 0.01 * np.linalg.norm(camera.centre)
        cameras.append(replace(camera, matrix=matrix, camera_from_world=back @ camera.camera_from_world))
    errors = compare_rigs(Rig(tuple(cameras)), moving_world.rig)
    assert errors.centre_error_mm > 0.5
    # the cameras all stand on one side, so an alignment of centres shifts the subject by several millimetres; what is
    # left of the picture's change is second order: 1 % of a tenth of the distance, 0.5 mm, at the grid's corners, and
    # it has no preferred direction but along the cameras' mean axis
    by_centres = _align_centres(Rig(tuple(cameras)), moving_world.rig)
    assert np.linalg.norm(by_centres[:3, 3]) > 2e-3
    assert np.linalg.norm(errors.truth_world_from_world[:3, 3]) < 2e-4


def test_two_cameras_on_a_line_are_aligned_by_their_rotations(moving_world):
    pair = Rig(moving_world.rig.cameras[:2])
    new_from_world = from_vector(np.array([0.3, -0.8, 0.4, 0.5, -1.0, 0.2]))
    errors = compare_rigs(pair.transformed(new_from_world), moving_world.rig)
    assert errors.centre_error_mm < 1e-9
    assert errors.rotation_error_deg < 1e-6
