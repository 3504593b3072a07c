"""Training pictures varied, so that what is learnt holds under other lights, on other skins and in other cameras' pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.lips.contours.settings import AugmentationSettings
from headcap.lips.contours.window import EYE_DISTANCE_MM, MouthView, MouthWindow, warp, window_affine
from headcap.lips.features import LipContours

_LEAST_EYE_DISTANCE_PX = 44.0
_CODES = np.arange(4097) / 4096
_ENCODED = np.where(_CODES <= 0.0031308, 12.92 * _CODES, 1.055 * _CODES ** (1 / 2.4) - 0.055)


def encode_light(linear: NDArray) -> NDArray[np.uint8]:
    """sRGB codes of linear intensities, cut at 0 and 1 (IEC 61966-2-1)."""
    return np.rint(255 * _ENCODED[np.rint(np.clip(linear, 0, 1) * 4096).astype(int)]).astype(np.uint8)


def moved_view(view: MouthView, settings: AugmentationSettings, random: np.random.Generator) -> MouthView:
    """The mouth as a base tracker that errs may have it: shifted, turned and of another size."""
    per_mm = view.eye_distance_px / EYE_DISTANCE_MM
    angle = np.radians(settings.turn_deg) * random.normal()
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    shift = settings.shift_mm * per_mm * random.normal(size=2)
    size = np.exp(settings.size_share * random.normal())
    return replace(view, border=view.border + shift, across=turn @ view.across, eye_distance_px=view.eye_distance_px * size)


def varied_window(
    picture: NDArray[np.uint8],
    view: MouthView,
    contours: LipContours,
    eye_distance_px: float,
    margins: tuple[float, int],
    settings: AugmentationSettings,
    random: np.random.Generator,
) -> MouthWindow:
    """A window of a picture (height, width, 3) uint8, as another camera might show it of another person under another light.

    The picture is taken at a random resolution, at most its own; there the lips' and the mouth's colour, lightness, contrast and
    a slow shading change, noise and compression are added; then it is brought to the detector's scale as any other picture is.
    `margins` are the window's millimetres and pixels. With a strength of 0 only the place varies.
    """
    view, strength = moved_view(view, settings, random), settings.strength
    affine, size = window_affine(view, eye_distance_px, *margins)
    if strength == 0:
        return MouthWindow(warp(picture, affine, size), affine, eye_distance_px / EYE_DISTANCE_MM)
    most = max(view.eye_distance_px, _LEAST_EYE_DISTANCE_PX)
    share = np.exp(random.uniform(np.log(_LEAST_EYE_DISTANCE_PX / most), 0.0)) * view.eye_distance_px / eye_distance_px
    share = min(share, 2.0)
    taken, taken_size = affine * share, (int(np.ceil(size[0] * share)) + 2, int(np.ceil(size[1] * share)) + 2)
    linear = warp(picture, taken, taken_size)
    masks = _masks(contours, taken, taken_size, random)
    linear = _relit(linear, masks, strength, random)
    codes = _recorded(linear, strength, random)
    back = np.array([[1 / share, 0, 0], [0, 1 / share, 0]])
    return MouthWindow(warp(codes, back, size), affine, eye_distance_px / EYE_DISTANCE_MM)


@dataclass(frozen=True, eq=False)
class _Masks:
    """Soft shares (h, w) of each pixel."""

    lips: NDArray[np.float32]
    mouth: NDArray[np.float32]


def _masks(contours: LipContours, affine: NDArray, size: tuple[int, int], random: np.random.Generator) -> _Masks:
    filled = []
    for ring in (contours.outer, contours.inner):
        points = ring @ affine[:, :2].T + affine[:, 2]
        mask = np.zeros(size[::-1], np.float32)
        cv2.fillPoly(mask, [np.rint(16 * points).astype(np.int32)], 1.0, shift=4)
        filled.append(mask)
    # no lip's colour ends within a pixel
    soft = [cv2.GaussianBlur(mask, (0, 0), float(np.exp(random.uniform(np.log(0.5), np.log(1.8))))) for mask in filled]
    return _Masks(np.clip(soft[0] - soft[1], 0, 1), soft[1])


def _relit(linear: NDArray, masks: _Masks, strength: float, random: np.random.Generator) -> NDArray[np.float32]:
    """Other colours: in logarithms of intensity, where light and pigment add up."""
    middle = np.maximum(np.median(linear.reshape(-1, 3), axis=0), 1e-4)
    log = np.log(linear / middle + 0.02)
    light = log.mean(axis=2, keepdims=True)
    colour = log - light
    light = light * np.exp(0.25 * strength * random.normal())
    colour = colour * np.exp(0.35 * strength * random.normal())
    light = light + 0.35 * strength * random.normal() * _slow_field(linear.shape[:2], random)
    lips = strength * masks.lips[..., None]
    # blue, green, red: lips are redder or paler than they were, bluer or browner
    reddened = np.array([0.0, -0.5, 0.5]) * 0.14 * (random.normal() + 0.3) + np.array([0.08, 0.0, 0.0]) * random.normal()
    light = light + lips * (0.25 * random.normal() - 0.05)
    colour = colour + lips * reddened
    if random.random() < 0.5 * min(strength, 1.0):
        light, colour = _refilled(light, colour, masks.mouth[..., None], random)
    shine = strength * abs(random.normal()) * 0.35 * _spots(linear.shape[:2], random)[..., None] * masks.lips[..., None]
    exposure = middle * np.exp(strength * (0.35 * random.normal() + 0.12 * random.normal(size=3)))
    relit = np.maximum(np.exp(light + colour) - 0.02, 0) + shine
    return (np.minimum(exposure, 0.7) * relit).astype(np.float32)


def _refilled(light: NDArray, colour: NDArray, mouth: NDArray, random: np.random.Generator) -> tuple[NDArray, NDArray]:
    """Another inside of the mouth: teeth, tongue and the dark in bands, none darker or brighter than mouths are."""
    shape = mouth.shape[:2]
    rows = max(shape[0] // int(random.integers(6, 16)), 2)
    noise = cv2.resize(random.normal(size=(rows, 4)).astype(np.float32), shape[::-1], interpolation=cv2.INTER_CUBIC)[..., None]
    share = 1 / (1 + np.exp(-random.uniform(2, 12) * (noise - 0.4 * random.normal())))
    kinds = [(random.uniform(-2.5, 0.2), np.array([0.0, -0.5, 0.5]) * random.uniform(-0.1, 0.7)) for _ in range(2)]
    inside = [(1 - share) * dark + share * bright for dark, bright in zip(*kinds, strict=True)]
    return light + mouth * (inside[0] - light), colour + mouth * (inside[1] - colour)


def _slow_field(shape: tuple[int, int], random: np.random.Generator) -> NDArray[np.float32]:
    """(h, w, 1) of about unit spread, slower than a mouth: shade from one side."""
    coarse = random.normal(size=(4, 4)).astype(np.float32)
    return cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)[..., None]


def _spots(shape: tuple[int, int], random: np.random.Generator) -> NDArray[np.float32]:
    """(h, w) 0 to 1, a few longish highlights."""
    rows, columns = max(shape[0] // 4, 2), max(shape[1] // 8, 2)
    noise = cv2.resize(random.normal(size=(rows, columns)).astype(np.float32), shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.clip(noise - 1.2, 0, 1)


def _recorded(linear: NDArray, strength: float, random: np.random.Generator) -> NDArray[np.uint8]:
    """sRGB codes with a lens' blur, a sensor's noise and a codec's errors."""
    blurred = cv2.GaussianBlur(linear, (0, 0), 0.3 + 0.5 * strength * random.random())
    noise = 0.02 * strength * random.random() * np.sqrt(np.maximum(blurred, 1e-3)) * random.normal(size=linear.shape)
    codes = encode_light(blurred + noise.astype(np.float32))
    quality = int(100 - 50 * min(strength, 1.0) * random.random())
    return cv2.imdecode(cv2.imencode(".jpg", codes, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)
