"""The image between two frames of one camera, by its own optical flow.

Flow is worked on images of half size; offsets are in pixels of that half size until the frames themselves are sampled.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.recordings.settings import FrameSettings

Image = NDArray[np.uint8]
Grey = NDArray[np.uint8]
Field = NDArray[np.float32]

CELL_PX = 8
INVERSION_STEPS = 3
REFINEMENT_STEPS = 5
# motion of a face bends smoothly: over this many half-size pixels the bend is averaged, so flow noise does not enter twice
BEND_BLUR_PX = 15


@dataclass(frozen=True)
class Motion:
    """Where points of one frame go on their way to a neighbour frame.

    A point at p is at p + share * step(p) + share * (share - 1) * bend(p) after `share` (0 to 1) of the way: the parabola
    through its places in the frame behind, in its own and in the frame ahead.
    """

    step: Field
    """(rows, columns, 2) flow to the frame ahead."""
    bend: Field | None
    """(rows, columns, 2); None where there is no frame behind: straight motion."""

    def offset(self, share: float) -> Field:
        """(rows, columns, 2) displacement after a share of the way."""
        straight = share * self.step
        return straight if self.bend is None else straight + np.float32(share * (share - 1)) * self.bend


def half_grey(image: Image) -> Grey:
    """Grey image of half size, rounded down, for `flow`."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return cv2.resize(grey, (grey.shape[1] // 2, grey.shape[0] // 2), interpolation=cv2.INTER_AREA)


def flow(source: Grey, target: Grey) -> Field:
    """Dense flow (rows, columns, 2) between grey images by dense inverse search (Kroeger et al. 2016) and its refinement."""
    engine = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
    engine.setFinestScale(0)
    engine.setVariationalRefinementIterations(REFINEMENT_STEPS)
    return engine.calc(source, target, None)


def motion(ahead: Field, behind: Field | None, behind_ratio: float = 1.0) -> Motion:
    """Motion of a frame from its flow to the frame ahead and, where there is one, to the frame behind.

    `behind_ratio` is the interval to the frame behind over that to the frame ahead (frames may be dropped). Where the
    bend comes out larger than half the step one of the flows is wrong (a point hidden in a neighbour): no bend there.
    """
    if behind is None:
        return Motion(ahead, None)
    bend = (behind + behind_ratio * ahead) / np.float32(behind_ratio * (behind_ratio + 1))
    plausible = np.hypot(*cv2.split(bend)) < 0.5 + 0.5 * np.hypot(*cv2.split(ahead))
    weight = cv2.blur(plausible.astype(np.float32), (BEND_BLUR_PX, BEND_BLUR_PX))
    mean = cv2.blur(bend * plausible[..., None], (BEND_BLUR_PX, BEND_BLUR_PX))
    # where few are plausible the mean fades out rather than resting on those few
    return Motion(ahead, mean / np.maximum(weight, 0.5)[..., None])


def image_between(before: Image, after: Image, from_before: Motion, from_after: Motion, fraction: float) -> Image:
    """Bring two frames (height, width, 3) to the moment `fraction` (0 to 1) between them and blend them.

    `from_before` leads towards `after`, `from_after` the other way. Each frame is sampled where its own motion, followed
    for its share of the time, arrives at the pixel. Where the two flows do not undo each other the point is hidden in one
    frame, and the frame whose flow agrees with itself counts.
    """
    grid = _grid(from_before.step.shape[:2])
    origin_before = _origin(grid, from_before.offset(fraction))
    origin_after = _origin(grid, from_after.offset(1 - fraction))
    weight_before = (1 - fraction) * _agreement(origin_before, from_before.step, from_after.step)
    weight_after = fraction * _agreement(origin_after, from_after.step, from_before.step)
    height, width = before.shape[:2]
    share_after = cv2.resize(weight_after / (weight_before + weight_after), (width, height))
    sampled_before = _sample_full(before, origin_before - grid)
    sampled_after = _sample_full(after, origin_after - grid)
    return cv2.blendLinear(sampled_before, sampled_after, 1 - share_after, share_after)


def moving_region(before: Image, after: Image, settings: FrameSettings) -> tuple[slice, slice] | None:
    """Rows and columns of the box around cells that change, with a margin; None where nothing does."""
    height, width = before.shape[:2]
    size = (-(-width // CELL_PX), -(-height // CELL_PX))
    cells = cv2.resize(cv2.absdiff(before, after), size, interpolation=cv2.INTER_AREA).max(axis=2)
    noise = float(np.percentile(cells, 10))
    rows, columns = np.nonzero(cells > noise + settings.still_level)
    if len(rows) == 0:
        return None
    bounds = []
    for cell, length, count in ((rows, height, size[1]), (columns, width, size[0])):
        step = length / count
        low, high = int(cell.min() * step) - settings.margin_px, int((cell.max() + 1) * step) + settings.margin_px
        bounds.append(slice(max(low, 0), min(high, length)))
    return bounds[0], bounds[1]


@lru_cache(maxsize=4)
def _grid(shape: tuple[int, int]) -> Field:
    """Pixel (x, y) of each place of (rows, columns), to be read only; the same for all frames of a size."""
    return np.stack(np.meshgrid(*(np.arange(n, dtype=np.float32) for n in shape[::-1])), axis=-1)


def _origin(grid: Field, offset: Field) -> Field:
    """Pixels p of the source that arrive at each pixel of the moment: p + offset(p) = pixel, by fixed point."""
    origin = grid - offset
    for _ in range(INVERSION_STEPS):
        origin = grid - _sample(offset, origin)
    return origin


def _agreement(origin: Field, there: Field, back: Field) -> NDArray[np.float32]:
    """Near 1 where flow there and back ends where it began, falling to 1e-3 with the distance in pixels."""
    step = _sample(there, origin)
    closure = step + _sample(back, origin + step)
    error2 = closure[..., 0] ** 2 + closure[..., 1] ** 2
    return 1 / (1 + 16 * error2 * error2) + np.float32(1e-3)


def _sample(field: Field, pixels: Field) -> Field:
    return cv2.remap(field, pixels, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _sample_full(image: Image, offset: Field) -> Image:
    """Sample a frame at its pixels moved by an offset field of half size."""
    height, width = image.shape[:2]
    scale = np.float32([width / offset.shape[1], height / offset.shape[0]])
    pixels = cv2.add(_grid((height, width)), cv2.resize(scale * offset, (width, height)))
    return cv2.remap(image, pixels, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
