import numpy as np
import pytest

from headcap.expressions import ExpressionBasis
from headcap.synthetic.hand_made import HAND_MADE, muscle_shapes, write_hand_made
from headcap.synthetic.mesh_takes import mesh_subject
from headcap.synthetic.sculptor import SculptorSettings
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


def test_shapes_are_independent_directions(shapes):
    unit = shapes.rows / np.linalg.norm(shapes.rows, axis=1)[:, None]
    # opposites and doubles would leave a singular value of the rounding's size
    assert np.linalg.svd(unit, compute_uv=False).min() > 0.01


def test_left_and_right_pull_their_own_side(shapes):
    for side, sign in (("left", 1), ("right", -1)):
        smile = np.linalg.norm(shapes.displacements[shapes.names.index(f"smile_{side}")], axis=1)
        assert sign * np.average(shapes.neutral[:, 0], weights=smile) > 0.01


def test_no_shape_is_flat(shapes):
    assert np.linalg.norm(shapes.displacements, axis=2).max(axis=1).min() > 0.2e-3


def test_a_sculptors_shapes_are_written_and_are_not_the_true_ones(subject, shapes, tmp_path):
    write_hand_made(tmp_path, subject, SculptorSettings())
    made = ExpressionBasis.load(tmp_path / HAND_MADE)
    assert made.names == shapes.names
    np.testing.assert_array_equal(made.neutral, shapes.neutral)
    assert (np.linalg.norm(made.rows - shapes.rows, axis=1) > 0.1 * np.linalg.norm(shapes.rows, axis=1)).all()
