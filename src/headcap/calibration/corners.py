"""Sub-pixel places of board corners from the edges that meet in them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.calibration.board import BoardSettings

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]
ARM = 0.48
"""Length of edge used on each side of a corner, in squares: less than half, so that corners stay apart."""
MOST_PIXELS_PER_SQUARE = 56.0


@dataclass(frozen=True)
class BoardView:
    """Corners of one board in one image."""

    corner: NDArray[np.int64]
    """(n,) index into `BoardSettings.corners`."""
    pixels: Array
    """(n, 2), integer pixel centres."""


def refine_corners(image: Grey, view: BoardView, board: BoardSettings) -> tuple[Array, float]:
    """Sub-pixel places (n, 2) of corners near `view.pixels`, and how far (pixels) the search around each could reach.

    The image is warped onto the board's plane. There the edges lie along the axes, and a corner is the point that all
    gradients within a cross of two narrow strips are square to (Foerstner's condition, as in cv2.cornerSubPix, whose square
    window would have to be as small as the margin around a marker). The cross touches no marker and uses all of the edges,
    which halves the noise. Corners whose cross leaves the image get shorter arms; those
    that run off or have no edges come back as NaN.
    """
    squares = board.corners[view.corner, :2] / (board.square_size_mm * 1e-3)
    image_from_board, _ = cv2.findHomography(squares, view.pixels)
    scale = _pixels_per_square(view.pixels, squares)
    if image_from_board is None or not np.isfinite(scale):
        return view.pixels, 0.0
    board_from_flat = np.array([[1 / scale, 0, 0.5 / scale], [0, 1 / scale, 0.5 / scale], [0, 0, 1]])
    image_from_flat = image_from_board @ board_from_flat
    size = tuple(int(np.ceil(n * scale)) for n in board.squares)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    flat = cv2.warpPerspective(image, image_from_flat, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    flat = cv2.GaussianBlur(flat.astype(np.float32), (3, 3), 0.8)
    slope_x, slope_y = cv2.Scharr(flat, cv2.CV_32F, 1, 0), cv2.Scharr(flat, cv2.CV_32F, 0, 1)
    start = cv2.perspectiveTransform(view.pixels.reshape(-1, 1, 2), np.linalg.inv(image_from_flat)).reshape(-1, 2)
    half_width = max(2.0, _clear_share(board) * scale)
    arms = _arms_inside(start, image_from_flat, ARM * scale, image.shape, half_width)
    found = _cross_centres(slope_x, slope_y, start, arms, half_width)
    lost = np.isnan(found[:, 0])
    pixels = cv2.perspectiveTransform(np.nan_to_num(found).reshape(-1, 1, 2), image_from_flat).reshape(-1, 2)
    pixels[lost] = np.nan
    return pixels, half_width


def _pixels_per_square(pixels: Array, squares: Array) -> float:
    """Side of the least foreshortened squares in the image, pixels; bounded, because more resolution gains nothing."""
    apart = np.linalg.norm(squares[:, None] - squares[None], axis=2)
    sides = np.linalg.norm(pixels[:, None] - pixels[None], axis=2)[np.abs(apart - 1) < 1e-6]
    return float(np.clip(np.percentile(sides, 90), 8, MOST_PIXELS_PER_SQUARE)) if len(sides) else float("nan")


def _clear_share(board: BoardSettings) -> float:
    """Half width, in squares, of a strip around an edge that touches nothing else."""
    if board.type == "chessboard":
        return 0.2
    return 0.8 * 0.5 * (1 - board.marker_size_mm / board.square_size_mm)


def _arms_inside(start: Array, image_from_flat: Array, arm: float, shape: tuple[int, ...], least: float) -> Array:
    """(n,) arm lengths in the flat image: full ones where all four ends lie in the image, else a window of `least`."""
    ends = start[:, None] + arm * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    pixels = cv2.perspectiveTransform(ends.reshape(-1, 1, 2), image_from_flat).reshape(-1, 4, 2)
    inside = ((pixels > 1) & (pixels < np.array([shape[1] - 2, shape[0] - 2]))).all(axis=(1, 2))
    return np.where(inside, arm, least)


@njit(cache=True)
def _cross_centres(slope_x, slope_y, start, arms, half_width):  # pragma: no cover - compiled
    """Corners (n, 2) from gradients in a cross around each; NaN for one that runs off or has no edges."""
    height, width = slope_x.shape
    found = start.copy()
    for i in range(len(start)):
        x, y = start[i]
        for _ in range(12):
            a = b = c = u = v = 0.0
            reach = int(np.ceil(arms[i]))
            for row in range(max(0, int(y) - reach), min(height - 1, int(y) + reach + 1) + 1):
                dy = abs(row - y)
                strip = dy < half_width
                span = reach if strip else int(np.ceil(half_width))
                for column in range(max(0, int(x) - span), min(width - 1, int(x) + span + 1) + 1):
                    dx = abs(column - x)
                    across = min(dx, dy) / half_width
                    along = max(dx, dy) / arms[i]
                    if across >= 1 or along >= 1:
                        continue
                    weight = (1 - across * across) ** 2 * (1 - along * along)
                    gx, gy = slope_x[row, column], slope_y[row, column]
                    xx, xy, yy = weight * gx * gx, weight * gx * gy, weight * gy * gy
                    a += xx
                    b += xy
                    c += yy
                    u += xx * column + xy * row
                    v += xy * column + yy * row
            determinant = a * c - b * b
            if determinant <= 1e-6 * (a + c) ** 2 + 1e-12:
                x = y = np.nan
                break
            new_x, new_y = (c * u - b * v) / determinant, (a * v - b * u) / determinant
            moved = abs(new_x - x) + abs(new_y - y)
            x, y = new_x, new_y
            if abs(x - start[i, 0]) + abs(y - start[i, 1]) > 1.5 * half_width:
                x = y = np.nan
                break
            if moved < 1e-3:
                break
        found[i, 0], found[i, 1] = x, y
    return found
