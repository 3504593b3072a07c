"""Lip contours in pictures: boosted edge detectors for the outer and the inner one (lip paper, section 3.2.2)."""

from headcap.lips.contours.adapting import Agreement, agreement, held_out_agreement
from headcap.lips.contours.detector import ContourDetector, LikelihoodMaps
from headcap.lips.contours.finder import ContourFinder, ContourSequence, FoundContours, find_contours
from headcap.lips.contours.label_checks import label_faults
from headcap.lips.contours.label_pictures import label_picture, label_sheet
from headcap.lips.contours.labelme import save_labelme
from headcap.lips.contours.labels import draw_contours, draw_labels, label_files, load_labels, save_labels, starting_labels
from headcap.lips.contours.settings import AugmentationSettings, BoostingSettings, ContourSettings, SearchSettings
from headcap.lips.contours.training import LipExample, adapt_detector, labelled_examples, mesh_examples, train_detector
from headcap.lips.contours.window import MouthLocator, MouthView

__all__ = [
    "Agreement",
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
    "agreement",
    "draw_contours",
    "draw_labels",
    "find_contours",
    "held_out_agreement",
    "label_faults",
    "label_files",
    "label_picture",
    "label_sheet",
    "labelled_examples",
    "load_labels",
    "mesh_examples",
    "save_labelme",
    "save_labels",
    "starting_labels",
    "train_detector",
]
