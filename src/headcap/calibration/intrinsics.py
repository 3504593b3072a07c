"""A start for each camera's lens from its own views of the board."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.calibration.corners import BoardView
from headcap.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Lens:
    """Intrinsics of one camera."""

    width: int
    height: int
    matrix: Array
    """(3, 3) K, integer pixel centres."""
    distortion: Array
    """(5,) OpenCV k1, k2, p1, p2, k3."""


def start_lens(camera: str, size: tuple[int, int], views: list[BoardView], corners: Array, *, most: int = 25) -> Lens:
    """Focal length, radial distortion and, with enough views, principal point of one camera (cv2.calibrateCamera).

    `corners` (n, 3) lie on the board; `most` views with the most corners are used, because a start is all that is needed.
    Raises `InputError` with fewer than three usable views.
    """
    usable = sorted((v for v in views if len(v.corner) >= 6), key=lambda v: -len(v.corner))[:most]
    if len(usable) < 3:
        raise InputError(
            f"{camera}: {len(usable)} still views of the board",
            expected="at least 3",
            remedy="Hold the board still before this camera at several angles, or give its intrinsics in the session file.",
        )
    width, height = size
    objects = [corners[v.corner].astype(np.float32) for v in usable]
    images = [v.pixels.astype(np.float32) for v in usable]
    guess = np.array([[max(size) * 1.5, 0, (width - 1) / 2], [0, max(size) * 1.5, (height - 1) / 2], [0, 0, 1.0]])
    simple = cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_ASPECT_RATIO
    flags = simple | cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_FIX_K1
    matrix, distortion = guess, np.zeros(5)
    # a board in one corner of the image tells the focal length alone
    spread = np.ptp(np.concatenate([v.pixels for v in usable]), axis=0) / np.array(size)
    for stage in (flags, simple | cv2.CALIB_USE_INTRINSIC_GUESS):
        if stage != flags and (len(usable) < 6 or spread.min() < 0.7):
            break
        _, matrix, found, _, _ = cv2.calibrateCamera(objects, images, size, matrix.copy(), distortion.copy(), flags=stage)
        distortion = np.ravel(found)[:5].astype(float)
    if not _plausible(matrix, size):
        matrix, distortion = guess, np.zeros(5)
    return Lens(width, height, matrix, distortion)


def _plausible(matrix: Array, size: tuple[int, int]) -> bool:
    focal, centre = matrix[0, 0] / max(size), matrix[:2, 2] / np.array(size)
    return 0.3 < focal < 20 and bool((np.abs(centre - 0.5) < 0.3).all())
