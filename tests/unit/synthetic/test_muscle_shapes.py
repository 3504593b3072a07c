import numpy as np
import pytest

from headcap.synthetic.mesh_takes import mesh_subject
from headcap.synthetic.muscle_shapes import muscle_shapes
from headcap.synthetic.subject import AT_REST


@pytest.fixture(scope="module")
def subject():
    return mesh_subject(5)


@pytest.fixture(scope="module")
def shapes(subject):
    return muscle_shapes(subject)


def test_each_shape_is_one_muscle_fully_actuated(subject, shapes):
    assert len(set(shapes.names)) == len(shapes)
    jaw = shapes.displacements[shapes.names.index("jaw_open")]
    # single precision of a head's decimetres
    np.testing.assert_allclose(shapes.neutral + jaw, subject.mesh(AT_REST | {"jaw": 1.0}), atol=1e-7)


def test_what_moves_both_ways_has_two_shapes_that_oppose_each_other(shapes):
    left, right = (shapes.displacements[shapes.names.index(f"mouth_{side}")] for side in ("left", "right"))
    assert np.vdot(left, right) < -0.5 * np.linalg.norm(left) * np.linalg.norm(right)


def test_left_and_right_pull_their_own_side(shapes):
    for side, sign in (("left", 1), ("right", -1)):
        smile = np.linalg.norm(shapes.displacements[shapes.names.index(f"smile_{side}")], axis=1)
        assert sign * np.average(shapes.neutral[:, 0], weights=smile) > 0.01


def test_no_shape_is_flat(shapes):
    assert np.linalg.norm(shapes.displacements, axis=2).max(axis=1).min() > 0.2e-3
