import numpy as np
import pytest

from headcap.sync import SyncSettings, refine_clapper
from headcap.sync.clapper import flight_sensitivity_s_per_m

TRUE, ROUGH = np.array([0.03, -0.10, 0.28]), np.array([-0.05, -0.02, 0.40])


@pytest.fixture
def centres(rng) -> dict[str, np.ndarray]:
    """Fourteen cameras on an arc around a face, in two rows."""
    angles = np.linspace(-1.4, 1.4, 14)
    rows = np.where(np.arange(14) % 2, 0.25, -0.25)
    return {f"cam{c}": np.array([0.7 * np.sin(a), y, 0.7 * np.cos(a)]) for c, (a, y) in enumerate(zip(angles, rows, strict=True))}


def _difference(centres: dict, place: np.ndarray) -> dict[str, float]:
    """What pictures say minus what sound says when the clapper was taken to be at ROUGH."""
    speed = SyncSettings().speed_of_sound
    return {k: (np.linalg.norm(c - place) - np.linalg.norm(c - ROUGH)) / speed + 0.0123 for k, c in centres.items()}


def test_the_clapper_is_found_from_exact_differences(centres) -> None:
    found = refine_clapper(centres, _difference(centres, TRUE), ROUGH, picture_std_s=1e-6)
    # the prior of 0.15 m is 1e-4 as strong as 14 measurements good to 0.3 mm of sound path
    np.testing.assert_allclose(found.clapper_m, TRUE, atol=1e-4)
    assert set(found.av_offset_s.values()) == {0.0}


def test_its_stated_error_is_honest_under_noise(centres, rng) -> None:
    exact, errors = _difference(centres, TRUE), []
    for _ in range(40):
        noisy = {camera: value + 5e-5 * rng.standard_normal() for camera, value in exact.items()}
        found = refine_clapper(centres, noisy, ROUGH, picture_std_s=5e-5)
        errors.append((found.clapper_m - TRUE) / found.clapper_std_m)
    # 40 x 3 draws of unit variance: rms 1 +- 0.06, widened for the robust loss, which gives up some efficiency
    assert 0.7 < np.sqrt(np.mean(np.square(errors))) < 1.4


def test_delays_of_single_cameras_are_named_and_do_not_pull_the_place(centres, rng) -> None:
    difference = {camera: value + 1e-5 * rng.standard_normal() for camera, value in _difference(centres, TRUE).items()}
    difference["cam3"] += 0.021
    difference["cam9"] -= 0.0015
    found = refine_clapper(centres, difference, ROUGH, picture_std_s=1e-5)
    assert {camera for camera, value in found.av_offset_s.items() if value} == {"cam3", "cam9"}
    # 1e-5 s is 3.4 mm of path; the geometry weakens it by about 3 at the most
    np.testing.assert_allclose(found.clapper_m, TRUE, atol=0.02)
    assert found.av_offset_s["cam3"] == pytest.approx(0.021, abs=8e-5)
    assert found.av_offset_s["cam9"] == pytest.approx(-0.0015, abs=8e-5)


def test_too_few_cameras_leave_the_rough_place(centres) -> None:
    few = dict(list(_difference(centres, TRUE).items())[:4])
    found = refine_clapper(centres, few, ROUGH)
    np.testing.assert_array_equal(found.clapper_m, ROUGH)
    assert set(found.av_offset_s.values()) == {0.0}


def test_sensitivity_is_the_slope_of_the_start_times(centres) -> None:
    slope = flight_sensitivity_s_per_m(centres, ROUGH)
    places, speed = np.array(list(centres.values())), SyncSettings().speed_of_sound
    for axis in range(3):
        moved = ROUGH + 1e-5 * np.eye(3)[axis]
        change = (np.linalg.norm(places - moved, axis=1) - np.linalg.norm(places - ROUGH, axis=1)) / speed
        assert slope[axis] == pytest.approx(change.std() / 1e-5, rel=1e-3)


def test_worse_start_times_than_stated_do_not_throw_the_clapper_about(centres, rng) -> None:
    exact, errors = _difference(centres, TRUE), []
    for _ in range(20):
        noisy = {camera: value + 1e-3 * rng.standard_normal() for camera, value in exact.items()}
        errors.append(np.linalg.norm(refine_clapper(centres, noisy, ROUGH, picture_std_s=5e-5).clapper_m - TRUE))
    # 1 ms of noise is 0.34 m of path; trusted as 0.05 ms it would throw the place by that much and more
    assert np.mean(errors) < 2 * np.linalg.norm(ROUGH - TRUE)
