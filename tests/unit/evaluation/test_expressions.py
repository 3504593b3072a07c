"""Figures of expression bases: eq. 6 by hand, laws of spans, and what a performance says about shapes it does and does not do."""

import json
from collections.abc import Callable

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.evaluation.catalogue import CATALOGUE
from headcap.evaluation.expressions import ExpressionFigures, compare_bases
from headcap.evaluation.reproduction import greedy_order, reproduction, reproductions
from headcap.expressions import Eigenfaces, ExpressionBasis, Performance, QuasiEigenFaces
from headcap.expressions.performance import in_memory

POINTS, FRAMES = 40, 25
NO_TRIANGLES = np.zeros((0, 3), np.int32)


def performance_of(displacements: np.ndarray, neutral: np.ndarray, block: int = 64) -> Performance:
    left = neutral[:, 0] < np.median(neutral[:, 0])
    return Performance(
        neutral=neutral,
        triangles=NO_TRIANGLES,
        blocks=in_memory(displacements.astype(np.float32), block),
        time_s=np.arange(len(displacements)) / 30,
        source="a take",
        regions={"left": left, "right": ~left, "none": np.zeros(len(neutral), bool)},
    )


def eigenfaces_of(displacements: np.ndarray, count: int) -> Eigenfaces:
    rows = displacements.reshape(len(displacements), -1)
    mean = rows.mean(axis=0)
    _, values, vectors = np.linalg.svd(rows - mean, full_matrices=False)
    variances = values**2 / len(rows)
    shape = (count, *displacements.shape[1:])
    return Eigenfaces(mean.reshape(shape[1:]), vectors[:count].reshape(shape), variances[:count], float(variances.sum()))


def projected(hand: ExpressionBasis, eigen: Eigenfaces) -> QuasiEigenFaces:
    """Eq. 3 and 4, written out."""
    mean, axes = eigen.mean.ravel().astype(float), eigen.rows.astype(float)
    coordinates = (hand.rows - mean) @ axes.T
    quasi = (mean + coordinates @ axes).reshape(hand.displacements.shape)
    return QuasiEigenFaces(hand, eigen, ExpressionBasis(hand.names, hand.neutral, quasi, NO_TRIANGLES), coordinates, ())


def basis_of(displacements: np.ndarray, neutral: np.ndarray) -> ExpressionBasis:
    return ExpressionBasis(tuple(f"shape {index}" for index in range(len(displacements))), neutral, displacements, NO_TRIANGLES)


@pytest.fixture
def neutral(rng) -> np.ndarray:
    return 0.1 * rng.normal(size=(POINTS, 3)).astype(np.float32)


@pytest.fixture
def motion(rng) -> np.ndarray:
    """Frames whose variance falls by 4 from axis to axis."""
    ways = rng.normal(size=(8, POINTS * 3)) * 0.5 ** np.arange(8)[:, None]
    return (0.002 * rng.normal(size=(FRAMES, 8)) @ ways).reshape(FRAMES, POINTS, 3).astype(np.float32)


def test_alpha_is_equation_6_whatever_the_origin(rng, neutral, motion):
    basis = basis_of(0.01 * rng.normal(size=(3, POINTS, 3)), neutral)
    judged = reproduction(performance_of(motion, neutral), basis)
    rows = motion.reshape(FRAMES, -1).astype(float)
    weights = np.linalg.lstsq(basis.rows.T.astype(float), rows.T, rcond=None)[0].T
    residual = rows - weights @ basis.rows
    positions = (neutral - neutral.mean(axis=0)).ravel() + rows
    frames = 100 * np.linalg.norm(residual, axis=1) / np.linalg.norm(positions, axis=1)
    # float32 shapes enter both sides alike; what differs is float64 rounding
    assert judged.frame_alpha_pct == pytest.approx(frames, rel=1e-6)
    assert judged.alpha_pct == pytest.approx(100 * np.linalg.norm(residual) / np.linalg.norm(positions), rel=1e-6)
    assert judged.displacement_pct == pytest.approx(100 * np.linalg.norm(residual) / np.linalg.norm(rows), rel=1e-6)
    points = np.linalg.norm(residual.reshape(FRAMES, POINTS, 3), axis=-1)
    assert judged.vertex_rms_mm == pytest.approx(1e3 * np.sqrt((points**2).mean(axis=0)), rel=1e-6)
    assert judged.frame_rms_mm == pytest.approx(1e3 * np.sqrt((points**2).mean(axis=1)), rel=1e-6)
    elsewhere = neutral + np.array([0.5, -2.0, 1.0], np.float32)
    moved = reproduction(performance_of(motion, elsewhere), basis_of(basis.displacements, elsewhere))
    # float32 positions two metres from the origin are good to a tenth of a micrometre, of a face of a decimetre
    assert moved.alpha_pct == pytest.approx(judged.alpha_pct, rel=1e-5)


