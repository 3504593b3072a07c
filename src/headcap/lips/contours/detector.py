"""The detector of lip contours: likelihood maps of the outer and the inner one, coarse to fine (lip paper, section 3.2.2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_arrays, save_arrays
from headcap.lips.contours.boosting import BoostedTrees
from headcap.lips.contours.channels import channel_images, integral_images
from headcap.lips.contours.features import FeaturePool
from headcap.lips.contours.settings import ContourSettings, SearchSettings
from headcap.lips.contours.window import MouthView, MouthWindow, mouth_window

KIND, SCHEMA = "lip_contour_detector", 1
CONTOURS = ("outer", "inner")
PASSES = ("coarse", "fine")
UNSEEN = -6.0
"""Log-odds, one contour pixel in four hundred, of pixels that nobody looked at."""
_TREES = ("feature", "threshold", "value")


@dataclass(frozen=True, eq=False)
class ContourClassifier:
    """Tells pixels of one contour at one resolution."""

    pool: FeaturePool
    """All features that its training chose from: later trees may ask for others."""
    trees: BoostedTrees

    @cached_property
    def _needed(self) -> tuple[FeaturePool, BoostedTrees]:
        """The features asked for, and trees that number those."""
        used = self.trees.used
        return self.pool.chosen(used), self.trees.numbered(used)

    def __call__(self, integrals: NDArray, pixels: NDArray) -> NDArray[np.float32]:
        """Log-odds (p,), given as many pixels on the contour as beside it, of pixels (p, 2) whose patch lies inside."""
        pool, trees = self._needed
        return trees(pool(integrals, pixels))


@dataclass(frozen=True, eq=False)
class LikelihoodMaps:
    """B^O and B^I of one frame, over its mouth's window."""

    window: MouthWindow
    coarse: dict[str, NDArray[np.float32]]
    """Per contour (h / 2, w / 2) log-odds; `UNSEEN` where the patch leaves the window."""
    fine: dict[str, NDArray[np.float32]]
    """Per contour (h, w); where the coarse pass ruled the contour out, `UNSEEN`."""


@dataclass(frozen=True, eq=False)
class ContourDetector:
    """Four classifiers: two contours at two resolutions."""

    settings: ContourSettings
    classifiers: dict[tuple[str, str], ContourClassifier]
    """By (contour, pass)."""
    persons: tuple[str, ...]
    """Whom it was trained on, those it was adapted to among them."""
    figures: dict[str, float]
    """What training measured: log loss on samples it was not grown from, by contour and pass."""

    def window(self, picture: NDArray[np.uint8], view: MouthView) -> MouthWindow:
        """The mouth's window of a picture (height, width, 3) uint8, sRGB, BGR."""
        own = self.settings
        return mouth_window(picture, view, own.eye_distance_px, own.margin_mm, 2 * own.patch_px + 2)

    def maps(self, window: MouthWindow, search: SearchSettings | None = None) -> LikelihoodMaps:
        """Likelihoods over a window; the fine pass looks only where the coarse one does not rule the contour out."""
        search = search or SearchSettings()
        small = window.halved()
        coarse_integrals = integral_images(channel_images(small.linear))
        fine_integrals = integral_images(channel_images(window.linear))
        coarse, fine = {}, {}
        for contour in CONTOURS:
            everywhere = np.ones(small.linear.shape[:2], bool)
            coarse[contour] = self.map_of(contour, "coarse", coarse_integrals, everywhere)
            again = cv2.dilate((coarse[contour] > search.coarse_log_odds).astype(np.uint8), np.ones((3, 3), np.uint8))
            again = again.repeat(2, axis=0).repeat(2, axis=1).astype(bool)
            fine[contour] = self.map_of(contour, "fine", fine_integrals, again)
        return LikelihoodMaps(window, coarse, fine)

    def map_of(self, contour: str, which: str, integrals: NDArray, wanted: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Log-odds (h, w) of one contour in one pass where they are wanted (h, w) and the patch lies inside, else `UNSEEN`."""
        reach, out = self.settings.patch_px, np.full(wanted.shape, UNSEEN, np.float32)
        inside = wanted[reach:-reach, reach:-reach]
        rows, columns = np.nonzero(inside)
        pixels = np.stack([columns + reach, rows + reach], axis=1)
        out[pixels[:, 1], pixels[:, 0]] = self.classifiers[contour, which](integrals, pixels)
        return out

    def to_arrays(self) -> tuple[dict[str, NDArray], dict]:
        """Arrays and plain record that tell the detector; `from_arrays` is the inverse."""
        arrays = {}
        for (contour, which), classifier in self.classifiers.items():
            place = f"{contour}/{which}"
            arrays |= {f"{place}/channel": classifier.pool.channel, f"{place}/boxes": classifier.pool.boxes}
            arrays |= {f"{place}/{name}": getattr(classifier.trees, name) for name in _TREES}
        return arrays, {"settings": self.settings.model_dump(mode="json"), "persons": list(self.persons), "figures": self.figures}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], meta: dict) -> ContourDetector:
        """The detector that `to_arrays` told."""
        classifiers = {}
        for contour in CONTOURS:
            for which in PASSES:
                place = f"{contour}/{which}"
                pool = FeaturePool(arrays[f"{place}/channel"], arrays[f"{place}/boxes"])
                trees = BoostedTrees(*(arrays[f"{place}/{name}"] for name in _TREES))
                classifiers[contour, which] = ContourClassifier(pool, trees)
        return cls(ContourSettings.model_validate(meta["settings"]), classifiers, tuple(meta["persons"]), meta["figures"])

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.lip_contour_detector/1`."""
        save_arrays(path, KIND, SCHEMA, *self.to_arrays())

    @classmethod
    def load(cls, path: Path | str) -> ContourDetector:
        """Read what `save` wrote; raises `ArtifactError` for another kind of file or schema."""
        return cls.from_arrays(*load_arrays(path, KIND, SCHEMA))
