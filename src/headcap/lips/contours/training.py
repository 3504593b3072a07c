"""Contour detectors from labelled pictures: a few by hand, or as many as a tracked mesh explains (lip paper, section 3.2.2)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.lips.contours.boosting import BoostedTrees, grow_trees, log_loss
from headcap.lips.contours.channels import channel_images, integral_images
from headcap.lips.contours.detector import CONTOURS, PASSES, ContourClassifier, ContourDetector
from headcap.lips.contours.features import FeaturePool, draw_pool
from headcap.lips.contours.frames import paired
from headcap.lips.contours.settings import ContourSettings, SearchSettings
from headcap.lips.contours.variation import varied_window
from headcap.lips.contours.window import EYE_DISTANCE_MM, MouthLocator, MouthView, MouthWindow
from headcap.lips.features import LipContours
from headcap.lips.mesh_contours import MeshContours

_BESIDE = 3
"""Samples beside a contour for one on it."""
_HELD_OUT = 5
"""Every fifth picture measures what training makes of the rest."""
_KEEP_MM = 60.0
"""What of a picture an example keeps about the mouth: windows at their largest and most shifted."""


@dataclass(frozen=True, eq=False)
class LipExample:
    """A picture with the lips' contours in it, and where a base tracker has the mouth."""

    picture: NDArray[np.uint8]
    """(height, width, 3) sRGB, BGR."""
    view: MouthView
    contours: LipContours
    person: str

    def cropped(self) -> LipExample:
        """The same without what lies far from the mouth, to keep many."""
        reach = _KEEP_MM * self.view.eye_distance_px / EYE_DISTANCE_MM
        low = np.maximum(np.floor(self.view.border.min(axis=0) - reach), 0).astype(int)
        high = np.ceil(self.view.border.max(axis=0) + reach).astype(int) + 1
        view = MouthView(self.view.border - low, self.view.left, self.view.eye_distance_px, self.view.across)
        contours = LipContours(self.contours.outer - low, self.contours.inner - low)
        return LipExample(self.picture[low[1] : high[1], low[0] : high[0]].copy(), view, contours, self.person)


def mesh_examples(
    person: str,
    pictures: Iterable[NDArray[np.uint8]],
    meshes: Iterable[NDArray],
    camera: Camera,
    see: MeshContours,
    locate: MouthLocator,
) -> list[LipExample]:
    """Examples from tracked meshes (n, 3), one per picture: the rig tells the contours that one of its cameras sees.

    Frames without a mesh (None, or NaN about the mouth), or whose mouth leaves the picture, are left out. Raises `InputError`
    where pictures and meshes differ in number.
    """
    found = []
    for picture, mesh in paired(pictures, meshes):
        view = None if mesh is None else locate(mesh, camera)
        if view is not None:
            found.append(LipExample(picture, view, see(mesh, camera), person).cropped())
    return found


def labelled_examples(
    person: str,
    pictures: Iterable[NDArray[np.uint8]],
    labels: Mapping[int, LipContours],
    base_meshes: Iterable[NDArray],
    camera: Camera,
    locate: MouthLocator,
) -> list[LipExample]:
    """Examples from contours drawn by hand, by frame number, with the base tracker's meshes (n, 3), one per picture.

    Labelled frames that the base tracker lost are left out. Raises `InputError` for labels of frames that the video does not
    have, or where pictures and meshes differ in number.
    """
    found, frames = [], 0
    for frame, (picture, mesh) in enumerate(paired(pictures, base_meshes)):
        frames = frame + 1
        view = locate(mesh, camera) if frame in labels else None
        if view is not None:
            found.append(LipExample(picture, view, labels[frame], person).cropped())
    beyond = [frame for frame in labels if not 0 <= frame < frames]
    if beyond:
        raise InputError(
            f"labels of frame {beyond[0]} in a video of {frames}",
            expected=f"frame numbers from 0 to {frames - 1}",
            remedy="Give the labels of this video.",
        )
    return found


