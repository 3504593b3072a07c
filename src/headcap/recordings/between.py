"""The image between two frames of one camera, by its own optical flow."""

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.recordings.settings import FrameSettings

Image = NDArray[np.uint8]
Flow = NDArray[np.float32]

CELL_PX = 8
INVERSION_STEPS = 3


def image_between(before: Image, after: Image, fraction: float, settings: FrameSettings) -> Image:
    """Bring two frames (height, width, 3) to the moment `fraction` (0 to 1) between them and blend them.

    A skin point seen at p in `before` is at p + fraction * flow(p) then (uniform motion over one frame interval). Flow
    runs both ways; each frame is sampled where its own flow, followed for its share of the time, arrives at the pixel.
    Where the two flows do not undo each other the point is hidden in one frame, and the frame whose flow agrees with
    itself counts. What does not move is copied from the nearer frame.
    """
    nearer = before if fraction < 0.5 else after
    region = _moving_region(before, after, settings)
    if region is None:
        return nearer
    first, second = before[region], after[region]
    forward, backward = _flow(first, second), _flow(second, first)
    out = nearer.copy()
    out[region] = _blend(first, second, forward, backward, fraction)
    return out


def _moving_region(before: Image, after: Image, settings: FrameSettings) -> tuple[slice, slice] | None:
    """Bounding box of cells that change, with a margin; None where nothing does."""
    height, width = before.shape[:2]
    difference = cv2.absdiff(before, after).max(axis=2)
    size = (-(-width // CELL_PX), -(-height // CELL_PX))
    cells = cv2.resize(difference.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    noise = float(np.percentile(cells, 10))
    rows, columns = np.nonzero(cells > noise + settings.still_level)
    if len(rows) == 0:
        return None
    step_y, step_x, margin = height / size[1], width / size[0], settings.margin_px
    top, bottom = int(rows.min() * step_y) - margin, int((rows.max() + 1) * step_y) + margin
    left, right = int(columns.min() * step_x) - margin, int((columns.max() + 1) * step_x) + margin
    return slice(max(top, 0), min(bottom, height)), slice(max(left, 0), min(right, width))


def _flow(source: Image, target: Image) -> Flow:
    """Dense flow (height, width, 2) in pixels, grey images, DIS with its fast preset at half resolution."""
    engine = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    engine.setFinestScale(1)
    return engine.calc(cv2.cvtColor(source, cv2.COLOR_BGR2GRAY), cv2.cvtColor(target, cv2.COLOR_BGR2GRAY), None)


def _blend(first: Image, second: Image, forward: Flow, backward: Flow, fraction: float) -> Image:
    grid = np.stack(np.meshgrid(*(np.arange(n, dtype=np.float32) for n in first.shape[1::-1])), axis=-1)
    in_first = _origin(grid, forward, fraction)
    in_second = _origin(grid, backward, 1 - fraction)
    from_first = _sample(first, in_first)
    from_second = _sample(second, in_second)
    weight_first = (1 - fraction) * _agreement(in_first, forward, backward)
    weight_second = fraction * _agreement(in_second, backward, forward)
    share = (weight_second / (weight_first + weight_second))[..., None]
    return np.clip(np.rint(from_first + share * (from_second - from_first)), 0, 255).astype(np.uint8)


def _origin(grid: Flow, flow: Flow, share: float) -> Flow:
    """Pixels p of the source that arrive at each pixel of the moment: p + share * flow(p) = pixel, by fixed point."""
    origin = grid - share * flow
    for _ in range(INVERSION_STEPS):
        origin = grid - share * _sample(flow, origin, cv2.INTER_LINEAR)
    return origin


def _agreement(origin: Flow, there: Flow, back: Flow) -> NDArray[np.float32]:
    """Near 1 where flow there and back ends where it began, falling to 1e-3 with the distance in pixels."""
    flow = _sample(there, origin, cv2.INTER_LINEAR)
    closure = flow + _sample(back, origin + flow, cv2.INTER_LINEAR)
    error2 = (closure**2).sum(axis=-1)
    return 1 / (1 + error2 * error2) + 1e-3


def _sample(image: NDArray, pixels: Flow, interpolation: int = cv2.INTER_CUBIC) -> NDArray[np.float32]:
    source = image.astype(np.float32)
    return cv2.remap(source, pixels[..., 0], pixels[..., 1], interpolation, borderMode=cv2.BORDER_REPLICATE)
