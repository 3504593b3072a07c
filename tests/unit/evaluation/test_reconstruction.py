"""Points against a surface: known distances and known coverage come out as known."""

import numpy as np
import pytest

from headcap.cameras import Rig
from headcap.evaluation.reconstruction import compare_cloud, sample_surface, summarise_clouds
from headcap.evaluation.settings import EvaluateSettings
from headcap.geometry.transforms import from_vector, transform
from headcap.meshes.visibility import count_cameras

SETTINGS = EvaluateSettings(surface_samples=20_000)


def test_points_lifted_off_a_plane_are_as_far_as_they_were_lifted(still_world):
    plane = still_world.motion(0.0)
    points, normals = sample_surface(plane, still_world.triangles, 30_000)
    lift = np.where(np.arange(len(points)) % 4 == 0, 2e-3, 2e-4)[:, None]
    figures = summarise_clouds([compare_cloud(points + lift * normals, plane, still_world.triangles, still_world.rig, SETTINGS)])
    assert figures["reconstruct.error_median_mm"] == pytest.approx(0.2, abs=1e-6)
    assert figures["reconstruct.error_p90_mm"] == pytest.approx(2.0, abs=1e-6)


def test_completeness_is_the_share_that_has_points(still_world):
    plane = still_world.motion(0.0)
    points, _ = sample_surface(plane, still_world.triangles, 400_000)
    half = points[points[:, 0] < 0]
    figures = summarise_clouds([compare_cloud(half, plane, still_world.triangles, still_world.rig, SETTINGS)])
    # All of the sheet is seen, so half of 200 mm plus the reach of 0.5 and 1 mm across the border is covered. Points lie
    # 0.3 mm apart, 20,000 samples give the share to 0.3 % (one sigma).
    assert figures["reconstruct.completeness_half_mm"] == pytest.approx(50.25, abs=1.0)
    assert figures["reconstruct.completeness_1mm"] == pytest.approx(50.5, abs=1.0)


def test_cameras_that_have_stopped_see_nothing(still_world):
    plane, triangles, rig = still_world.motion(0.0), still_world.triangles, still_world.rig
    points, normals = sample_surface(plane, triangles, 160_000)
    facing = dict(max_angle_deg=SETTINGS.max_angle_deg)
    some = Rig(tuple(rig)[: SETTINGS.min_cameras])
    covered = points[count_cameras(some, plane, triangles, points, normals, **facing) >= SETTINGS.min_cameras]
    asked = len(covered) < len(points)
    now = summarise_clouds([compare_cloud(covered, plane, triangles, rig, SETTINGS, recording=some.names)])
    # four points to a square millimetre: exp(-4 pi) of what the three see has none within 1 mm, but for the rim of their view
    assert now["reconstruct.completeness_1mm_recording"] > 97
    whole = summarise_clouds([compare_cloud(covered, plane, triangles, rig, SETTINGS)])
    # the figure that has a limit counts the whole rig, whoever was recording
    assert whole["reconstruct.completeness_1mm"] == pytest.approx(now["reconstruct.completeness_1mm"])
    assert whole["reconstruct.completeness_1mm"] == pytest.approx(whole["reconstruct.completeness_1mm_recording"])
    assert (now["reconstruct.completeness_1mm"] < now["reconstruct.completeness_1mm_recording"] - 1) == asked
    none = summarise_clouds([compare_cloud(points, plane, triangles, rig, SETTINGS, recording=())])
    assert np.isnan(none["reconstruct.completeness_1mm_recording"])


def test_figures_do_not_depend_on_the_world_frame(moving_world, rng):
    surface = moving_world.motion(0.1)
    points, normals = sample_surface(surface, moving_world.triangles, 5_000)
    points = points + normals * rng.normal(0, 1e-4, (len(points), 1))
    new_from_world = from_vector(np.array([0.3, -0.8, 0.4, 0.5, -1.0, 0.2]))
    here = compare_cloud(points, surface, moving_world.triangles, moving_world.rig, SETTINGS)
    there = compare_cloud(
        transform(new_from_world, points),
        transform(new_from_world, surface),
        moving_world.triangles,
        moving_world.rig.transformed(new_from_world),
        SETTINGS,
    )
    np.testing.assert_allclose(there.point_error_mm, here.point_error_mm, atol=1e-5)
    for name, value in summarise_clouds([here]).items():
        # samples on the edge of sight may change sides by rounding: 0.1 % of them is generous
        assert summarise_clouds([there])[name] == pytest.approx(value, abs=0.1 if "completeness" in name else 1e-5)


def test_samples_are_even_by_area(still_world):
    points, normals = sample_surface(still_world.motion(0.0), still_world.triangles, 40_000)
    counts = np.histogram2d(points[:, 0], points[:, 1], bins=10)[0]
    # 400 per cell; stratified along the area, so the scatter is below that of chance (sqrt(400) = 20)
    assert np.abs(counts - 400).max() < 80
    np.testing.assert_allclose(normals, np.tile([0.0, 0.0, 1.0], (len(points), 1)), atol=1e-12)


def test_sight_ends_behind_a_screen_beyond_the_angle_and_on_the_back(still_world):
    plane, triangles, rig = still_world.motion(0.0), still_world.triangles, still_world.rig
    points = np.array([[0.0, 0.0, 0.0], [0.03, 0.03, 0.0]])
    front = np.tile([0.0, 0.0, 1.0], (2, 1))
    assert count_cameras(rig, plane, triangles, points, front, max_angle_deg=75).tolist() == [5, 5]
    assert count_cameras(rig, plane, triangles, points, -front, max_angle_deg=75).tolist() == [0, 0]
    # only the first camera looks straight on; the next nearest is off by atan(0.18 / 0.5) = 20 degrees
    assert count_cameras(rig, plane, triangles, points[:1], front[:1], max_angle_deg=15).tolist() == [1]
    # the same sheet 5 cm nearer to the cameras hides what lies behind it
    assert count_cameras(rig, plane + np.array([0, 0, 0.05]), triangles, points, front, max_angle_deg=75).tolist() == [0, 0]
