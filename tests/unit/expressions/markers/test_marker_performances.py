"""From a marker file to a performance: on the markers, on the mesh, and both the same where they meet (footnote 3)."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.expressions.markers import marker_performance, mesh_performance
from headcap.geometry.transforms import invert


def all_frames(performance):
    return np.concatenate(list(performance.blocks()))


def gapped(person):
    positions = person.take.positions_m.copy()
    positions[20:28, 12] = np.nan
    positions[70:75, 30:33] = np.nan
    return replace(person.take, positions_m=positions)


def test_markers_alone_move_as_they_truly_did(person):
    performance = marker_performance(gapped(person), rigid=person.rigid)
    assert performance.points == person.take.names[7:]
    assert performance.triangles.shape == (0, 3)
    true = person.head_positions[:, 7:] - person.head_positions[0, 7:]
    turned = true @ person.capture_from_head[0, :3, :3].T
    error_m = np.sqrt(((all_frames(performance) - turned) ** 2).sum(axis=2).mean())
    # noise of the frame and of the neutral one, and of the head's motion
    assert error_m < 2 * np.sqrt(2 * 3) * person.noise_m
    assert performance.figures["filled_places"] == 8 + 15
    assert performance.source == "synthetic (neutral: frame 0)"


def test_found_rigid_markers_stay_among_the_points_and_give_the_same_motion(person):
    named = marker_performance(person.take, rigid=person.rigid)
    found = marker_performance(person.take)
    assert found.points == person.take.names
    difference = all_frames(found)[:, 7:] - all_frames(named)
    # the markers found hold still to half a millimetre of distance, not exactly
    assert np.sqrt((difference**2).sum(axis=2).mean()) < 0.5e-3


def test_the_mesh_moves_as_it_truly_did_and_as_the_markers_do(person):
    head = person.head
    performance = mesh_performance(gapped(person), head.vertices, head.triangles, regions=head.regions, rigid=person.rigid)
    found = all_frames(performance)
    assert found.shape == person.displacements.shape
    assert found.dtype == np.float32
    face = head.regions["face"]
    error = found - person.displacements
    assert 1e3 * np.sqrt((error[:, face] ** 2).sum(axis=2).mean()) < 0.7
    assert 1e3 * np.sqrt((error[:, person.lips] ** 2).sum(axis=2).mean()) < 1.2
    assert not found[:, head.regions["neck"] & (head.vertices[:, 1] < -0.19)].any()
    np.testing.assert_array_equal(all_frames(performance), found)
    markers = all_frames(marker_performance(gapped(person), rigid=person.rigid))
    upright = markers @ invert(person.capture_from_head)[0, :3, :3].T
    # the tie may lie half a millimetre beside the vertex, where the skin moves almost alike
    difference_mm = 1e3 * np.linalg.norm(found[:, person.face] - upright, axis=2)
    assert np.sqrt((difference_mm**2).mean()) < 0.2


def test_without_regions_skin_far_from_markers_stays(person):
    head = person.head
    given = {person.take.names[7 + k]: int(person.face[k]) for k in range(66)}
    performance = mesh_performance(person.take, head.vertices, head.triangles, given=given, rigid=person.rigid)
    still = ~np.any(np.abs(all_frames(performance)).max(axis=0) > 0, axis=1)
    assert still[head.regions["scalp"] & (head.vertices[:, 2] < -0.05)].all()
    assert not still[person.face].any()


def test_markers_are_left_out_by_name_and_the_neutral_frame_is_chosen(person):
    positions = person.take.positions_m.copy()
    positions[10:90, 15] = np.nan
    positions[:3, 16] = np.nan
    take = replace(person.take, positions_m=positions)
    with pytest.raises(InputError, match="m8 in frames 10 to 89"):
        marker_performance(take, rigid=person.rigid)
    performance = marker_performance(take, rigid=person.rigid, leave_out=["m8"])
    assert "m8" not in performance.points
    assert len(performance.points) == 65
    # the first frame that shows all of them
    assert performance.figures["neutral_frame"] == 3
    assert not all_frames(performance)[3].any()
    with pytest.raises(InputError, match="frame 1 does not show m9"):
        marker_performance(take, rigid=person.rigid, leave_out=["m8"], neutral_frame=1)
    with pytest.raises(InputError, match="neutral frame 500"):
        marker_performance(take, rigid=person.rigid, neutral_frame=500)
    with pytest.raises(InputError, match="all markers of synthetic are rigid"):
        marker_performance(person.take.chosen(np.arange(7)), rigid=person.rigid)


def test_swapped_labels_never_reach_a_performance(person):
    positions = person.take.positions_m.copy()
    positions[50:, [20, 33]] = positions[50:, [33, 20]]
    with pytest.raises(InputError, match="m13 and m26 at frame 50"):
        marker_performance(replace(person.take, positions_m=positions), rigid=person.rigid)
