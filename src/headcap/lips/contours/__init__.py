"""Lip contours in pictures: boosted edge detectors for the outer and the inner one (lip paper, section 3.2.2)."""

from headcap.lips.contours.detector import ContourDetector, LikelihoodMaps
from headcap.lips.contours.finder import ContourFinder, ContourSequence, FoundContours, find_contours
from headcap.lips.contours.labels import draw_contours, draw_labels, load_labels, save_labels
from headcap.lips.contours.settings import AugmentationSettings, BoostingSettings, ContourSettings, SearchSettings
from headcap.lips.contours.training import LipExample, adapt_detector, labelled_examples, mesh_examples, train_detector
from headcap.lips.contours.window import MouthLocator, MouthView

__all__ = [
    "AugmentationSettings",
    "BoostingSettings",
    "ContourDetector",
    "ContourFinder",
    "ContourSequence",
    "ContourSettings",
    "FoundContours",
    "LikelihoodMaps",
    "LipExample",
    "MouthLocator",
    "MouthView",
    "SearchSettings",
    "adapt_detector",
    "draw_contours",
    "draw_labels",
    "find_contours",
    "labelled_examples",
    "load_labels",
    "mesh_examples",
    "save_labels",
    "train_detector",
]