def test_blocks_of_any_length_and_several_bases_at_once_give_the_same(rng, neutral, motion):
    bases = [basis_of(0.01 * rng.normal(size=(3, POINTS, 3)), neutral), eigenfaces_of(motion, 4)]
    whole = reproductions(performance_of(motion, neutral), bases, [None, None])
    for block in (1, 7):
        told = []
        parts = reproductions(performance_of(motion, neutral, block), bases, [None, None], _appending(told))
        assert [part.alpha_pct for part in parts] == pytest.approx([one.alpha_pct for one in whole], rel=1e-12)
        assert parts[0].alpha_by_size_pct == pytest.approx(whole[0].alpha_by_size_pct, rel=1e-9)
        assert parts[0].frame_rms_mm == pytest.approx(whole[0].frame_rms_mm, rel=1e-9)
        assert told[-1] == (FRAMES, FRAMES)


def _appending(told: list) -> Callable[[int, int], None]:
    return lambda done, of: told.append((done, of))


def test_eigenfaces_leave_the_variance_they_do_not_cover(neutral, motion):
    performance = performance_of(motion, neutral)
    for count in (1, 3, 6):
        eigen = eigenfaces_of(motion, count)
        left = FRAMES * (eigen.total_variance - eigen.variances.sum())
        judged = reproduction(performance, eigen)
        positions = ((neutral - neutral.mean(axis=0) + motion).astype(float) ** 2).sum()
        assert judged.alpha_pct == pytest.approx(100 * np.sqrt(left / positions), rel=1e-4)
        assert judged.alpha_by_size_pct[-1] == pytest.approx(judged.alpha_pct, rel=1e-6)
        assert (np.diff(judged.alpha_by_size_pct) < 0).all()
        assert judged.dimensions == count


def test_only_the_span_counts(rng, neutral, motion):
    performance = performance_of(motion, neutral)
    shapes = 0.01 * rng.normal(size=(4, POINTS, 3))
    mixing = rng.normal(size=(4, 4)) + 3 * np.eye(4)
    plain = reproduction(performance, basis_of(shapes, neutral))
    mixed = reproduction(performance, basis_of(np.einsum("ij,jnk->ink", mixing, shapes), neutral))
    twice = reproduction(performance, basis_of(np.concatenate([shapes, shapes[:1] + shapes[1:2]]), neutral))
    more = reproduction(performance, basis_of(np.concatenate([shapes, 0.01 * rng.normal(size=(1, POINTS, 3))]), neutral))
    # float32 shapes are rounded after mixing, by 6e-8 of a condition below 10
    assert mixed.alpha_pct == pytest.approx(plain.alpha_pct, rel=1e-5)
    assert twice.alpha_pct == pytest.approx(plain.alpha_pct, rel=1e-5)
    assert (plain.dimensions, mixed.dimensions, twice.dimensions, more.dimensions) == (4, 4, 4, 5)
    assert more.alpha_pct < plain.alpha_pct


def test_a_performance_inside_the_span_is_reproduced(rng, neutral):
    shapes = 0.01 * rng.normal(size=(4, POINTS, 3))
    motion = np.einsum("lk,knc->lnc", rng.normal(size=(FRAMES, 4)), shapes)
    judged = reproduction(performance_of(motion, neutral), basis_of(shapes, neutral))
    # float32 of displacements of centimetres
    assert judged.displacement_pct < 1e-4
    assert max(judged.region_rms_mm.values()) < 1e-4
    assert set(judged.region_rms_mm) == {"left", "right"}


