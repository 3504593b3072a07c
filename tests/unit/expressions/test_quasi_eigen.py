"""The whole conversion: a performance's plane is spanned by shapes that look like the sculptor's; what cannot be is named."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from headcap.errors import InputError, InputErrors
from headcap.expressions import ExpressionBasis, Performance
from headcap.expressions.performance import in_memory
from headcap.expressions.projection import span_report
from headcap.expressions.quasi_eigen import QuasiEigenSettings, convert_basis
from headcap.expressions.rest import offset_of_rest
from headcap.expressions.shape_changes import shape_changes

POINTS, TRUE, FRAMES = 80, 8, 300


def triangles():
    first = np.arange(POINTS - 2)
    return np.stack([first, first + 1, first + 2], axis=1).astype(np.int32)


@pytest.fixture
def neutral(rng):
    return (0.1 * rng.normal(size=(POINTS, 3))).astype(np.float32)


@pytest.fixture
def true(rng, neutral):
    """What the face can do."""
    return ExpressionBasis([f"muscle {i}" for i in range(TRUE)], neutral, 5e-3 * rng.normal(size=(TRUE, POINTS, 3)), triangles())


@pytest.fixture
def hand(rng, true):
    """The same as a sculptor misses it."""
    missed = true.displacements + 1.5e-3 * rng.normal(size=true.displacements.shape)
    return ExpressionBasis(true.names, true.neutral, missed, true.triangles)


def performance_of(displacements, neutral, faces=None, **given):
    made = Performance(
        neutral,
        triangles() if faces is None else faces,
        in_memory(displacements),
        np.arange(len(displacements)) / 30,
        "take",
        **given,
    )
    return made


@pytest.fixture
def displacements(rng, true):
    weights = np.maximum(rng.normal(0.3, 0.4, size=(FRAMES, TRUE)), 0.0)
    weights[0] = 0.0
    return np.tensordot(weights, true.displacements, 1).astype(np.float32)


def alpha(basis, displacements):
    """Share of the displacements that the basis does not reproduce."""
    rows = displacements.reshape(len(displacements), -1).astype(float)
    found = QuasiEigenSettings().solver(basis).solve(displacements)
    return np.linalg.norm(rows - found @ basis.rows) / np.linalg.norm(rows)


def test_the_converted_basis_reproduces_and_still_looks_alike(true, hand, displacements):
    told = []
    made = convert_basis(performance_of(displacements, true.neutral), hand, progress=lambda step, share: told.append(share))
    assert made.quasi.names[:TRUE] == hand.names
    # the plane of all true shapes: rounding; a sculptor's error of three tenths leaves more than a tenth
    assert alpha(made.quasi, displacements) < 0.05 * alpha(hand, displacements)
    assert alpha(hand, displacements) > 0.1
    assert shape_changes(made).angle_deg.max() < 30
    report = span_report(made.quasi, made.eigen)
    assert report.coverage == pytest.approx(report.eigen_coverage, rel=1e-4)
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_settings_reach_what_they_set(true, hand, displacements):
    performance = performance_of(displacements, true.neutral)
    asked = convert_basis(performance, hand, QuasiEigenSettings(components=3, through_neutral=False))
    assert (len(asked.hyperplane), len(asked.eigen)) == (3, len(hand))
    few, many = (
        convert_basis(performance, hand, QuasiEigenSettings(components="coverage", coverage=share)).hyperplane
        for share in (0.5, 0.999)
    )
    assert few.coverage[-1] >= 0.5
    assert len(few) < len(many)
    solver = QuasiEigenSettings(bounds=(0.0, 0.5), smoothing=0.1).solver(true)
    found = solver.solve(displacements)
    assert (found.min(), found.max()) == (0.0, 0.5)


def test_shapes_span_a_hyperplane_through_the_neutral_face(true, hand, displacements):
    """k shapes projected on k - 1 axes and the direction to the neutral face reach all that these axes do."""
    performance = performance_of(displacements, true.neutral)
    made = convert_basis(performance, hand)
    assert len(made.hyperplane) == len(made.eigen) == len(hand)
    rows = made.quasi.rows.astype(np.float64)
    seen = made.hyperplane.rows @ (displacements.reshape(len(displacements), -1)).T
    left = displacements.reshape(len(displacements), -1) - seen.T @ made.hyperplane.rows
    least = np.linalg.norm(left) / np.linalg.norm(displacements)
    reached = np.linalg.lstsq(rows.T, displacements.reshape(len(displacements), -1).T, rcond=None)[0]
    away = np.linalg.norm(displacements.reshape(len(displacements), -1) - reached.T @ rows) / np.linalg.norm(displacements)
    # single precision of the shapes, enlarged by how nearly they depend on each other
    assert least - 1e-6 <= away <= least + 1e-4


def test_an_axis_that_nobody_sculpted_joins_unless_it_is_not_to(true, hand, displacements):
    performance = performance_of(displacements, true.neutral)
    eigen = convert_basis(performance, hand).eigen
    flat = hand.rows.astype(float) - np.outer(hand.rows @ eigen.rows[1], eigen.rows[1])
    sculpted = ExpressionBasis(hand.names, hand.neutral, flat.reshape(hand.displacements.shape), hand.triangles)
    made = convert_basis(performance, sculpted)
    assert made.missing == (1,)
    assert made.quasi.names == (*hand.names, "eigenface_02")
    told = convert_basis(performance, sculpted, QuasiEigenSettings(augment=False))
    assert (told.missing, told.quasi.names) == ((1,), hand.names)
    assert alpha(made.quasi, displacements) < 0.5 * alpha(told.quasi, displacements)


def changed(hand, displacements, names=None):
    return ExpressionBasis(names or hand.names, hand.neutral, displacements, hand.triangles)


def test_flat_and_repeated_shapes_are_named_all_at_once(true, hand, displacements):
    wrong = hand.displacements.copy()
    wrong[2], wrong[5], wrong[7] = 0.0, 1.7 * wrong[1], wrong[3]
    with pytest.raises(InputErrors) as caught:
        convert_basis(performance_of(displacements, true.neutral), changed(hand, wrong))
    told = str(caught.value)
    assert len(caught.value.errors) == 3
    assert "do not differ from the neutral face: muscle 2;" in told
    assert "muscle 1 and muscle 5 are one shape of two amplitudes" in told
    assert "muscle 3 and muscle 7 are one shape;" in told


def test_names_that_come_twice_are_refused(true, hand, displacements):
    names = ("smile", "smile", *hand.names[2:])
    with pytest.raises(InputErrors, match="several shapes are called smile"):
        convert_basis(performance_of(displacements, true.neutral), changed(hand, hand.displacements, names))


def test_shapes_that_are_not_finite_are_named(true, hand, displacements):
    wrong = hand.displacements.copy()
    wrong[4, 3, 0] = np.nan
    with pytest.raises(InputErrors, match="muscle 4 are not finite"):
        convert_basis(performance_of(displacements, true.neutral), changed(hand, wrong))


def test_fewer_frames_than_shapes_are_refused(true, hand, displacements):
    with pytest.raises(InputErrors, match=r"take has 7 frames; expected at least as many as the basis has shapes, 8"):
        convert_basis(performance_of(displacements[:7], true.neutral), hand)


def test_another_topology_is_told_by_its_counts(true, hand, displacements):
    fewer = ExpressionBasis(hand.names, hand.neutral[:-1], hand.displacements[:, :-1], hand.triangles[:-1])
    with pytest.raises(InputErrors, match="the basis has 79 points; expected 80 as take has"):
        convert_basis(performance_of(displacements, true.neutral), fewer)
    with pytest.raises(InputErrors, match="the basis has 78 triangles; expected 77 as take has"):
        convert_basis(performance_of(displacements, true.neutral, triangles()[:-1]), hand)
    with pytest.raises(InputErrors, match="joins the 80 points to other triangles"):
        convert_basis(performance_of(displacements, true.neutral, triangles()[:, ::-1]), hand)


def test_order_of_triangles_and_markers_without_any_do_not_matter(true, hand, displacements, rng):
    shuffled = np.roll(rng.permutation(triangles()), 1, axis=1)
    made = [convert_basis(performance_of(displacements, true.neutral, faces), hand) for faces in (shuffled, triangles()[:0])]
    np.testing.assert_array_equal(made[0].quasi.displacements, made[1].quasi.displacements)


def test_a_basis_of_another_neutral_face_is_refused(true, hand, displacements):
    moved = ExpressionBasis(hand.names, hand.neutral + np.float32([0.0, 0.004, 0.0]), hand.displacements, hand.triangles)
    performance = performance_of(displacements, true.neutral)
    with pytest.raises(InputErrors, match="neutral face of the basis lies 4 mm from that of take"):
        convert_basis(performance, moved)
    assert len(convert_basis(performance, moved, QuasiEigenSettings(neutral_mm=None)).quasi) >= TRUE


def offset(displacements, true, hand, neutral):
    """Performance and basis measured from another neutral face, the captured positions kept."""
    captured = true.neutral + displacements
    made = performance_of((captured - neutral).astype(np.float32), neutral)
    return made, ExpressionBasis(hand.names, neutral, hand.displacements, hand.triangles)


def test_a_neutral_face_in_another_place_is_refused_with_its_offset(true, hand, displacements):
    placed = true.neutral + np.float32([0.0, 0.0, 0.05])
    found = offset_of_rest(offset(displacements, true, hand, placed)[0])
    # the nearest frame is the one whose own motion makes up for some of the offset: by no more than a few spreads' mean
    assert found.shift_mm == pytest.approx(50, abs=found.spread_mm)
    assert found.nearest_mm == pytest.approx(50, abs=found.spread_mm)
    assert found.rigid_share > 0.95
    with pytest.raises(
        InputError, match=r"comes nearer .* placed elsewhere: moved by [45][0-9.]+ mm, turned by [0-9.e-]+ degrees"
    ):
        convert_basis(*offset(displacements, true, hand, placed))
    allowed = convert_basis(*offset(displacements, true, hand, placed), QuasiEigenSettings(rest_ratio=None))
    assert len(allowed.quasi) >= TRUE


def test_a_neutral_face_in_other_units_is_refused(true, hand, displacements):
    with pytest.raises(InputError, match=r"frames are 0\.001\d* times the size of the neutral face: other units\?"):
        convert_basis(*offset(displacements, true, hand, 1000 * true.neutral))


def test_a_neutral_face_of_another_shape_is_refused_with_the_region(true, hand, displacements):
    opened = true.neutral.copy()
    # every other point of the mouth one way, its neighbours the other: no rigid motion
    opened[:20:2] += np.float32([0.0, 0.12, 0.0])
    opened[1:20:2] -= np.float32([0.0, 0.12, 0.0])
    performance, basis = offset(displacements, true, hand, opened)
    regions = {"mouth": np.arange(POINTS) < 20, "brow": np.arange(POINTS) >= 20}
    with pytest.raises(InputError, match=r"another shape; at most 1[12][0-9] mm, most in region mouth"):
        convert_basis(replace(performance, regions=regions), basis)


def test_markers_are_named(true, hand, displacements):
    """Footnote 3: no triangles; an offset is told at its marker, and shapes may be kept to their regions."""
    opened = true.neutral.copy()
    opened[7] += np.float32([0.0, 0.0, 0.9])
    performance, basis = offset(displacements, true, hand, opened)
    markers = replace(performance, triangles=triangles()[:0], points=tuple(f"M{index}" for index in range(POINTS)))
    with pytest.raises(InputError, match=r"another shape; .* at marker M7"):
        convert_basis(markers, basis)
    held = np.where(np.arange(POINTS)[:, None] < 20, hand.displacements, 0.0)
    local = convert_basis(
        performance_of(displacements, true.neutral, triangles()[:0]),
        ExpressionBasis(hand.names, hand.neutral, held, triangles()[:0]),
        QuasiEigenSettings(locality=1.0, augment=False),
    )
    assert np.abs(local.quasi.displacements[:, 20:]).max() == 0.0
    assert np.abs(local.quasi.displacements[:, :20]).max() > 1e-3


def test_a_take_without_rest_passes(true, hand, displacements):
    """Only frames beyond the median distance from the neutral face."""
    far = np.linalg.norm(displacements.reshape(FRAMES, -1), axis=1)
    moving = displacements[far > np.median(far)]
    assert len(convert_basis(performance_of(moving, true.neutral), hand).quasi) >= TRUE


@pytest.mark.parametrize("wrong", [{"coverage": 0.0}, {"bounds": (1.0, 0.5)}, {"locality": 2.0}, {"unknown": 1}])
def test_settings_without_sense_are_refused(wrong):
    with pytest.raises(ValidationError):
        QuasiEigenSettings(**wrong)
