"""Quasi-eigen faces of sculpted shapes on a face whose true shapes are known: section 5.5 of the quasi-eigen paper.

Of the weak points that the figures name themselves: 53 shapes keep more of their likeness the more axes there are, and of shapes
that nobody performed, those that resemble a performed one become it.
"""

import importlib.util
import sys
from pathlib import Path

import pytest

from headcap.evaluation.expressions import compare_bases
from headcap.expressions.performance import joined
from headcap.expressions.principal import eigenfaces
from headcap.expressions.projection import quasi_eigen_faces
from headcap.expressions.quasi_eigen import QuasiEigenSettings, convert_basis
from headcap.synthetic.sculptor import SculptorSettings, sculpt

_SPEC = importlib.util.spec_from_file_location("_expression_takes", Path(__file__).parents[2] / "bench" / "_expression_takes.py")
takes = importlib.util.module_from_spec(_SPEC)
sys.modules["_expression_takes"] = takes  # dataclasses look their module up
_SPEC.loader.exec_module(takes)

EVERY_VERTEX, EVERY_FRAME = 4, 50

pytestmark = pytest.mark.real


@pytest.fixture(scope="module")
def face(test_data):
    return takes.known_face(test_data)


@pytest.fixture(scope="module")
def sculpted(face):
    return sculpt(face.basis, SculptorSettings(), 11)


@pytest.fixture(scope="module")
def speech(face, test_data):
    return takes.animated(face, *takes.animator_weights(test_data, face.basis.names, takes.SIGNALS, EVERY_FRAME), "speech")


def judged(performance, hand, coverage):
    performance, hand = takes.thinned(performance, hand, EVERY_VERTEX)
    axes = eigenfaces(performance, coverage=coverage)
    return compare_bases(performance, quasi_eigen_faces(hand, axes, augment=False))


def test_a_tracked_performance_is_reproduced_as_well_as_by_its_eigenfaces(face, sculpted):
    """True meshes, 99.5 % covered as in the paper.

    Whose face is whose is not asked here: twelve shapes move as five axes, left and right as one, and their halves are even.
    """
    found = judged(takes.rig_take(face, "expression_01"), sculpted, 0.995)
    figures = found.figures()
    assert figures["quasi_eigen.qe_over_pca"] <= 1.2
    assert figures["quasi_eigen.hand_over_qe"] >= 4


def test_shapes_that_speech_performs_stay_themselves(face, sculpted, speech):
    """99.99 % covered: the weakest shapes of the mouth are in the last ten thousandth."""
    found = judged(speech, sculpted, 0.9999)
    figures = found.figures()
    assert figures["quasi_eigen.qe_over_pca"] <= 1.2
    assert figures["quasi_eigen.qe_chosen_over_pca"] <= 1.2
    assert figures["quasi_eigen.hand_over_qe"] >= 4
    assert figures["quasi_eigen.median_correlation"] >= 0.8
    # all that speech performs is exercised, and none of it is taken for another
    assert not set(found.not_exercised) & set(takes.SIGNALS)
    assert {shape.name for shape in found.mistaken} <= set(found.not_told_apart) - set(takes.SIGNALS)


def test_fewer_axes_tell_fewer_shapes_apart(sculpted, speech):
    """99.5 %: reproduced as well as by eigenfaces, and whoever is mistaken for another is named beforehand."""
    found = judged(speech, sculpted, 0.995)
    figures = found.figures()
    assert figures["quasi_eigen.qe_over_pca"] <= 1.2
    assert figures["quasi_eigen.median_correlation"] >= 0.8
    assert {shape.name for shape in found.mistaken} <= set(found.not_told_apart)
    assert figures["quasi_eigen.own_closest_share"] < 1


def chosen(performance, hand):
    performance, hand = takes.thinned(performance, hand, EVERY_VERTEX)
    return compare_bases(performance, convert_basis(performance, hand, QuasiEigenSettings(augment=False, rest_ratio=None)))


def test_as_many_shapes_reproduce_as_well_as_as_many_eigenfaces(face, sculpted, speech):
    """53 of each, on the rig's short takes and on these with speech: the settings' defaults."""
    rig = joined([takes.rig_take(face, name) for name in takes.RIG_TAKES])
    for performance in (rig, joined([rig, speech])):
        found = chosen(performance, sculpted)
        figures = found.figures()
        assert found.elements >= 40
        assert figures["quasi_eigen.qe_over_pca"] <= 1.2
        assert figures["quasi_eigen.hand_over_qe"] >= 4
    assert figures["quasi_eigen.median_correlation"] >= 0.8
