"""Rehearsed people, and a base tracker that errs: few smooth expressions, sparse landmarks, ridge, smoothing over time."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from headcap.cameras import Camera
from headcap.geometry.transforms import from_vector, transform
from headcap.heads import procedural_model
from headcap.lips.correction import CorrectionLayer, canonical_meshes
from headcap.lips.features import FeatureSpace, lip_features, tracking_shapes
from headcap.lips.mesh_contours import MeshContours
from headcap.lips.mouth import find_mouth
from headcap.lips.regression import LipTake
from headcap.synthetic.mesh_takes import mesh_subject

EXPRESSIONS, NOISE_M, SMOOTHING_FRAMES = 24, np.array([0.0005, 0.0005, 0.002]), 1.0
"""Depth is what one camera sees worst."""


@dataclass(frozen=True)
class Tracked:
    """A take with what a base tracker and a camera make of it."""

    take: LipTake
    base: object
    """`CanonicalMeshes` (f, n, 3)."""
    truth: np.ndarray
    contours: list
    layer: CorrectionLayer


class Stage:
    """A frontal camera, the head model and its mouth."""

    def __init__(self) -> None:
        self.model = procedural_model()
        self.vertices = np.asarray(self.model.vertices, float)
        self.mouth = find_mouth(self.vertices, self.model.triangles, self.model.regions)
        self.space = FeatureSpace.of(self.model, self.mouth)
        self.see = MeshContours.of(self.vertices, self.mouth, self.model.regions)
        pose = np.array([[1, 0, 0, 0], [0, -1, 0, -0.05], [0, 0, -1, 0.9], [0, 0, 0, 1.0]])
        matrix = np.array([[1500, 0, 269.5], [0, 1500, 479.5], [0, 0, 1.0]])
        self.camera = Camera("front", 540, 960, matrix, np.zeros(5), pose)
        shapes = tracking_shapes(self.model)
        self.shapes = np.concatenate([shapes[:EXPRESSIONS], shapes[-3:]])
        face = [v for name, v in self.model.landmarks.items() if name not in ("back_of_head", "crown", "larynx")]
        self.landmarks = np.r_[face, self.mouth.outline[::6]]

    def track(self, neutral, meshes, rng):
        """Base-tracked meshes (f, n, 3): ridge regression of few blendshapes on noisy landmarks' motion, smoothed over time.

        The person's neutral face is known; how it moves is what one camera gets wrong.
        """
        moved = meshes[:, self.landmarks] - neutral[self.landmarks]
        moved = (moved + NOISE_M * rng.normal(size=moved.shape)) / NOISE_M
        rows = (self.shapes[:, self.landmarks] / NOISE_M).reshape(len(self.shapes), -1)
        weights = np.linalg.solve(rows @ rows.T + np.eye(len(rows)), rows @ moved.reshape(len(moved), -1).T).T
        weights = gaussian_filter1d(weights, SMOOTHING_FRAMES, axis=0)
        return neutral + np.tensordot(weights, self.shapes, 1)

    def rehearse(self, seed, kinds, frames=40):
        """Takes of a person as `Tracked`."""
        subject, rng = mesh_subject(seed), np.random.default_rng(seed)
        neutral = subject.neutral_m
        layer, rest, takes = CorrectionLayer(self.mouth, neutral, "kept"), None, []
        for number, kind in enumerate(kinds):
            truth = subject.take(kind, frames, 20.0, number=number).meshes.astype(float)
            base = canonical_meshes(self.track(neutral, truth, rng), neutral, self.mouth.steady)
            contours = [self.see(mesh, self.camera) for mesh in truth]
            features = lip_features(self.space, base, neutral, self.camera, contours)
            rest = features.distances[:5].mean(axis=0) if rest is None else rest
            parameters = layer.parameters(base.meshes, neutral, truth)
            take = LipTake(str(seed), f"{kind}_{number}", features.anchored(rest), parameters)
            takes.append(Tracked(take, base, truth, contours, layer))
        return takes

    def error_mm(self, meshes, truth):
        """Mean vertex error about the mouth."""
        return 1e3 * np.linalg.norm((meshes - truth)[:, self.mouth.vertices], axis=2).mean()

    def turned(self, meshes, degrees):
        """Meshes turned about the head's vertical axis."""
        return np.stack([transform(from_vector(np.array([0, np.radians(degrees), 0, 0, 0, 0.0])), mesh) for mesh in meshes])


@pytest.fixture(scope="session")
def stage():
    return Stage()


@pytest.fixture(scope="session")
def people(stage):
    """Four people, three takes each."""
    return {str(seed): stage.rehearse(seed, ("lips", "expression", "lips")) for seed in (21, 22, 23, 24)}
