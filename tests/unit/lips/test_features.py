"""Features: laws of the shape vector, of contour points, and of distances under motion of the head."""

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.geometry.transforms import from_vector, transform
from headcap.lips.correction import canonical_meshes
from headcap.lips.features import (
    ACROSS,
    BETWEEN,
    SAMPLES,
    FeatureSpace,
    LipContours,
    contour_points,
    lip_features,
    tracking_shapes,
)
from headcap.synthetic.mesh_takes import mesh_subject


@pytest.fixture(scope="module")
def subject():
    return mesh_subject(31)


@pytest.fixture(scope="module")
def frames(subject):
    """(4, n, 3) of a lip take."""
    return subject.take("lips", 50, 30.0).meshes[14::10].astype(float)


def circle(radius, count, centre=(100.0, 200.0)):
    angle = np.pi + 2 * np.pi * np.arange(count) / count
    return np.array(centre) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def test_shape_vector_reads_the_components_and_is_zero_at_rest(stage, rng):
    flat = stage.space.basis.reshape(len(stage.space.basis), -1).astype(float)
    np.testing.assert_allclose(flat @ flat.T, np.eye(len(flat)), atol=1e-5)  # single precision
    weights = rng.normal(size=(3, len(flat))) * 0.1
    moved = np.repeat(stage.vertices[None], 3, axis=0)
    moved[:, stage.space.vertices] += np.tensordot(weights, stage.space.basis.astype(float), 1)
    unit = np.sqrt(len(stage.space.vertices)) * stage.space.eye_distance(stage.vertices[None])[0]
    np.testing.assert_allclose(stage.space.shape(moved, stage.vertices), weights / unit, atol=1e-5 * np.abs(weights).max() / unit)
    assert np.abs(stage.space.shape(stage.vertices[None], stage.vertices)).max() == 0.0


def test_the_components_keep_just_99_percent_of_the_blendshapes(stage):
    shapes = tracking_shapes(stage.model)[:, stage.space.vertices].reshape(-1, 3 * len(stage.space.vertices))
    basis = stage.space.basis.reshape(len(stage.space.basis), -1).astype(float)
    energy = np.cumsum(((shapes @ basis.T) ** 2).sum(axis=0)) / (shapes**2).sum()
    assert energy[-1] >= 0.99 - 1e-6
    assert energy[-2] < 0.99


def test_contour_points_lie_on_the_border_normals(stage):
    outer, inner = circle(50.0, 400), circle(20.0, 400)
    found, within = contour_points(circle(44.0, SAMPLES), LipContours(outer, inner))
    centre = np.array([100.0, 200.0])
    # a chord of 400 lies 50 (1 - cos(pi / 400)) within its circle
    sagitta = 50.0 * (1 - np.cos(np.pi / 400))
    np.testing.assert_allclose(np.linalg.norm(found - centre, axis=1), 50.0, atol=sagitta * 1.01)
    np.testing.assert_allclose(np.linalg.norm(within - centre, axis=1), 20.0, atol=sagitta * 1.01)
    np.testing.assert_allclose(found, centre + (circle(44.0, SAMPLES) - centre) * 50 / 44, atol=0.01)
    # either way round, and from outside
    for samples in (circle(44.0, SAMPLES)[::-1], circle(60.0, SAMPLES)):
        again, _ = contour_points(samples, LipContours(outer[::-1], inner[::-1]))
        np.testing.assert_allclose(again, centre + (samples - centre) * 50 / np.hypot(*(samples[0] - centre)), atol=0.01)


def test_a_normal_that_misses_takes_the_nearest_point():
    beside = LipContours(circle(50.0, 400), circle(5.0, 200, centre=(100.0, 230.0)))
    _, within = contour_points(circle(44.0, SAMPLES), beside)
    np.testing.assert_allclose(np.linalg.norm(within - [100.0, 230.0], axis=1), 5.0, atol=0.01)