def train_detector(examples: Sequence[LipExample], settings: ContourSettings | None = None) -> ContourDetector:
    """A detector from labelled pictures, each varied several times.

    The coarse classifiers learn from pixels all over the windows; the fine ones beside contours only from pixels that the coarse
    pass lets through. Raises `InputError` without examples.
    """
    settings = settings or ContourSettings()
    if not examples:
        raise _nothing()
    pool = draw_pool(settings.features, settings.patch_px, settings.seed)
    persons = tuple(sorted({example.person for example in examples}))
    detector = ContourDetector(settings, {}, persons, {})
    for which in PASSES:
        detector = _trained(detector, which, examples, pool, None)
    return detector


def adapt_detector(detector: ContourDetector, examples: Sequence[LipExample], trees: int = 20) -> ContourDetector:
    """The detector with more trees that learn what it lacks on a handful of labelled pictures of one person or light.

    The paper trains anew for each illumination; boosting goes on from what is known instead. Raises `InputError` without
    examples.
    """
    if not examples:
        raise _nothing()
    persons = tuple(sorted({*detector.persons, *(example.person for example in examples)}))
    adapted = ContourDetector(detector.settings, dict(detector.classifiers), persons, dict(detector.figures))
    for which in PASSES:
        adapted = _trained(adapted, which, examples, None, trees)
    return adapted


def _trained(
    detector: ContourDetector, which: str, examples: Sequence[LipExample], pool: FeaturePool | None, more_trees: int | None
) -> ContourDetector:
    """With classifiers of one pass: new ones from a pool, or those it has with more trees."""
    settings, classifiers, figures = detector.settings, dict(detector.classifiers), dict(detector.figures)
    pools = {contour: pool or classifiers[contour, which].pool for contour in CONTOURS}
    samples = gather_samples(detector, which, examples, pools)
    for k, contour in enumerate(CONTOURS):
        values, shows, held = samples[contour]
        known = classifiers[contour, which].trees if more_trees else None
        growing = settings.boosting.model_copy(update={"trees": more_trees} if more_trees else {})
        start = None if known is None else known(values[:, ~held])
        grown = grow_trees(values[:, ~held], shows[~held], growing, settings.seed + k, start)
        trees: BoostedTrees = grown if known is None else known.then(grown)
        classifiers[contour, which] = ContourClassifier(pools[contour], trees)
        if held.any():
            figures[f"log_loss_{contour}_{which}"] = log_loss(trees(values[:, held]), shows[held])
    return ContourDetector(settings, classifiers, detector.persons, figures)


def gather_samples(
    detector: ContourDetector, which: str, examples: Sequence[LipExample], pools: dict[str, FeaturePool]
) -> dict[str, tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_]]]:
    """Per contour: features (k, p), whether a sample shows the contour (p,), and whether it is held out (p,), of one pass."""
    found: dict[str, list] = {contour: [] for contour in CONTOURS}
    for number, window, random, contours in _windows(detector.settings, examples):
        shown = window.halved() if which == "coarse" else window
        integrals = integral_images(channel_images(shown.linear))
        held = len(examples) >= _HELD_OUT and number % _HELD_OUT == _HELD_OUT - 1
        passed = _passed(detector, window) if which == "fine" else {}
        for contour in CONTOURS:
            ring = shown.from_picture(getattr(contours, contour))
            pixels, shows = _drawn(ring, shown, detector.settings, passed.get(contour), random)
            found[contour].append((pools[contour](integrals, pixels), shows, np.full(len(shows), held)))
    joined = {}
    for contour, parts in found.items():
        values, shows, held = zip(*parts, strict=True)
        joined[contour] = np.concatenate(values, axis=1), np.concatenate(shows), np.concatenate(held)
    return joined


