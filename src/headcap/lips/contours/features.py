"""Edge features over a small patch (lip paper, section 3.2.2): gradients, histograms of filter responses, Haar wavelets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.lips.contours.channels import BINS, NAMES

_OPPONENTS = 3
_HAAR_SCALES = (1, 2, 3, 5)
_CELLS = (2, 4)
"""Half sides of the cells of histograms."""


@dataclass(frozen=True, eq=False)
class FeaturePool:
    """k features: the mean of a channel over one box of the patch, less that over another where there is one."""

    channel: NDArray[np.int32]
    """(k,) of `channels.NAMES`."""
    boxes: NDArray[np.int32]
    """(k, 2, 4) left, top, right, bottom against the patch's middle, ends included; a second box that is empty (right < left)
    counts nothing."""

    def __len__(self) -> int:
        return len(self.channel)

    def chosen(self, features: NDArray) -> FeaturePool:
        """Some of them."""
        return FeaturePool(self.channel[features], self.boxes[features])

    @property
    def reach_px(self) -> int:
        """Half the side of the patch that they look at."""
        used = self.boxes[..., 2] >= self.boxes[..., 0]
        return int(np.abs(self.boxes[used]).max(initial=0))

    def __call__(self, integrals: NDArray, pixels: NDArray) -> NDArray[np.float32]:
        """Values (k, p) at pixels (p, 2), column and row, of integral images (c, h + 1, w + 1); the patch must lie inside."""
        out = np.empty((len(self), len(pixels)), np.float32)
        _evaluate(integrals, np.ascontiguousarray(pixels, np.int32), self.channel, self.boxes, out)
        return out


def draw_pool(count: int, patch_px: int, seed: int) -> FeaturePool:
    """`count` features over a patch of that half side: all gradients, lines and histograms, the rest Haar wavelets at random."""
    fixed = [*_gradients(patch_px), *_surrounds(patch_px), *_histograms(patch_px)]
    random = np.random.default_rng([seed, 1])
    drawn = [_random_wavelet(random, patch_px) for _ in range(max(0, count - len(fixed)))]
    pool = (fixed + drawn)[:count] if len(fixed) <= count else [fixed[k] for k in random.permutation(len(fixed))[:count]]
    channel, boxes = zip(*pool, strict=True)
    return FeaturePool(np.array(channel, np.int32), np.array(boxes, np.int32).reshape(-1, 2, 4))


_NO_BOX = (0, 0, -1, -1)


def _gradients(patch_px: int):
    """Two boxes side by side, at every scale, along both axes and (half overlapping) both diagonals."""
    for channel in range(_OPPONENTS):
        for s in _HAAR_SCALES:
            if 2 * s > patch_px:
                continue
            yield channel, ((-2 * s, -s, -1, s), (1, -s, 2 * s, s))
            yield channel, ((-s, -2 * s, s, -1), (-s, 1, s, 2 * s))
            yield channel, ((-2 * s, -2 * s, 0, 0), (0, 0, 2 * s, 2 * s))
            yield channel, ((-2 * s, 0, 0, 2 * s), (0, -2 * s, 2 * s, 0))


def _surrounds(patch_px: int):
    """Lines and spots: a middle box less all about it."""
    for channel in range(_OPPONENTS):
        for s in _HAAR_SCALES:
            wide = 3 * s
            if wide > patch_px:
                continue
            yield channel, ((-wide, -s // 2, wide, s // 2), (-wide, -wide, wide, wide))
            yield channel, ((-s // 2, -wide, s // 2, wide), (-wide, -wide, wide, wide))
            yield channel, ((-s // 2, -s // 2, s // 2, s // 2), (-wide, -wide, wide, wide))


def _histograms(patch_px: int):
    """Edges by direction in the cells of a grid of three by three, at two scales."""
    for channel in range(_OPPONENTS, len(NAMES)):
        is_sum = (channel - _OPPONENTS) % (BINS + 1) == 0
        for s in _CELLS:
            step = 2 * s
            if step + s > patch_px:
                continue
            for row in (-1, 0, 1):
                for column in (-1, 0, 1):
                    if is_sum and (row or column):
                        continue
                    x, y = column * step, row * step
                    yield channel, ((x - s, y - s, x + s, y + s), _NO_BOX)


def _random_wavelet(random: np.random.Generator, patch_px: int):
    """Two boxes anywhere in the patch, of any channel."""
    boxes = []
    for _ in range(2):
        half = random.integers(0, max(1, patch_px // 3) + 1, 2)
        middle = random.integers(-(patch_px - half), patch_px - half + 1)
        boxes.append((*(middle - half), *(middle + half)))
    return int(random.integers(0, _OPPONENTS + 2 * (BINS + 1))), tuple(boxes)


@njit(cache=True)
def _evaluate(integrals, pixels, channel, boxes, out):
    width = integrals.shape[2]
    for k in range(len(channel)):
        table = integrals[channel[k]].ravel()
        for part in range(2):
            left, top, right, bottom = boxes[k, part, 0], boxes[k, part, 1], boxes[k, part, 2], boxes[k, part, 3]
            if right < left:
                continue
            sign = (1.0 if part == 0 else -1.0) / ((right - left + 1) * (bottom - top + 1))
            # the table's entry (y, x) sums all pixels above row y and left of column x
            a, b = top * width + left, top * width + right + 1
            c, d = (bottom + 1) * width + left, (bottom + 1) * width + right + 1
            for i in range(len(pixels)):
                at = pixels[i, 1] * width + pixels[i, 0]
                value = sign * (table[at + d] - table[at + b] - table[at + c] + table[at + a])
                if part == 0:
                    out[k, i] = value
                else:
                    out[k, i] += value
