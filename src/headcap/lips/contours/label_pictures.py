"""Labelled frames as pictures, enlarged about the mouth, for the eye to judge."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.lips.contours.labels import draw_labels
from headcap.lips.features import LipContours

_SHAPE = (480, 640)
"""Rows and columns of an enlarged mouth."""
_AROUND = 0.45
"""What is shown about the contours on each side, in their widths."""
_BEYOND = 70
"""Grey of what lies outside the picture."""
_COLUMNS = 4


def label_picture(picture: NDArray[np.uint8], drawn: LipContours, told: str) -> NDArray[np.uint8]:
    """The mouth of a picture (height, width, 3) uint8, BGR, 480 x 640, with its labels: their points, and the lines between.

    `told` stands in the upper left corner. What lies outside the picture is grey.
    """
    points = np.concatenate([drawn.outer, drawn.inner])
    low, high = points.min(axis=0), points.max(axis=0)
    rows, columns = _SHAPE
    width = max(float((high - low)[0]), float((high - low)[1]) * columns / rows, 1.0) * (1 + 2 * _AROUND)
    scale = columns / width
    # the middle of the labels' box comes to the middle of the enlarged picture
    shift = 0.5 * (np.array([columns, rows]) - 1) - scale * 0.5 * (low + high)
    affine = np.column_stack([scale * np.eye(2), shift])
    grey = (_BEYOND, _BEYOND, _BEYOND)
    large = cv2.warpAffine(picture, affine, (columns, rows), flags=cv2.INTER_CUBIC, borderValue=grey)
    out = draw_labels(large, LipContours(scale * drawn.outer + shift, scale * drawn.inner + shift))
    for colour, thickness in (((0, 0, 0), 3), ((255, 255, 255), 1)):
        cv2.putText(out, told, (10, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.7, colour, thickness, cv2.LINE_AA)
    return out


def label_sheet(tiles: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Tiles of one size (h, w, 3) in rows of four, each half as large."""
    small = [cv2.resize(tile, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for tile in tiles]
    columns = min(_COLUMNS, len(small))
    small += [np.full_like(small[0], _BEYOND)] * (-len(small) % columns)
    return np.concatenate([np.concatenate(small[k : k + columns], axis=1) for k in range(0, len(small), columns)])