def _windows(
    settings: ContourSettings, examples: Sequence[LipExample]
) -> Iterator[tuple[int, MouthWindow, np.random.Generator, LipContours]]:
    """Variations of every example, mirrored half of the time: number, window, what draws its samples, contours."""
    margins, own = (settings.margin_mm, 2 * settings.patch_px + 2), settings.augmentation
    for number, example in enumerate(examples):
        for copy in range(own.copies):
            random = np.random.default_rng([settings.seed, 3, number, copy])
            chosen = _mirrored(example) if random.random() < 0.5 else example
            # from hardly to fully varied: the detector is to be exact where pictures are good, and robust where they are not
            varied = own.model_copy(update={"strength": own.strength * random.random()})
            window = varied_window(
                chosen.picture, chosen.view, chosen.contours, settings.eye_distance_px, margins, varied, random
            )
            yield number, window, random, chosen.contours


def _mirrored(example: LipExample) -> LipExample:
    width = example.picture.shape[1]

    def across(points: NDArray) -> NDArray:
        """Pixels (..., 2) in the mirrored picture."""
        return np.stack([width - 1 - points[:, 0], points[:, 1]], axis=1)

    # the ring goes on from the subject's right corner, which was the left one, over the upper lip
    border = np.roll(across(example.view.border)[::-1], example.view.left + 1, axis=0)
    direction = np.array([example.view.across[0], -example.view.across[1]])
    view = MouthView(border, example.view.left, example.view.eye_distance_px, direction)
    contours = LipContours(across(example.contours.outer), across(example.contours.inner))
    return LipExample(np.ascontiguousarray(example.picture[:, ::-1]), view, contours, example.person)


def _passed(detector: ContourDetector, window: MouthWindow) -> dict[str, NDArray[np.bool_]]:
    """Per contour the pixels (h, w) that the coarse pass lets through."""
    small, least = window.halved(), SearchSettings().coarse_log_odds
    integrals, everywhere = integral_images(channel_images(small.linear)), np.ones(small.linear.shape[:2], bool)
    maps = {contour: detector.map_of(contour, "coarse", integrals, everywhere) for contour in CONTOURS}
    return {contour: (odds > least).repeat(2, axis=0).repeat(2, axis=1) for contour, odds in maps.items()}


def _drawn(
    ring: NDArray, window: MouthWindow, settings: ContourSettings, passed: NDArray | None, random: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Pixels (p, 2) on a contour and beside it, and which are which (p,)."""
    away = ring_distance(ring, *window.linear.shape[:2])
    edge = settings.patch_px
    inside = np.zeros(away.shape, bool)
    inside[edge:-edge, edge:-edge] = True
    on = np.argwhere(inside & (away <= settings.tolerance_px))
    beside = inside & (away >= settings.clearance_px)
    beside = np.argwhere(beside if passed is None else beside & passed)
    on = on[random.permutation(len(on))[: settings.samples]]
    beside = beside[random.permutation(len(beside))[: _BESIDE * settings.samples]]
    return np.concatenate([on, beside])[:, ::-1], np.arange(len(on) + len(beside)) < len(on)


@njit(cache=True)
def ring_distance(ring, height, width):
    """Distance (height, width) of every pixel to a closed polyline (k, 2) of columns and rows."""
    out = np.full((height, width), np.inf)
    for k in range(len(ring)):
        ax, ay = ring[k - 1]
        dx, dy = ring[k, 0] - ax, ring[k, 1] - ay
        length = dx * dx + dy * dy
        for y in range(height):
            for x in range(width):
                px, py = x - ax, y - ay
                share = min(max((px * dx + py * dy) / length, 0.0), 1.0) if length > 0 else 0.0
                away = (px - share * dx) ** 2 + (py - share * dy) ** 2
                if away < out[y, x]:
                    out[y, x] = away
    return np.sqrt(out)


def _nothing() -> InputError:
    return InputError(
        "no labelled picture",
        expected="one at least, a dozen better",
        remedy="Label some frames, or give a take with tracked meshes.",
    )
