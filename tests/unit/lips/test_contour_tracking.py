"""The contour-based baseline: contours come nearer turn by turn, and lips that its shapes can make are found."""

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.geometry.transforms import from_vector, transform
from headcap.lips.contour_tracking import (
    ContourTracker,
    ContourTrackingSettings,
    _Problem,
    expressive_shapes,
    lip_blendshapes,
    person_tracker,
)
from headcap.lips.correction import CanonicalMeshes, canonical_meshes
from headcap.lips.features import LipContours
from headcap.synthetic.mesh_takes import mesh_subject


@pytest.fixture(scope="module")
def subject():
    return mesh_subject(21)


@pytest.fixture(scope="module")
def training(subject):
    return [subject.take("lips", 40, 15.0, number=number).meshes for number in (10, 11)]


@pytest.fixture(scope="module")
def lips(stage, subject, training):
    """(30, n, 3) lip blendshapes of the subject."""
    shapes = expressive_shapes(training, subject.neutral_m, stage.mouth)
    return lip_blendshapes(shapes, subject.neutral_m, subject.neutral_m, stage.mouth)


def known_lips(subject, lips, rng):
    """A mesh of three of the shapes, and which these are."""
    chosen = rng.choice(len(lips), 3, replace=False)
    return subject.neutral_m + np.tensordot(rng.uniform(0.2, 0.6, 3), lips[chosen], 1), chosen


@pytest.mark.parametrize("trial", range(3))
def test_contours_come_nearer_with_every_turn_and_tell_what_the_shapes_can_make(stage, subject, lips, trial):
    """Three shapes, two contours without error, and a prior that asks for next to nothing: the truth is the one minimum."""
    truth, chosen = known_lips(subject, lips, np.random.default_rng(trial))
    loose = np.full(3, 100.0)
    tracker = ContourTracker(lips[chosen], loose, stage.see, stage.camera, ContourTrackingSettings(rounds=20))
    found = tracker.fit(subject.neutral_m, np.eye(4), stage.see(truth, stage.camera))
    falling = found.distances_px[found.distances_px > 1e-3]
    assert len(falling) >= 2
    assert (np.diff(falling) < 0).all()
    assert found.distances_px[-1] < 1e-3
    # a thousandth of a pixel is half a micrometre here; shapes tell depth by a tenth of what they move in the picture at least
    assert stage.error_mm(found.mesh[None], truth[None]) < 0.01
    np.testing.assert_allclose(found.mesh, subject.neutral_m + np.tensordot(found.weights, lips[chosen], 1), atol=1e-12)


@pytest.mark.parametrize("trial", range(3))
def test_among_all_shapes_the_truth_is_nearer_than_the_base(stage, subject, lips, trial):
    truth, _ = known_lips(subject, lips, np.random.default_rng(trial))
    tracker = person_tracker(stage.shapes, lips, stage.see, stage.camera)
    found = tracker.fit(subject.neutral_m, np.eye(4), stage.see(truth, stage.camera))
    assert found.distances_px[-1] < 0.2 * found.distances_px[0]
    assert stage.error_mm(found.mesh[None], truth[None]) < 0.5 * stage.error_mm(subject.neutral_m[None], truth[None])


def test_a_takes_lips_are_nearer_than_the_base_tracker_has_them(stage, subject, lips, rng):
    truth = subject.take("lips", 30, 15.0, number=3).meshes.astype(float)
    base = canonical_meshes(stage.track(subject.neutral_m, truth, rng), subject.neutral_m, stage.mouth.steady)
    contours = [stage.see(mesh, stage.camera) for mesh in truth]
    tracker = person_tracker(stage.shapes, lips, stage.see, stage.camera)
    fits = list(tracker.track(base, contours))
    # contours of one camera tell no depth: the paper gains 2.5 %
    assert stage.error_mm(np.stack([fit.mesh for fit in fits]), truth) < stage.error_mm(base.meshes, truth)
    assert np.mean([fit.distances_px[-1] for fit in fits]) < 0.5 * np.mean([fit.distances_px[0] for fit in fits])


def test_the_step_is_along_the_true_slope(stage, subject, lips, rng):
    truth, _ = known_lips(subject, lips, rng)
    tracker = person_tracker(stage.shapes[:4], lips[:4], stage.see, stage.camera)
    start = subject.neutral_m + 0.5 * lips[0]
    problem = _Problem(tracker, start[stage.see.vertices], np.eye(4), stage.see(truth, stage.camera))
    here, step = problem.at(np.zeros(8)), 1e-4
    for part in here.pulls:
        slopes = here._rows(part)
        for k, weights in enumerate(step * np.eye(8)):
            pixels = [stage.camera.project(problem.tracked + tracker._slopes @ (sign * weights))[0] for sign in (1.0, -1.0)]
            change = (part.distances(pixels[0]) - part.distances(pixels[1])) / (2 * step)
            # central differences err by the step squared; pixels of about 500 are told to 1e-13, over the step
            np.testing.assert_allclose(slopes[:, k], change, atol=1e-6 * max(1.0, np.abs(change).max()))


