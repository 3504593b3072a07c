"""Subjects as meshes: the base head's topology, still at first, equal for equal seeds, with muscles that do not just add up."""

import numpy as np
import pytest

from headcap.heads import base_head
from headcap.synthetic.mesh_takes import MeshSubject, mesh_subject
from headcap.synthetic.subject import AT_REST


@pytest.fixture(scope="module")
def person() -> MeshSubject:
    return mesh_subject(3)


def test_keeps_the_topology_and_begins_at_rest(person):
    take = person.take("pose", 30, 20.0)
    assert take.meshes.shape == (30, len(base_head().vertices), 3)
    # performers hold still at first
    assert take.meshes[0] == pytest.approx(person.neutral_m, abs=1e-6)
    assert np.abs(take.meshes[-1] - person.neutral_m).max() > 0.01
    assert np.abs(person.neutral_m - base_head().vertices).max() < 0.03


def test_equal_seeds_and_numbers_are_equal_and_others_differ(person):
    again, other = mesh_subject(3), mesh_subject(4)
    first = person.take("expression", 15, 20.0).meshes
    assert (again.take("expression", 15, 20.0).meshes == first).all()
    assert (person.take("expression", 15, 20.0, number=1).meshes != first).any()
    assert (other.neutral_m != person.neutral_m).any()


def test_a_turned_head_swells_the_muscle_of_the_other_side_faster_than_the_angle(person):
    right = person.neutral_m[:, 0] < -0.01
    swelling = [np.linalg.norm(person.muscles.displacement(AT_REST | {"turn_y": turn}), axis=1) for turn in (0.2, 0.4)]
    assert swelling[1][right].max() > 0.0015
    # the strand's closeness is a Gaussian: its tail reaches the other side by less than a micrometre
    assert swelling[1][person.neutral_m[:, 0] > 0.01].max() < 1e-6
    # faster than twice, and not the same form grown
    assert swelling[1].max() > 2.2 * swelling[0].max()
    alike = swelling[0] @ swelling[1] / np.linalg.norm(swelling[0]) / np.linalg.norm(swelling[1])
    assert alike < 0.999


def test_grimaces_move_the_neck_alone_of_the_muscles_here(person):
    drawn = person.muscles.displacement(AT_REST | {"corner_down_left": 1.0, "corner_down_right": 1.0})
    moved = np.linalg.norm(drawn, axis=1) > 1e-9
    assert base_head().regions["neck"][moved].all()
    assert np.linalg.norm(drawn, axis=1).max() > 0.002
    assert not person.muscles.displacement(AT_REST).any()
