"""Silhouettes a user brings: one image per camera and frame, white on the subject."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError


def read_silhouettes(pattern: str, frame: int, cameras: Sequence[str]) -> list[NDArray[np.bool_]]:
    """Masks (height, width) of one frame, camera by camera; `pattern` holds {camera} and {frame}.

    `{frame}` may carry a format, as {frame:06d}. Raises `InputError` for a pattern that is wrong or a file that is no image.
    """
    return [_read(pattern, frame, camera) for camera in cameras]


def _read(pattern: str, frame: int, camera: str) -> NDArray[np.bool_]:
    try:
        path = pattern.format(camera=camera, frame=frame)
    except (KeyError, IndexError, ValueError) as error:
        remedy = "Correct the take's masks in the session file"
        raise InputError(f"masks: {pattern!r}", expected="a pattern with {camera} and {frame:06d}", remedy=remedy) from error
    image = cv2.imread(path, cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise InputError(
            f"masks: {path} is no image", expected="one for each camera and frame", remedy="Write it, or leave masks out"
        )
    return image > 127
