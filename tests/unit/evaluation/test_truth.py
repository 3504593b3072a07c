"""Truth folders: what they hold, and the true surface between frames."""

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.evaluation.truth import Truth


def test_folder_without_rig_is_refused_with_remedy(tmp_path):
    with pytest.raises(InputError, match=r"rig\.json"):
        Truth(tmp_path)


def test_cameras_times_and_scan_come_back(moving_world):
    truth = Truth(moving_world.folder)
    assert truth.takes == ("take",)
    assert truth.rig.names == moving_world.rig.names
    np.testing.assert_array_equal(truth.rig.centres, moving_world.rig.centres)
    assert list(truth.start_s("take").values()) == list(moving_world.start_s)
    np.testing.assert_allclose(truth.scan.world_from_scan(np.array([[1.0, 2.0, 1003.0]])), [[0, 0, 1.0]], atol=1e-15)


def test_frames_are_exact_to_the_step_they_are_stored_in(moving_world):
    take = Truth(moving_world.folder).take("take")
    # half a step of 4 um from rounding, 0.02 um from float32 at 0.2 m
    for number in (0, 5, 11):
        np.testing.assert_allclose(take.frame(number), moving_world.motion(take.time_s[number]), atol=2.1e-6)
        np.testing.assert_array_equal(take.at(take.time_s[number]), take.frame(number))


def test_moments_between_frames_follow_the_motion(moving_world):
    take = Truth(moving_world.folder).take("take")
    # Cubic through four nodes, error |prod(t - t_i)| / 24 of the 4th derivative. Inside the take the product is at most
    # (9/16) h^4, in the first and last interval and half a frame beyond (105/16) h^4. The swing is 0.01 m * |(1, .5, .3)|
    # at 2 pi 3 / s, so h = 1/60 s: A (w h)^4 = 0.0116 * 0.00974 = 1.13e-4 m. Rounding adds 2.1 um times the sum of weights.
    swing = 0.01 * np.linalg.norm([1.0, 0.5, 0.3]) * (2 * np.pi * 3 / 60) ** 4
    for offset, product in ((5.5, 9 / 16), (5.2, 9 / 16), (11.4, 105 / 16), (-0.4, 105 / 16)):
        time_s = take.time_s[0] + offset / 60
        error = np.linalg.norm(take.at(time_s) - moving_world.motion(time_s), axis=1).max()
        assert error <= product / 24 * swing + 6 * 2.1e-6 * np.sqrt(3)


def test_moments_outside_the_take_are_refused(moving_world):
    take = Truth(moving_world.folder).take("take")
    with pytest.raises(ValueError, match="truth spans"):
        take.at(take.time_s[-1] + 0.6 / 60)


@pytest.mark.real
def test_recorded_heads_truth_reads(test_data):
    truth = Truth(test_data / "ict_rig" / "truth")
    assert len(truth.rig) == 16
    assert truth.takes == ("pose_01", "expression_01", "speech_01")
    surface = truth.take("expression_01").frame(0)
    assert surface.shape == (52195, 3)
    upper, lower = truth.inner_lip_middle
    # closed lips: the inner contours nearly touch, the upper one above
    assert 0 < surface[upper, 1] - surface[lower, 1] < 0.002
