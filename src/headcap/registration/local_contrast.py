"""Local mean and contrast of images, so that exposure, white balance and slow shading fall out of a comparison."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Normalised:
    """An image with local mean 0 and local contrast about 1."""

    image: NDArray[np.float32]
    """(h, w) normalised; 0 outside the mask."""
    contrast: NDArray[np.float32]
    """(h, w) what was divided by, in the input's grey levels."""


def normalise(image: NDArray, mask: NDArray[np.bool_] | None, *, window_px: int, floor: float) -> Normalised:
    """Take out the local mean and divide by the local contrast of a grey image (h, w).

    The statistics are taken over a box of `window_px` within the mask (h, w), or everywhere without one; `floor` (grey
    levels) keeps noise of flat skin from being blown up.
    """
    image = np.asarray(image, np.float32)
    size = (window_px, window_px)
    if mask is None:
        mean, square = (cv2.boxFilter(part, cv2.CV_32F, size, borderType=cv2.BORDER_REFLECT) for part in (image, image * image))
        inside: NDArray | float = 1.0
    else:
        inside = mask.astype(np.float32)
        share = np.maximum(cv2.boxFilter(inside, cv2.CV_32F, size, borderType=cv2.BORDER_CONSTANT), 1e-6)
        masked = image * inside
        parts = (masked, masked * image)
        mean, square = (cv2.boxFilter(part, cv2.CV_32F, size, borderType=cv2.BORDER_CONSTANT) / share for part in parts)
    contrast = np.sqrt(np.maximum(square - mean * mean, 0.0) + np.float32(floor * floor))
    return Normalised((image - mean) / contrast * inside, contrast)


def grey(image: NDArray[np.uint8], *, sigma_px: float = 0.0) -> NDArray[np.float32]:
    """Grey levels (h, w) float32 of a BGR (h, w, 3) or grey photograph, lightly smoothed by `sigma_px`."""
    plane = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    plane = plane.astype(np.float32)
    return cv2.GaussianBlur(plane, (0, 0), sigma_px) if sigma_px > 0 else plane