@pytest.mark.parametrize("motion", [(0, 0, 0, 0, 0, 0), (0.1, 0.4, -0.1, 0.02, 0.01, -0.3), (0, -0.35, 0.2, 0, 0.03, 0.1)])
def test_compensated_outer_distances_do_not_see_the_heads_motion(stage, subject, frames, motion):
    """With a base that is true the samples lie on the contour: what comes back are the head's own distances."""
    moved = transform(from_vector(np.array(motion, float)), frames)
    base = canonical_meshes(moved, subject.neutral_m, stage.mouth.steady)
    contours = [stage.see(mesh, stage.camera) for mesh in moved]
    features = lip_features(stage.space, base, subject.neutral_m, stage.camera, contours)
    samples = stage.space.samples(base.meshes)[..., :2]
    own = np.linalg.norm(samples[:, ACROSS[:, 0]] - samples[:, ACROSS[:, 1]], axis=2)
    own /= stage.space.eye_distance(subject.neutral_m[None])[0]
    # the camera's undistortion settles at 1e-12
    np.testing.assert_allclose(features.distances[:, :10], own, atol=1e-8)


def test_a_turned_head_is_another_mouth_without_compensation(stage, subject, frames):
    change = {}
    for compensate in (True, False):
        found = []
        for degrees in (0.0, 20.0):
            moved = stage.turned(frames, degrees)
            base = canonical_meshes(moved, subject.neutral_m, stage.mouth.steady)
            contours = [stage.see(mesh, stage.camera) for mesh in moved]
            found.append(
                lip_features(
                    stage.space, base, subject.neutral_m, stage.camera, contours, compensate_rotation=compensate
                ).distances
            )
        change[compensate] = np.abs(found[1] - found[0]).mean()
    assert change[True] < 0.5 * change[False]


def test_an_opening_mouth_shows_between_the_contours(stage, subject):
    shut, wide = subject.neutral_m, subject.mesh({**dict.fromkeys(_channels(), 0.0), "jaw": 1.0})
    base = canonical_meshes(np.stack([shut, wide]), subject.neutral_m, stage.mouth.steady)
    contours = [stage.see(mesh, stage.camera) for mesh in (shut, wide)]
    opening = [np.ptp(contour.inner[:, 1]) for contour in contours]
    assert opening[1] > opening[0] + 10
    distances = lip_features(stage.space, base, subject.neutral_m, stage.camera, contours).distances
    # the middle of the mouth, upper to lower border
    assert distances[1, 5] > distances[0, 5] + 0.1
    # lips do not grow thicker as the jaw falls
    assert np.abs(distances[1, 10:] - distances[0, 10:]).max() < 0.1
    assert len(BETWEEN) == 10


def _channels():
    from headcap.synthetic.performance import CHANNELS

    return CHANNELS


def test_anchored_distances_are_zero_at_rest(stage, people):
    take = people["21"][0].take
    assert np.abs(take.features.distances[:5].mean(axis=0)).max() < 1e-12


def test_frames_without_contours_tell_no_distances(stage, subject, frames):
    lost = frames.copy()
    lost[2] = np.nan
    base = canonical_meshes(lost, subject.neutral_m, stage.mouth.steady)
    contours = [stage.see(frames[0], stage.camera), None, stage.see(frames[2], stage.camera), stage.see(frames[3], stage.camera)]
    features = lip_features(stage.space, base, subject.neutral_m, stage.camera, contours)
    assert np.isfinite(features.distances).all(axis=1).tolist() == [True, False, False, True]
    assert np.isfinite(features.shape).all(axis=1).tolist() == [True, True, False, True]


def test_bad_input_is_told(stage, subject, frames):
    base = canonical_meshes(frames, subject.neutral_m, stage.mouth.steady)
    with pytest.raises(InputError, match="contours of 1 frames"):
        lip_features(stage.space, base, subject.neutral_m, stage.camera, [None])
    with pytest.raises(InputError, match="inner lip contour"):
        LipContours(circle(5.0, 10), np.full((4, 2), np.nan))
    from dataclasses import replace

    nameless = replace(stage.model, landmarks={})
    with pytest.raises(InputError, match="landmark"):
        FeatureSpace.of(nameless, stage.mouth)
