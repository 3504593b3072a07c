"""Lips: what a monocular tracker gets wrong about the mouth, learnt from a rig and corrected in any video."""

from headcap.lips.artifact import LipRegressor
from headcap.lips.correction import CanonicalMeshes, CorrectionLayer, HeldBorder, canonical_meshes
from headcap.lips.correspondence import Correspondence, LipCorrespondenceSettings, NeutralFace, correspond, same_topology
from headcap.lips.features import FeatureSpace, LipContours, LipFeatures, border_in_picture, lip_features
from headcap.lips.foreign_tracks import BaseTrack, FlameTrack, MeshTrack, canonical_track, load_flame_track, mesh_track
from headcap.lips.mouth import Mouth, MouthSettings, find_mouth
from headcap.lips.regression import LipTake, RegressionSettings, train_regression

__all__ = [
    "BaseTrack",
    "CanonicalMeshes",
    "CorrectionLayer",
    "Correspondence",
    "FeatureSpace",
    "FlameTrack",
    "HeldBorder",
    "LipContours",
    "LipCorrespondenceSettings",
    "LipFeatures",
    "LipRegressor",
    "LipTake",
    "MeshTrack",
    "Mouth",
    "MouthSettings",
    "NeutralFace",
    "RegressionSettings",
    "border_in_picture",
    "canonical_meshes",
    "canonical_track",
    "correspond",
    "find_mouth",
    "lip_features",
    "load_flame_track",
    "mesh_track",
    "same_topology",
    "train_regression",
]
