"""What edge features are made of: pictures of lightness, colour and edges by direction, as integral images.

After the integral channel features of Dollar et al. (2009), the successors of the features of boosted edge learning (2006).
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

BINS = 6
"""Directions of a gradient, all round: an edge from light to dark is another than one from dark to light."""
OPPONENTS = ("lightness", "red_green", "green_blue")
NAMES = (*OPPONENTS, *(f"{name}_{part}" for name in OPPONENTS[:2] for part in ("edge", *map(str, range(BINS)))))
_FLOOR = 0.04
"""Share of a channel's median that counts as no light: keeps the mouth's dark inside from ruling by its noise."""
_EDGE_SIGMA_PX = 1.0
_LEAST_EDGE = 0.02
"""Mean slope of a logarithm, per pixel, that is noise where nothing else is."""
_SURROUND_PX = 12


def opponents(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """Lightness and colour (3, h, w) of a picture in linear light (h, w, 3), BGR: what stays as the light changes.

    With x_k the channel over its median in the window, y_k = log(x_k + 0.04): mean of y, y_red - y_green (which orders colours as
    pseudo-hue R / (R + G) does, in which lips differ from skin) and y_green - y_blue. A gain of any channel, exposure or white
    balance, changes none of them.
    """
    median = np.median(linear.reshape(-1, 3)[::3], axis=0)
    log = np.log(linear / np.maximum(median, 1e-6).astype(np.float32) + np.float32(_FLOOR))
    return np.ascontiguousarray(np.stack([log.mean(axis=2), log[..., 2] - log[..., 1], log[..., 1] - log[..., 0]]))


def channel_images(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """Channels (17, h, w) of `NAMES` of a picture in linear light (h, w, 3), BGR.

    Slopes are those of the channel blurred by a pixel, over their mean within 12 pixels: contrast, too, depends on the light.
    """
    base = opponents(linear)
    images = np.empty((len(NAMES), *base.shape[1:]), np.float32)
    images[:3] = base
    for k in range(2):
        smooth = cv2.GaussianBlur(base[k], (0, 0), _EDGE_SIGMA_PX)
        dx = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=1, scale=0.5)
        dy = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=1, scale=0.5)
        slope = np.sqrt(dx * dx + dy * dy)
        side = 2 * _SURROUND_PX + 1
        slope_about = cv2.blur(slope, (side, side)) + np.float32(_LEAST_EDGE)
        first = 3 + k * (BINS + 1)
        images[first] = slope / slope_about
        _by_direction(dx, dy, images[first], images[first + 1 : first + 1 + BINS])
    return images


@njit(cache=True)
def _by_direction(dx, dy, strength, out):
    """Histograms of one gradient each: its strength shared by the two nearest of `BINS` directions."""
    bins = out.shape[0]
    for y in range(dx.shape[0]):
        for x in range(dx.shape[1]):
            turn = np.arctan2(dy[y, x], dx[y, x]) * (bins / (2 * np.pi)) + bins
            low = int(np.floor(turn))
            share = turn - low
            for k in range(bins):
                out[k, y, x] = 0.0
            out[low % bins, y, x] = (1 - share) * strength[y, x]
            out[(low + 1) % bins, y, x] = share * strength[y, x]


@njit(cache=True)
def integral_images(images):
    """(c, h + 1, w + 1) float64 sums of images (c, h, w) over all pixels above and to the left."""
    channels, height, width = images.shape
    out = np.zeros((channels, height + 1, width + 1))
    for c in range(channels):
        for y in range(height):
            row = 0.0
            for x in range(width):
                row += images[c, y, x]
                out[c, y + 1, x + 1] = out[c, y, x + 1] + row
    return out