def test_contours_that_fit_already_leave_the_base_as_it_is(stage, subject, lips):
    tracker = person_tracker(stage.shapes, lips, stage.see, stage.camera)
    rest = subject.neutral_m + 0.4 * lips[0]
    found = tracker.fit(rest, np.eye(4), stage.see(rest, stage.camera))
    # the inner contour is a chain of straight pieces between stations: their ends are told again to rounding
    assert found.distances_px[0] < 1e-6
    np.testing.assert_allclose(found.mesh, rest, atol=1e-9)


def test_chosen_shapes_cover_the_takes(stage, subject, training):
    """Farthest-point sampling, lips at rest being there already: no frame is farther from these than they are apart."""
    chosen = expressive_shapes(training, subject.neutral_m, stage.mouth, 6)
    frames = canonical_meshes(np.concatenate(training), subject.neutral_m, stage.mouth.steady).meshes
    # the same vertices that the choice looks at
    sampled = np.unique(stage.mouth.triangles[stage.mouth.layer[stage.mouth.fade == 1.0]])[::4]
    rest = subject.neutral_m[sampled].ravel()
    picked, every = (meshes[:, sampled].reshape(len(meshes), -1) for meshes in (chosen, frames))
    known = np.vstack([rest, picked])
    between = np.linalg.norm(known[:, None] - known, axis=2)[~np.eye(7, dtype=bool)].min()
    left = np.linalg.norm(every[:, None] - known, axis=2).min(axis=1).max()
    # displacements are compared in single precision
    assert left <= between * (1 + 1e-6)
    assert np.linalg.norm(picked[0] - rest) == pytest.approx(np.linalg.norm(every - rest, axis=1).max(), rel=1e-6)


def test_frames_that_were_not_tracked_are_no_shapes(stage, subject, training):
    holed = training[0][:12].copy()
    holed[:10] = np.nan
    assert np.isfinite(expressive_shapes([holed], subject.neutral_m, stage.mouth, 6)).all()
    with pytest.raises(InputError, match="no tracked frame"):
        expressive_shapes([holed[:10]], subject.neutral_m, stage.mouth)


def test_shapes_on_the_same_head_are_the_persons_own_within_the_mask(stage, subject, training, lips):
    shapes = expressive_shapes(training, subject.neutral_m, stage.mouth)
    partly = stage.mouth.triangles[stage.mouth.layer[stage.mouth.fade < 1.0]]
    inside = np.setdiff1d(stage.mouth.vertices, partly)
    # the transfer places the mesh by a mean over the skin that holds still, to rounding
    np.testing.assert_allclose((subject.neutral_m + lips)[:, inside], shapes[:, inside], atol=1e-9)
    outside = np.setdiff1d(np.arange(len(subject.neutral_m)), stage.mouth.triangles[stage.mouth.patch])
    assert np.abs(lips[:, outside]).max() == 0.0


def test_shapes_of_a_head_elsewhere_and_of_another_size_are_the_same(stage, subject, training):
    shapes = expressive_shapes(training, subject.neutral_m, stage.mouth, 2)
    other, move = mesh_subject(22).neutral_m, from_vector(np.array([0.4, -1.2, 0.3, 0.5, 0.1, 2.0]))
    expected = lip_blendshapes(shapes, subject.neutral_m, other, stage.mouth)
    moved = (transform(move, 1.3 * meshes) for meshes in (shapes, subject.neutral_m))
    np.testing.assert_allclose(lip_blendshapes(*moved, other, stage.mouth), expected, atol=1e-9)
    assert np.abs(expected).max() > 1e-3


def test_frames_without_contours_have_no_answer(stage, subject, lips):
    tracker = person_tracker(stage.shapes[:2], lips[:2], stage.see, stage.camera)
    contours = stage.see(subject.neutral_m, stage.camera)
    lost = np.full((4, 4), np.nan)
    base = CanonicalMeshes(np.stack([subject.neutral_m] * 3), np.stack([np.eye(4), np.eye(4), lost]))
    assert [fit is None for fit in tracker.track(base, [contours, None, contours])] == [False, True, True]
    with pytest.raises(InputError, match="2 frames"):
        list(tracker.track(base, [contours] * 2))
    with pytest.raises(InputError, match="deviations"):
        ContourTracker(lips, np.zeros(len(lips)), stage.see, stage.camera)


def test_a_contour_beyond_the_mouth_is_no_trouble(stage, subject, lips):
    """A detection that lies beside the lips shares no station with them: the prior and the other contour hold."""
    tracker = person_tracker(stage.shapes, lips, stage.see, stage.camera)
    contours = stage.see(subject.neutral_m, stage.camera)
    beside = LipContours(contours.outer, contours.inner + np.array([300.0, 0.0]))
    found = tracker.fit(subject.neutral_m, np.eye(4), beside)
    np.testing.assert_allclose(found.mesh, subject.neutral_m, atol=1e-9)
