"""The mouth in a picture as a detector sees it: upright and of one size, by the base tracker's pose."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.lips.features import FeatureSpace
from headcap.lips.monocular.pictures import linear_light
from headcap.lips.mouth import Mouth

EYE_DISTANCE_MM = 63.0
"""Of the head that millimetres of the settings are meant on."""


@dataclass(frozen=True, eq=False)
class MouthView:
    """Where a base tracker has the mouth in one picture."""

    border: NDArray[np.float64]
    """(k, 2) pixels, ring along the lips' outer border, from the subject's right corner over the upper lip."""
    left: int
    """Place in `border` of the left corner."""
    eye_distance_px: float
    """Distance of the eyes' middles as it would appear at the mouth's depth, parallel to the picture: no turn shortens it."""
    across: NDArray[np.float64]
    """(2,) unit direction in the picture from the subject's right to the left."""


@dataclass(frozen=True, eq=False)
class MouthLocator:
    """What of a topology tells where its mouth is."""

    outline: NDArray[np.int64]
    left: int
    space: FeatureSpace

    @classmethod
    def of(cls, mouth: Mouth, space: FeatureSpace) -> MouthLocator:
        """From the mouth of a head model and its feature space, which names the eyes."""
        return cls(mouth.outline, mouth.left, space)

    def __call__(self, mesh: NDArray, camera: Camera) -> MouthView | None:
        """Of a base tracker's mesh (n, 3) in the camera's world, metres; None where it is NaN or leaves the picture."""
        ring, eyes = mesh[self.outline], mesh[self.space.eyes].mean(axis=1)
        if not (np.isfinite(ring).all() and np.isfinite(eyes).all()):
            return None
        border, eye_pixels = camera.project(ring)[0], camera.project(eyes)[0]
        middle, eye_distance = ring.mean(axis=0), float(np.linalg.norm(eyes[0] - eyes[1]))
        # a bar as long as the eyes are apart, parallel to the picture, through the middle of the mouth
        half = 0.5 * eye_distance * camera.camera_from_world[0, :3]
        ends = camera.project(np.stack([middle - half, middle + half]))[0]
        inside = ((border >= 0) & (border <= np.array(camera.size) - 1)).all(axis=1)
        along = eye_pixels[0] - eye_pixels[1]
        if not (np.isfinite(ends).all() and np.isfinite(along).all() and inside.all() and along.any()):
            return None
        return MouthView(border, self.left, float(np.linalg.norm(ends[1] - ends[0])), along / np.linalg.norm(along))


@dataclass(frozen=True, eq=False)
class MouthWindow:
    """The mouth's surroundings, upright, of fixed scale."""

    linear: NDArray[np.float32]
    """(h, w, 3) linear intensities, BGR."""
    window_from_picture: NDArray[np.float64]
    """(2, 3) affine."""
    pixels_per_mm: float
    """Of the head whose eyes are `EYE_DISTANCE_MM` apart."""

    def from_picture(self, pixels: NDArray) -> NDArray[np.float64]:
        """Pixels (..., 2) of the picture in the window."""
        return pixels @ self.window_from_picture[:, :2].T + self.window_from_picture[:, 2]

    def to_picture(self, points: NDArray) -> NDArray[np.float64]:
        """Points (..., 2) of the window in the picture."""
        return (points - self.window_from_picture[:, 2]) @ np.linalg.inv(self.window_from_picture[:, :2]).T

    def halved(self) -> MouthWindow:
        """At half the scale: averages of two by two pixels."""
        size = self.linear.shape[1] // 2, self.linear.shape[0] // 2
        shrink = self.window_from_picture / 2
        shrink[:, 2] -= 0.25
        return MouthWindow(cv2.resize(self.linear, size, interpolation=cv2.INTER_AREA), shrink, self.pixels_per_mm / 2)


def mouth_window(
    picture: NDArray[np.uint8], view: MouthView, eye_distance_px: float, margin_mm: float, margin_px: int = 0
) -> MouthWindow:
    """The window of a picture (height, width, 3) uint8, sRGB, BGR, with that distance of the eyes.

    It shows `margin_mm` and `margin_px` about the base tracker's mouth; sides are even. A picture of higher resolution is
    blurred to the window's first; what lies outside it continues its border.
    """
    affine, size = window_affine(view, eye_distance_px, margin_mm, margin_px)
    return MouthWindow(warp(picture, affine, size), affine, eye_distance_px / EYE_DISTANCE_MM)


def window_affine(
    view: MouthView, eye_distance_px: float, margin_mm: float, margin_px: int = 0
) -> tuple[NDArray[np.float64], tuple[int, int]]:
    """window_from_picture (2, 3) and the window's (width, height) for `mouth_window`."""
    scale = eye_distance_px / view.eye_distance_px
    x, y = view.across
    turn = scale * np.array([[x, y], [-y, x]])
    upright = view.border @ turn.T
    margin = margin_mm * eye_distance_px / EYE_DISTANCE_MM + margin_px
    low, high = upright.min(axis=0) - margin, upright.max(axis=0) + margin
    width, height = (2 * np.ceil((high - low + 1) / 2)).astype(int)
    return np.column_stack([turn, -low]), (int(width), int(height))


def warp(picture: NDArray[np.uint8], affine: NDArray, size: tuple[int, int]) -> NDArray[np.float32]:
    """Linear light (h, w, 3) of a picture (height, width, 3) uint8 under an affine map (2, 3) onto a window of (w, h)."""
    width, height = size
    corners = np.array([[-1, -1], [width, -1], [-1, height], [width, height]], float)
    corners = (corners - affine[:, 2]) @ np.linalg.inv(affine[:, :2]).T
    limit = np.array(picture.shape[1::-1])
    # pixels that neither window nor blur reach are left alone
    low = np.clip(np.floor(corners.min(axis=0)).astype(int) - 4, 0, limit - 1)
    high = np.clip(np.ceil(corners.max(axis=0)).astype(int) + 5, low + 1, limit)
    linear = linear_light(np.ascontiguousarray(picture[low[1] : high[1], low[0] : high[0]]))
    scale = np.sqrt(abs(np.linalg.det(affine[:, :2])))
    if scale < 1:
        # brings a pixel's own spread to that of a window's pixel
        linear = cv2.GaussianBlur(linear, (0, 0), 0.5 * np.sqrt(1 / scale**2 - 1) + 1e-3)
    moved = affine.copy()
    moved[:, 2] += affine[:, :2] @ low
    out = cv2.warpAffine(linear, moved, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.maximum(out, 0, out=out)
