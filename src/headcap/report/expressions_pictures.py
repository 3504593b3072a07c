"""Faces of an expression basis: shaded shapes, how far they moved, what a reproduction gets wrong; meshes or markers alike.

Images are (height, width, 3) uint8 RGB. Displacements are (n, 3) metres from the neutral face.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.meshes.rasteriser import rasterise
from headcap.report.overlays import PAPER, Image, facing_light, heat_colours, viewport, virtual_camera

AZIMUTH_DEG = 24.0
"""Seen a little from the side: brows and mouth corners as from in front, and what moves towards the camera shows too."""
MOVES_SHARE = 0.12
"""A point belongs to the picture where any shape moves it by this share of the farthest movement of all."""
_CAPTURED, _REPRODUCED = (214, 40, 40), (36, 84, 214)
_MOVED = (0, 135, 122)
_SMALL = 0.6
"""Of dots that are compared: errors of a millimetre or two must not hide in them."""
_TOLD_SHARE = 0.1
"""Markers that move less than this share of the one that moves most are shown at rest only."""
_CLAY = np.array([[226.0, 222.0, 216.0]])
_HEAT = heat_colours(np.linspace(0, 1, 256), 1.0)
_DARKEST, _DARKEST_HEAT = 0.05, 0.45
"""Brightness of what faces away from the light, over that of what faces it; colours are to be read in shadow too."""
_REST, _TRACE = (196, 203, 206), (120, 134, 141)
_NEAR_SHARE = 0.25
"""The same of a close-up, against the farthest point of its own shape."""
NEAREST = 1.7
"""A picture of one shape shows more than half of the face's height: what is seen is still recognised."""
_MARGIN = 0.05
_FINER = 2
"""Drawn at so many times the size and averaged: edges of lips and lids stay smooth in a small picture."""
_ROUND = (1, 1.5, 2, 3, 4, 5, 6, 8, 10)
_SHARP = 4
"""Bits of a marker's place below a pixel."""
_DOT = 0.009
"""Radius of a marker over the height of the picture."""


@dataclass(frozen=True)
class FacePainter:
    """Draws the faces of one topology, all seen by the same camera."""

    camera: Camera
    """Of the picture before it is averaged: `_FINER` times as large."""
    neutral: NDArray[np.float64]
    """v^0 (n, 3) metres."""
    triangles: NDArray[np.int32]
    """(m, 3); (0, 3) where the points are markers: then dots are drawn."""

    @classmethod
    def framing(
        cls, neutral: NDArray, triangles: NDArray, displacements: NDArray, *, height: int, azimuth_deg: float = AZIMUTH_DEG
    ) -> FacePainter:
        """A painter whose picture, `height` pixels high, holds whatever displacements (k, n, 3) move of a face.

        Markers are all shown. World: y up, z out of the face.
        """
        neutral = np.asarray(neutral, float)
        low, high = displacements.min(axis=0), displacements.max(axis=0)
        farthest = np.maximum(high, -low).max(axis=1)
        shown = farthest >= MOVES_SHARE * farthest.max() if len(triangles) else np.ones(len(neutral), bool)
        points = np.concatenate([(neutral + way)[shown] for way in (low, high, 0)])
        return cls(_camera(points, azimuth_deg, _FINER * height), neutral, np.asarray(triangles, np.int32))

    def close_up(self, *displacements: NDArray) -> FacePainter:
        """A painter of pictures of the same size that go nearer to what displacements (n, 3) move, at most `NEAREST` times."""
        size = np.array(self.camera.size, float)
        farthest = np.max([np.linalg.norm(each, axis=1) for each in displacements], axis=0)
        moves = farthest >= _NEAR_SHARE * max(farthest.max(), 1e-9)
        pixels = np.concatenate([self._pixels(each)[moves] for each in (*displacements, np.zeros_like(self.neutral))])
        if not len(pixels):
            return self
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        part = np.clip(((high - low) / size).max() * (1 + 2 * _MARGIN), 1 / NEAREST, 1.0)
        first = np.clip((low + high - part * size) / 2, -0.5, (1 - part) * size - 0.5)
        near = viewport(self.camera, (*first, *(first + part * size)), self.camera.height)
        return replace(self, camera=replace(near, width=self.camera.width))

    @property
    def is_mesh(self) -> bool:
        """Whether there is a surface to shade."""
        return len(self.triangles) > 0

    def shape(self, displacement: NDArray) -> Image:
        """The face moved by a displacement: a matt surface, or markers at rest, grey, and where those went that move."""
        if not self.is_mesh:
            length = np.linalg.norm(displacement, axis=1)
            return self._pairs(np.zeros_like(self.neutral), displacement, (_REST, _MOVED), length > _TOLD_SHARE * length.max())
        return self._surface(displacement, np.zeros(len(self.neutral)), _CLAY, _DARKEST)

    def errors(self, displacement: NDArray, error_mm: NDArray, top_mm: float) -> Image:
        """The moved face coloured by an error (n,) from 0 to `top_mm`; colours beyond it do not change."""
        if self.is_mesh:
            return self._surface(displacement, np.asarray(error_mm) / top_mm, _HEAT, _DARKEST_HEAT)
        canvas = self._canvas()
        for place, colour in zip(self._pixels(displacement), heat_colours(np.asarray(error_mm), top_mm), strict=True):
            self._dot(canvas, place, tuple(map(float, colour)))
        return _averaged(canvas)

    def against(self, captured: NDArray, reproduced: NDArray) -> Image:
        """Figure 4 of the paper: captured points red, reproduced ones blue, and a line between the two."""
        return self._pairs(captured, reproduced, (_CAPTURED, _REPRODUCED), np.ones(len(captured), bool), _SMALL)

    def _surface(self, displacement: NDArray, shares: NDArray, palette: NDArray, darkest: float) -> Image:
        """The shaded mesh, coloured by shares (n,) of the way through a palette (c, 3)."""
        vertices = self.neutral + displacement
        raster = rasterise(self.camera, vertices, self.triangles)
        light = facing_light(self.camera, vertices, self.triangles)
        corners = (raster.triangle, raster.barycentric, self.triangles)
        return _averaged(_paint(*corners, light, np.asarray(shares, float), palette, darkest))

    def _pairs(self, before: NDArray, after: NDArray, colours: tuple, told: NDArray[np.bool_], size: float = 1.0) -> Image:
        """Points at two places (n, 3), drawn at a size; of those that are `told` (n,) the latter on top, joined to the former."""
        canvas, (first, second) = self._canvas(), colours
        starts, ends = self._pixels(before), self._pixels(after)
        for start in starts:
            self._dot(canvas, start, first, size)
        for start, end in zip(starts[told], ends[told], strict=True):
            cv2.line(canvas, _fixed(start), _fixed(end), _TRACE, _FINER, cv2.LINE_AA, _SHARP)
        for end in ends[told]:
            self._dot(canvas, end, second, 0.75 * size)
        return _averaged(canvas)

    def _canvas(self) -> Image:
        return np.full((self.camera.height, self.camera.width, 3), PAPER, np.uint8)

    def _pixels(self, displacement: NDArray) -> NDArray[np.float64]:
        return self.camera.project(self.neutral + displacement)[0]

    def _dot(self, canvas: Image, place: NDArray, colour: tuple, size: float = 1.0) -> None:
        radius = size * _DOT * self.camera.height
        cv2.circle(canvas, _fixed(place), round(radius * 2**_SHARP), colour, -1, cv2.LINE_AA, _SHARP)


