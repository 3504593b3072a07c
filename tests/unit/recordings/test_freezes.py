"""A freeze is told from a pause of the subject, and from a camera that sees less than the others."""

import numpy as np
import pytest

from headcap.recordings.freezes import find_freezes
from headcap.recordings.settings import IngestSettings

RATE = 60
SETTINGS = IngestSettings()
STARTS = {"cam0": 0.0, "cam1": -0.111, "cam2": -0.052, "cam3": -0.205}


def scene(time_s: np.ndarray) -> np.ndarray:
    """Motion in grey values: still until 0.4 s, then never less than 10, but for a pause from 1.0 to 1.2 s."""
    moving = 20 + 10 * np.sin(2 * np.pi * 3 * time_s)
    return np.where((time_s < 0.4) | ((time_s >= 1.0) & (time_s < 1.2)), 0.8, moving)


@pytest.fixture
def changes() -> dict:
    """Four cameras that start at their own moments and film two seconds."""
    own_s = np.arange(120) / RATE
    return {camera: (own_s, scene(own_s + start)) for camera, start in STARTS.items()}


def freeze(changes: dict, camera: str, first: int, last: int) -> None:
    own_s, change = changes[camera]
    changes[camera] = (own_s, np.where((np.arange(len(own_s)) >= first) & (np.arange(len(own_s)) <= last), 0.3, change))


@pytest.mark.parametrize("start_s", [STARTS, None])
def test_pauses_that_all_cameras_see_are_no_freeze(changes, start_s) -> None:
    assert find_freezes(changes, RATE, SETTINGS, start_s=start_s) == []


def test_a_short_freeze_is_found_once_start_times_are_known(changes) -> None:
    freeze(changes, "cam1", 40, 49)
    (found,) = find_freezes(changes, RATE, SETTINGS, start_s=STARTS)
    assert (found.camera, found.cameras_compared, found.cameras_moving) == ("cam1", 3, 3)
    # frames of two cameras are matched to within one frame, the 120th of a second by half of one
    assert found.from_s == pytest.approx(40 / RATE, abs=1.5 / RATE)
    assert found.until_s == pytest.approx(49 / RATE, abs=1.5 / RATE)
    # shorter than the pauses: without start times it may be one of them
    assert find_freezes(changes, RATE, SETTINGS) == []


def test_a_freeze_longer_than_any_pause_needs_no_start_times() -> None:
    own_s = np.arange(120) / RATE
    changes = {camera: (own_s, scene(own_s + start + 0.5)) for camera, start in STARTS.items()}
    freeze(changes, "cam2", 60, 100)
    (found,) = find_freezes(changes, RATE, SETTINGS)
    assert found.camera == "cam2"
    assert found.until_s == pytest.approx(100 / RATE, abs=1e-9)


def test_a_camera_that_stays_frozen_until_the_end(changes) -> None:
    freeze(changes, "cam3", 90, 119)
    assert [found.camera for found in find_freezes(changes, RATE, SETTINGS, start_s=STARTS)] == ["cam3"]


def test_a_camera_that_sees_less_is_not_frozen(changes) -> None:
    # from behind only what moves much is seen: everything in the scene's second half is hidden
    own_s, change = changes["cam1"]
    strong = np.where(change > 25, change, 0.5)
    assert find_freezes(changes | {"cam1": (own_s, strong)}, RATE, SETTINGS, start_s=STARTS) == []
    assert find_freezes(changes | {"cam1": (own_s, np.full(120, 0.5))}, RATE, SETTINGS, start_s=STARTS) == []


def test_one_moving_witness_of_three_is_not_enough(changes) -> None:
    for camera in ("cam0", "cam1", "cam2"):
        freeze(changes, camera, 40 - round(STARTS[camera] * RATE), 52 - round(STARTS[camera] * RATE))
    assert find_freezes(changes, RATE, SETTINGS, start_s=STARTS) == []


def test_dropped_frames_are_motion_and_no_freeze(changes) -> None:
    own_s, change = changes["cam0"]
    kept = np.setdiff1d(np.arange(120), np.arange(40, 50))
    assert find_freezes(changes | {"cam0": (own_s[kept], change[kept])}, RATE, SETTINGS, start_s=STARTS) == []