def test_bounded_weights_reproduce_what_needs_no_others_and_never_more(rng, neutral):
    shapes = 0.01 * rng.normal(size=(4, POINTS, 3))
    basis, weights = basis_of(shapes, neutral), rng.uniform(0.1, 0.9, size=(FRAMES, 4))
    inside = performance_of(np.einsum("lk,knc->lnc", weights, shapes), neutral)
    # float32 of displacements of centimetres
    assert reproduction(inside, basis, bounds=(0.0, 1.0)).displacement_pct < 1e-3
    beyond = performance_of(np.einsum("lk,knc->lnc", 2 * weights - 1, shapes), neutral)
    free, positive, box = (reproduction(beyond, basis, bounds=bounds) for bounds in (None, (0.0, np.inf), (0.0, 0.2)))
    assert free.alpha_pct < 1e-4 < positive.alpha_pct < box.alpha_pct
    assert len(box.alpha_by_size_pct) == 0


def test_shapes_are_chosen_greedily(rng):
    shapes, data = rng.normal(size=(5, 6)), rng.normal(size=(30, 6)) * 2.0 ** np.arange(6)
    order, taken = greedy_order(shapes, data.T @ data)
    for size in range(1, 6):
        span = np.linalg.qr(shapes[list(order[:size])].T)[0]
        assert taken[:size].sum() == pytest.approx(((data @ span) ** 2).sum(), rel=1e-9)
    best_alone = [((data @ shape) ** 2).sum() / (shape @ shape) for shape in shapes]
    assert order[0] == int(np.argmax(best_alone))
    assert taken[0] == pytest.approx(max(best_alone))
    # a shape that another one already is adds nothing and is left out
    doubled, energies = greedy_order(np.concatenate([shapes, 2 * shapes[:1]]), data.T @ data)
    assert len(doubled) == len(energies) == 5


DIRECTION = np.array([0.0, 0.006, 0.008])


def bumps() -> np.ndarray:
    """Shapes (4, n, 3) that each move one group of points, in one direction; half of the last one is the first."""
    out = np.zeros((4, POINTS, 3))
    for shape, (first, last) in zip(out, ((0, 10), (10, 20), (20, 30), (5, 12)), strict=True):
        shape[first:last] = DIRECTION
    return out


def _wrong_shapes() -> np.ndarray:
    """The same as rows, the first two hand-made a little the wrong way."""
    wrong = bumps()
    wrong[:2, :, 0] = 0.3 * wrong[:2, :, 1]
    return wrong.reshape(4, -1)


@pytest.fixture
def judged(rng, neutral) -> ExpressionFigures:
    """Shapes 0 and 1 performed, 2 and 3 not."""
    motion = np.einsum("lk,knc->lnc", np.abs(rng.normal(size=(FRAMES, 2))), bumps()[:2])
    motion[0] = 0
    hand = basis_of(_wrong_shapes().reshape(4, POINTS, 3), neutral)
    return compare_bases(performance_of(motion, neutral), projected(hand, eigenfaces_of(motion, 2)))


def test_shapes_not_performed_are_named(judged):
    # all of shape 2 lies where nothing moved
    assert judged.not_exercised == ("shape 2",)
    assert judged.kept[2] == pytest.approx(0, abs=1e-6)
    # hand-made shapes 0 and 1 are the true ones and something at right angles to all that moved
    assert judged.kept[:2] == pytest.approx(np.full(2, 1 / np.hypot(1, 0.3 * 0.6)), rel=1e-5)
    # five of shape 3's seven points are in shape 0, two in shape 1: 5 / sqrt(7 * 10), 2 / sqrt(7 * 10)
    assert judged.kept[3] == pytest.approx(np.sqrt(25 + 4) / np.sqrt(70), rel=1e-5)


