"""Lips: what a monocular tracker gets wrong about the mouth, learnt from a rig and corrected in any video."""

from headcap.lips.artifact import LipRegressor
from headcap.lips.correction import CanonicalMeshes, CorrectionLayer, HeldBorder, canonical_meshes
from headcap.lips.features import FeatureSpace, LipContours, LipFeatures, border_in_picture, lip_features
from headcap.lips.mouth import Mouth, MouthSettings, find_mouth
from headcap.lips.regression import LipTake, RegressionSettings, train_regression

__all__ = [
    "CanonicalMeshes",
    "CorrectionLayer",
    "FeatureSpace",
    "HeldBorder",
    "LipContours",
    "LipFeatures",
    "LipRegressor",
    "LipTake",
    "Mouth",
    "MouthSettings",
    "RegressionSettings",
    "border_in_picture",
    "canonical_meshes",
    "find_mouth",
    "lip_features",
    "train_regression",
]