@njit(cache=True)
def _paint(triangle, barycentric, triangles, light, shares, palette, darkest):
    """Colour times brightness of each pixel, both interpolated over its triangle; white where nothing is."""
    height, width = triangle.shape
    out = np.full((height, width, 3), 255, np.uint8)
    last = len(palette) - 1
    for y in range(height):
        for x in range(width):
            if triangle[y, x] < 0:
                continue
            facing, share = 0.0, 0.0
            for corner in range(3):
                vertex = triangles[triangle[y, x], corner]
                facing += barycentric[y, x, corner] * light[vertex]
                share += barycentric[y, x, corner] * shares[vertex]
            bright = darkest + (1.0 - darkest) * min(max(0.25 + 0.75 * facing, 0.0), 1.0)
            entry = int(min(max(share, 0.0), 1.0) * last + 0.5)
            for channel in range(3):
                out[y, x, channel] = np.uint8(bright * palette[entry, channel])
    return out


def _camera(points: NDArray, azimuth_deg: float, height: int) -> Camera:
    """Sees points (n, 3) whole, with a margin; its sides are whole for the averaging."""
    camera = virtual_camera(points, azimuth_deg, height=height)
    pixels = camera.project(points)[0]
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    grow = _MARGIN * (high - low).max()
    seen = viewport(camera, (*(low - grow), *(high + grow)), height)
    return replace(seen, width=seen.width + -seen.width % _FINER)


def _averaged(image: Image) -> Image:
    height, width = image.shape[:2]
    return cv2.resize(image, (width // _FINER, height // _FINER), interpolation=cv2.INTER_AREA)


def _fixed(place: NDArray) -> tuple[int, int]:
    """A place in pixels as whole sub-pixels."""
    return tuple(round(float(each) * 2**_SHARP) for each in place)


def round_top(values_mm: NDArray, share: float = 0.99) -> float:
    """Upper end of a colour scale that holds a share of the values: a round number of millimetres, at least 0.01."""
    known = values_mm[np.isfinite(values_mm)]
    wanted = max(float(np.quantile(known, share)) if len(known) else 0.0, 0.01)
    decade = 10.0 ** np.floor(np.log10(wanted))
    return float(next(step * decade for step in _ROUND if step * decade >= wanted * (1 - 1e-9)))


def length_mm(displacement: NDArray) -> NDArray[np.float64]:
    """Lengths (..., n) in millimetres of displacements (..., n, 3) in metres."""
    return 1e3 * np.linalg.norm(np.asarray(displacement, float), axis=-1)


def joined(images: list[Image], *, gap: int = 4) -> Image:
    """Pictures of one height in a row on white."""
    blank = np.full((images[0].shape[0], gap, 3), PAPER, np.uint8)
    parts = [part for image in images for part in (image, blank)]
    return np.concatenate(parts[:-1], axis=1)
