"""Dense optical flow between two pictures, there and back."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray


def flow_there_and_back(
    first: NDArray[np.uint8], second: NDArray[np.uint8], finest_scale: int | None = None
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Flow (height, width, 2) from one picture (height, width) to another, and how far the way back misses (height, width), px.

    DIS (Kroeger et al. 2016), medium preset; `finest_scale` 0 goes on to whole pixels, the preset stops earlier.
    """
    dis = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    if finest_scale is not None:
        dis.setFinestScale(finest_scale)
    there, back = dis.calc(first, second, None), dis.calc(second, first, None)
    y, x = np.mgrid[: there.shape[0], : there.shape[1]].astype(np.float32)
    returned = [cv2.remap(back[..., k], x + there[..., 0], y + there[..., 1], cv2.INTER_LINEAR) for k in range(2)]
    return there, np.linalg.norm(there + np.stack(returned, axis=2), axis=2)
