"""Lips: what a monocular tracker gets wrong about the mouth, learnt from a rig and corrected in any video."""

from headcap.lips.artifact import LipRegressor
from headcap.lips.correction import CanonicalMeshes, CorrectionLayer, HeldPlaces, canonical_meshes
from headcap.lips.features import FeatureSpace, LipContours, LipFeatures, lip_features
from headcap.lips.foreign_tracks import BaseTrack, FlameTrack, MeshTrack, canonical_track, load_flame_track, mesh_track
from headcap.lips.mouth import Mouth, MouthSettings, find_mouth
from headcap.lips.regression import LipTake, RegressionSettings, train_regression

__all__ = [
    "BaseTrack",
    "CanonicalMeshes",
    "CorrectionLayer",
    "FeatureSpace",
    "FlameTrack",
    "HeldPlaces",
    "LipContours",
    "LipFeatures",
    "LipRegressor",
    "LipTake",
    "MeshTrack",
    "Mouth",
    "MouthSettings",
    "RegressionSettings",
    "canonical_meshes",
    "canonical_track",
    "find_mouth",
    "lip_features",
    "load_flame_track",
    "mesh_track",
    "train_regression",
]
