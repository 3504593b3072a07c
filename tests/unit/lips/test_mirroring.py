"""A mouth in a mirror: what is made of mirrored pictures and meshes is what the mirror makes of the take."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.heads.procedural import mirror_partners
from headcap.lips.correction import CanonicalMeshes, CorrectionLayer
from headcap.lips.features import LipContours, LipFeatures, lip_features
from headcap.lips.mirroring import MouthMirror
from headcap.lips.regression import LipTake, RegressionSettings, fold_labels

M = np.diag([-1.0, 1.0, 1.0])
ACROSS = np.diag([-1.0, 1.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def mirror(stage) -> MouthMirror:
    return MouthMirror.of(stage.vertices, stage.mouth, stage.space)


def test_features_and_corrections_of_mirrored_pictures_and_meshes_are_those_in_the_mirror(stage, mirror):
    tracked = stage.rehearse(22, ("lips",), frames=5)[0]
    partner = mirror_partners()

    def turned(meshes):
        return (np.asarray(meshes)[..., partner, :]) @ M

    neutral, camera, base = tracked.layer.base_neutral, stage.camera, tracked.base
    matrix = camera.matrix.copy()
    matrix[0, 2] = camera.width - 1 - matrix[0, 2]
    other = replace(camera, matrix=matrix, camera_from_world=ACROSS @ camera.camera_from_world @ ACROSS)
    seen = CanonicalMeshes(turned(base.meshes), ACROSS @ base.world_from_canonical @ ACROSS)
    size = np.array([camera.width - 1, 0.0])
    contours = [LipContours(size + ring.outer[::-1] * [-1, 1], size + ring.inner[::-1] * [-1, 1]) for ring in tracked.contours]
    features = lip_features(stage.space, base, neutral, camera, tracked.contours)
    found = mirror(LipTake("22", "lips", features, tracked.take.parameters))
    expected = lip_features(stage.space, seen, turned(neutral), other, contours)
    # the basis is in single precision and keeps 99 % of what is symmetric as a whole
    assert np.abs(found.features.shape - expected.shape).max() < 1e-5 * np.abs(expected.shape).max()
    # where a normal meets a corner of a contour, either side of it is taken
    assert np.abs(found.features.distances - expected.distances).max() < 1e-3
    layer = CorrectionLayer(stage.mouth, turned(neutral), "kept")
    parameters = layer.parameters(seen.meshes, turned(neutral), turned(tracked.truth))
    assert np.abs(parameters).max() > 0.1
    assert np.abs(found.parameters - parameters).max() < 1e-5
    # a turned head would not do: left and right do differ here
    assert np.abs(found.parameters - tracked.take.parameters).max() > 0.05


def test_a_mirror_twice_changes_nothing(stage, mirror, rng):
    features = LipFeatures(rng.normal(size=(3, len(stage.space.basis))), rng.normal(size=(3, 20)))
    take = LipTake("a", "one", features, rng.normal(size=(3, len(stage.mouth.layer), 9)).astype(np.float32))
    again = mirror(mirror(take))
    assert np.array_equal(again.parameters, take.parameters)
    assert np.array_equal(again.features.distances, features.distances)
    # components that the basis leaves out: 1 % of the variance
    np.testing.assert_allclose(again.features.shape, features.shape, atol=1e-4)


def test_a_head_that_is_not_symmetric_has_no_mirror(stage):
    skewed = stage.vertices.copy()
    skewed[stage.mouth.outline[3], 0] += 5e-4
    assert MouthMirror.of(skewed, stage.mouth, stage.space) is None


def test_a_take_and_its_mirror_image_are_left_out_together(stage, mirror, rng):
    def take(name):
        features = LipFeatures(rng.normal(size=(8, len(stage.space.basis))), rng.normal(size=(8, 20)))
        return LipTake("a", name, features, np.zeros((8, len(stage.mouth.layer), 9), np.float32))

    takes = [take("one"), take("two"), take("three")]
    labels = fold_labels(takes + [mirror(one) for one in takes], RegressionSettings())
    assert [set(part) for part in labels] == [{0}, {1}, {2}] * 2
    alone = fold_labels([takes[0], mirror(takes[0])], RegressionSettings(folds=4))
    assert alone[0].tolist() == alone[1].tolist() == [0, 0, 1, 1, 2, 2, 3, 3]
