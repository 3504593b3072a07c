"""The paper's figure 5: a frame, its texture, the painted texture, the painted frame."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.lips.inpainting.painter import LipPainter
from headcap.lips.inpainting.views import window

_GAP_PX, _UNSEEN = 8, 127
_AROUND = 0.25
"""Of the mouth's box, shown about it."""


def inpainting_figure(
    painter: LipPainter, mesh: NDArray, picture: NDArray[np.uint8], *, height_px: int = 320
) -> NDArray[np.uint8]:
    """One picture (height_px, width, 3) of a tattooed frame: the frame about the mouth, its UV texture, the inpainted texture and
    the inpainted frame; texels that the camera does not see are grey."""
    region = painter.texture.region
    seen = painter.view(mesh, picture)
    tattooed = region.spread(np.where(seen.weight[:, None] > 0, seen.colours, _UNSEEN), fill=255.0)
    on_skin = region.spread(np.ones((len(region.texel), 1)))[..., 0] > 0
    painted = np.where(on_skin[..., None], painter.shaded(mesh, picture), 255.0)
    first = np.s_[:, : region.first_width]
    box = _box(painter, mesh, picture.shape)
    parts = [picture[box], tattooed[first], painted[first], painter.paint(mesh, picture)[box]]
    shown = [_as_high(np.rint(part).astype(np.uint8), height_px) for part in parts]
    gap = np.full((height_px, _GAP_PX, 3), 255, np.uint8)
    return np.concatenate([shown[0], *(piece for part in shown[1:] for piece in (gap, part))], axis=1)


def _box(painter: LipPainter, mesh: NDArray, shape: tuple[int, ...]) -> tuple[slice, slice]:
    x0, y0, x1, y1 = window(painter.camera, np.asarray(mesh, float)[painter.texture.region.vertices])
    more = round(_AROUND * max(x1 - x0, y1 - y0))
    return slice(max(y0 - more, 0), min(y1 + more, shape[0])), slice(max(x0 - more, 0), min(x1 + more, shape[1]))


def _as_high(picture: NDArray[np.uint8], height_px: int) -> NDArray[np.uint8]:
    width = max(round(picture.shape[1] * height_px / picture.shape[0]), 1)
    return cv2.resize(
        picture, (width, height_px), interpolation=cv2.INTER_AREA if picture.shape[0] > height_px else cv2.INTER_CUBIC
    )