def test_a_face_that_became_another_shape_is_named_with_it(judged):
    assert [(shape.name, shape.closest) for shape in judged.mistaken] == [("shape 3", "shape 0")]
    assert judged.not_told_apart == ("shape 3",)
    # its own part by least squares on the other three, laid on the two groups that moved
    hand = _wrong_shapes()
    others = np.linalg.qr(hand[:3].T)[0]
    own = hand[3] - others @ (others.T @ hand[3])
    moved = np.zeros((2, POINTS, 3))
    moved[0, :10], moved[1, 10:20] = DIRECTION, DIRECTION
    axes = moved.reshape(2, -1) / np.linalg.norm(moved.reshape(2, -1), axis=1, keepdims=True)
    assert judged.own_part[3] == pytest.approx(np.linalg.norm(axes @ own) / np.linalg.norm(own), rel=1e-4)
    assert judged.own_correlation[:2] == pytest.approx(judged.kept[:2], rel=1e-5)
    assert judged.figures()["quasi_eigen.own_closest_share"] == pytest.approx(2 / 3)


def test_a_shape_made_of_others_has_nothing_of_its_own(rng, neutral, motion):
    shapes = 0.01 * rng.normal(size=(3, POINTS, 3))
    hand = basis_of(np.concatenate([shapes, shapes[:1] - 2 * shapes[1:2]]), neutral)
    figures = compare_bases(performance_of(motion, neutral), projected(hand, eigenfaces_of(motion, 4)))
    assert (figures.own_part[[0, 1, 3]] == 0).all()
    assert 0 < figures.own_part[2] <= 1


def test_projection_brings_hand_made_shapes_to_the_error_of_the_eigenfaces(judged):
    figures = judged.figures()
    assert judged.elements == 2
    # the motion's part outside the hand-made shapes is 0.18 of it, sine of the angle they are off
    assert figures["quasi_eigen.displacement_hand_pct"] == pytest.approx(100 * 0.18 / np.hypot(1, 0.18), rel=0.02)
    assert figures["quasi_eigen.displacement_qe_pct"] < 1e-3
    assert figures["quasi_eigen.displacement_pca_pct"] < 1e-3
    # the neutral face is a frame, and two axes cover all
    assert judged.mean_outside < 1e-5


def test_as_many_quasi_eigen_faces_as_axes_are_compared(rng, neutral, motion):
    hand = basis_of(0.01 * rng.normal(size=(7, POINTS, 3)), neutral)
    for axes, elements in ((3, 3), (7, 6), (8, 6)):
        figures = compare_bases(performance_of(motion, neutral), projected(hand, eigenfaces_of(motion, axes)))
        assert figures.elements == figures.pca.dimensions == elements
        assert figures.quasi.dimensions == min(7, axes + 1)
        # m + 1 faces and more span mean and axes
        if axes + 1 <= 7:
            assert figures.quasi.alpha_pct <= figures.pca.alpha_pct * (1 + 1e-5)
        assert figures.pca_beside_mean.dimensions == min(axes, 7)
        assert figures.pca_beside_mean.alpha_pct <= figures.pca.alpha_pct
        assert figures.alpha_qe_chosen_pct >= figures.quasi.alpha_pct * (1 - 1e-9)


def test_figures_are_in_the_catalogue_and_go_to_json(judged):
    assert set(judged.figures()) <= set(CATALOGUE)
    told = json.loads(json.dumps(judged.to_json(), allow_nan=False))
    assert told["not_exercised"] == ["shape 2"]
    assert told["mistaken"][0]["closest"] == "shape 0"
    assert len(told["bases"]["quasi"]["frame_rms_mm"]) == FRAMES == len(told["time_s"])


def test_other_points_and_no_frames_are_refused(neutral, motion):
    with pytest.raises(InputError, match="40 points, the basis 39"):
        reproduction(performance_of(motion, neutral), basis_of(np.zeros((1, 39, 3)), neutral[:39]))
    with pytest.raises(InputError, match="no frames"):
        reproduction(performance_of(motion[:0], neutral), basis_of(np.ones((1, POINTS, 3)), neutral))
