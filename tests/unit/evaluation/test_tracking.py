"""Tracked meshes against the true surface: sliding shows as drift alone, lifting as both, lips by their own points."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.cameras import Rig
from headcap.evaluation.reconstruction import compare_cloud, summarise_clouds
from headcap.evaluation.settings import EvaluateSettings
from headcap.evaluation.ties import at_border, tie
from headcap.evaluation.tracking import TrackingErrors, compare_sequence
from headcap.evaluation.truth import Truth
from headcap.geometry.transforms import from_vector, invert, transform


def compare(world, positions, tmp_path, *, regions=None, rig=None, alignment=None, shift_s=0.0):
    return compare_sequence(
        world.sequence(np.asarray(positions), tmp_path),
        world.template(regions),
        Truth(world.folder),
        rig=rig or world.rig,
        truth_world_from_world=np.eye(4) if alignment is None else alignment,
        clock_shift_s=shift_s,
        settings=EvaluateSettings(),
    )


def lips(world):
    rows = np.arange(41 * 41) // 41
    return {"lips_upper": (rows >= 8) & (rows <= 12), "lips_inner_lower": (rows >= 28) & (rows <= 32)}


def test_truth_tracks_itself_without_error(moving_world, tmp_path):
    truth = [moving_world.motion(t) for t in moving_world.time_s]
    figures = compare(moving_world, truth, tmp_path, regions=lips(moving_world)).figures()
    # truth is stored in steps of 4 um: half a step per axis, sqrt(3) times, at the tie and later
    assert all(value <= 2 * 1e3 * 2.1e-6 * np.sqrt(3) for value in figures.values())


def test_sliding_is_drift_and_no_surface_error(still_world, tmp_path):
    plane = still_world.motion(0.0)
    slide = np.array([3e-4, 0, 0])
    errors = compare(still_world, [plane, plane + slide, plane + slide, plane + slide], tmp_path)
    later = errors.seen[1:] & np.isfinite(errors.surface_mm[1:])
    np.testing.assert_allclose(errors.drift_mm[1:][later], 0.3, atol=1e-5)
    # float32 storage of 0.1 m moves a vertex by 4 nm; the sheet ends where it slid over its border
    inside = later & (plane[:, 0] < 0.0995)
    assert errors.surface_mm[1:][inside].max() < 1e-4
    assert errors.figures()["track.drift_p95_mm"] == pytest.approx(0.3, abs=1e-5)


def test_a_lift_along_the_normals_is_the_surface_error(still_world, tmp_path):
    plane = still_world.motion(0.0)
    errors = compare(still_world, [plane] + [plane + np.array([0, 0, 2e-4])] * 3, tmp_path)
    assert errors.figures()["track.surface_error_median_mm"] == pytest.approx(0.2, abs=1e-5)
    assert errors.figures()["track.drift_median_mm"] == pytest.approx(0.2, abs=1e-5)


def test_world_frame_and_clock_are_no_error(moving_world, tmp_path):
    new_from_world = from_vector(np.array([0.3, -0.8, 0.4, 0.5, -1.0, 0.2]))
    shift_s = 0.0013
    positions = [transform(new_from_world, moving_world.motion(t - shift_s)) for t in moving_world.time_s]
    rig = moving_world.rig.transformed(new_from_world)
    figures = compare(moving_world, positions, tmp_path, rig=rig, alignment=invert(new_from_world), shift_s=shift_s).figures()
    # float32 at 1 m: 0.06 um; truth's own step 3.6 um twice; the cubic a tenth of a frame (0.08) before the first one:
    # 0.08 * 1.08 * 2.08 * 3.08 / 24 * 1.13e-4 m = 2.6 um
    assert figures["track.drift_p95_mm"] < 0.0102


def test_lip_gap_follows_the_material_points(still_world, tmp_path):
    plane = still_world.motion(0.0)
    opened = plane.copy()
    opened[:, 1] += np.where(plane[:, 1] > 0, 0.001, 0.0)
    errors = compare(still_world, [plane, opened, plane, opened], tmp_path, regions=lips(still_world))
    # the true points rest 100 mm apart; the upper rows move away by 1 mm in half of the frames
    np.testing.assert_allclose(errors.true_lip_gap_mm, 100.0, atol=1e-5)
    np.testing.assert_allclose(errors.lip_gap_mm, [100, 101, 100, 101], atol=1e-4)
    assert errors.figures()["track.lip_gap_error_mm"] == pytest.approx(np.sqrt(0.5), abs=1e-4)


def test_a_template_without_lips_measures_no_gap(still_world, tmp_path):
    errors = compare(still_world, [still_world.motion(0.0)] * 4, tmp_path)
    assert np.isnan(errors.figures()["track.lip_gap_error_mm"])


def test_a_rig_that_sees_nothing_measures_nothing(still_world, tmp_path):
    rig = Rig(still_world.rig.cameras[:2])  # two cameras, three are asked for
    truth = Truth(still_world.folder)
    sequence = still_world.sequence(np.asarray([still_world.motion(0.0)] * 4), tmp_path)
    pair = replace(truth)
    pair.__dict__["rig"] = rig
    errors = compare_sequence(
        sequence, still_world.template(), pair, rig=rig, truth_world_from_world=np.eye(4), clock_shift_s=0.0
    )
    assert np.isnan(errors.figures()["track.drift_median_mm"])
    cloud = compare_cloud(still_world.motion(0.0), still_world.motion(0.0), still_world.triangles, rig)
    figures = summarise_clouds([cloud])
    assert np.isnan(figures["reconstruct.completeness_1mm"])
    assert figures["reconstruct.error_p90_mm"] < 1e-9


def test_errors_come_back_from_disk(still_world, tmp_path):
    errors = compare(still_world, [still_world.motion(0.0)] * 4, tmp_path)
    errors.save(tmp_path / "errors.npz")
    again = TrackingErrors.load(tmp_path / "errors.npz")
    np.testing.assert_array_equal(again.seen, errors.seen)
    assert again.figures() == pytest.approx(errors.figures(), nan_ok=True)


def test_ties_keep_to_the_side_they_face():
    # two sheets 1 mm apart that face each other, as lips do: a point nearer to the wrong one is tied to its own
    triangles = np.array([[0, 1, 2], [3, 5, 4]], np.int32)
    lower = np.array([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]])
    vertices = np.concatenate([lower, lower + np.array([0, 0, 1e-3])])
    found = tie(np.array([[0.0, 0, 8e-4]]), np.array([[0.0, 0, 1.0]]), vertices, triangles)
    assert found.triangle.tolist() == [0]
    assert found.distance_m[0] == pytest.approx(8e-4)
    # nothing that faces sideways lies within reach
    assert tie(np.array([[0.0, 0, 8e-4]]), np.array([[1.0, 0, 0]]), vertices, triangles).tied.tolist() == [False]


def test_border_is_where_the_surface_ends(still_world):
    triangles = still_world.triangles
    centre, rim = np.array([[1 / 3, 1 / 3, 1 / 3]]), np.array([[0.5, 0.5, 0.0]])
    # triangle 0 is the grid's first: corners (0, 0), (0, 1), (1, 1); its first edge is on the border
    assert not at_border(np.array([0]), centre, triangles)[0]
    assert at_border(np.array([0]), rim, triangles)[0]
    assert not at_border(np.array([41 * 20]), rim, triangles)[0]


@pytest.mark.real
def test_recorded_head_tracks_itself_without_error(test_data, tmp_path):
    from headcap.registration import MeshSequence, Template
    from headcap.registration.sequence import save_chunk

    truth = Truth(test_data / "ict_rig" / "truth")
    take = truth.take("pose_01")
    save_chunk(tmp_path / "chunk.npy", np.stack([take.frame(k) for k in range(2)]))
    template = Template(take.frame(0), truth.triangles, np.zeros((1, 2)), np.zeros_like(truth.triangles))
    errors = compare_sequence(
        MeshSequence("pose_01", take.time_s[:2], (tmp_path / "chunk.npy",)),
        template,
        truth,
        rig=truth.rig,
        truth_world_from_world=np.eye(4),
        clock_shift_s=0.0,
    )
    # float32 storage at 0.2 m: 7.5 nm per axis
    assert np.nanmax(errors.drift_mm) < 3e-5
    assert 0.6 < errors.seen.mean() < 0.95
