"""How well points foretell a photograph they were not made from: a measure of accuracy that needs no truth."""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.reconstruction.points import PointCloud
from headcap.reconstruction.windows import JIT


def photo_consistency(cloud: PointCloud, camera: Camera, image_bgr: NDArray[np.uint8], *, window_px: int = 11) -> float:
    """Median normalised cross-correlation, -1 to 1, of a photograph with the coloured points drawn into its camera.

    Points that face the camera are splatted with a z-buffer; windows of `window_px` that are covered to three quarters
    count. Meant for a view left out of the reconstruction (Szeliski 1999, prediction error). Raises `InputError` where
    the points cover no window.
    """
    drawn, covered = draw_points(cloud, camera)
    grey = cv2.cvtColor(image_bgr, cv2.COLOR_BGR2GRAY).astype(np.float32)
    correlation = _masked_correlation(drawn, grey, covered, window_px)
    if not correlation.size:
        raise InputError(
            f"camera {camera.name} sees no points", expected="a view of the subject", remedy="Check its calibration."
        )
    return float(np.median(correlation))


def draw_points(cloud: PointCloud, camera: Camera) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Grey image (height, width) of the points that face a camera, and where it is covered."""
    positions, normals = cloud.positions.astype(np.float64), cloud.normals.astype(np.float64)
    pixels, depth = camera.project(positions)
    facing = ((camera.centre - positions) * normals).sum(1) > 0
    inside = np.isfinite(pixels).all(1) & facing
    grey = cloud.colours[inside] @ np.array([0.299, 0.587, 0.114])
    image, weight = np.zeros((camera.height, camera.width)), np.zeros((camera.height, camera.width))
    nearest = np.full((camera.height, camera.width), np.inf)
    _splat(pixels[inside], depth[inside], grey, nearest, image, weight)
    covered = weight > 0
    return np.where(covered, image / np.where(covered, weight, 1), 0).astype(np.float32), covered


@njit(**JIT)
def _splat(pixels, depth, grey, nearest, image, weight):
    """Two passes over a 5 x 5 footprint: the nearest depth, then a weighted mean of what lies within 1 % behind it."""
    height, width = image.shape
    for second in range(2):
        for k in range(len(depth)):
            column, row = round(pixels[k, 0]), round(pixels[k, 1])
            for y in range(max(0, row - 2), min(height, row + 3)):
                for x in range(max(0, column - 2), min(width, column + 3)):
                    if not second:
                        nearest[y, x] = min(nearest[y, x], depth[k])
                    elif depth[k] < nearest[y, x] * 1.01:
                        away = (pixels[k, 0] - x) ** 2 + (pixels[k, 1] - y) ** 2
                        share = np.exp(-1.5 * away)
                        image[y, x] += share * grey[k]
                        weight[y, x] += share


def _masked_correlation(a: NDArray, b: NDArray, covered: NDArray[np.bool_], window_px: int) -> NDArray[np.float64]:
    def total(values: NDArray) -> NDArray:
        """Sum over the covered pixels of the window around each pixel."""
        return cv2.boxFilter(np.where(covered, values, 0).astype(np.float64), -1, (window_px, window_px), normalize=False)

    n = np.maximum(total(np.ones(a.shape)), 1)
    mean_a, mean_b = total(a) / n, total(b) / n
    variance_a, variance_b = total(a * a) / n - mean_a**2, total(b * b) / n - mean_b**2
    cross = total(a * b) / n - mean_a * mean_b
    # a flat window has no correlation: both must vary by more than rounding to grey levels does
    usable = covered & (n >= 0.75 * window_px**2) & (variance_a > 1) & (variance_b > 1)
    return cross[usable] / np.sqrt(variance_a[usable] * variance_b[usable])
