"""The textured template seen by a camera: a z-buffer, then a look-up in the texture or in the camera's own first photograph.

Equation 6 compares each photograph with the template rendered "with its texture". Two sources of that texture stand side by
side. The *baked* texture is one atlas for all cameras (section 4.2). The *own pictures* of a camera are its photographs of the
reference frame and of keyframes (see `keyframes`), reached through the mesh as it lay there: the same lens blur, exposure and
shading as every other photograph of that camera, resampled once. A picture serves the triangles that the camera saw well first
in it, the atlas serves the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.meshes.rasteriser import Raster, rasterise_pixels


@dataclass(frozen=True)
class Window:
    """A rectangle of an image: columns x0 to x0 + width, rows y0 to y0 + height."""

    x0: int
    y0: int
    width: int
    height: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """To cut the window out of an (h, w, ...) image."""
        return slice(self.y0, self.y0 + self.height), slice(self.x0, self.x0 + self.width)


@dataclass(frozen=True)
class Projection:
    """A mesh rasterised into the part of a view that it fills."""

    window: Window
    pixels: NDArray[np.float64]
    """(n, 2) vertices in the whole image."""
    raster: Raster
    """Of the window alone."""


@dataclass(frozen=True)
class Picture:
    """A photograph of the camera itself, tied to the surface."""

    image: NDArray[np.float32]
    """(h, w) grey."""
    pixels: NDArray[np.float32]
    """(n, 2) the mesh's vertices in it."""
    clear: NDArray[np.bool_]
    """(h, w) false near folds and silhouettes, where the lens blur mixes two surfaces."""
    serves: NDArray[np.bool_]
    """(m,) triangles that are looked up in it."""


@dataclass(frozen=True)
class Source:
    """Where a camera finds the grey level of a point of the surface."""

    pictures: tuple[Picture, ...]
    """Its own, each triangle served by one of them at most."""
    texture: NDArray[np.float32] | None
    """(h, w) grey atlas at this camera's gain."""
    texture_pixels: NDArray[np.float32] | None
    """(k, 2) texture coordinates in texels."""
    texture_triangles: NDArray[np.int32]
    """(m, 3)."""
    texture_known: NDArray[np.bool_] | None
    """(h, w) texels with a colour."""

    @property
    def served(self) -> NDArray[np.bool_]:
        """(m,) triangles that some picture serves."""
        none = np.zeros(len(self.texture_triangles), np.bool_)
        return np.logical_or.reduce([none, *(picture.serves for picture in self.pictures)])


def project(camera: Camera, vertices_world: NDArray, triangles: NDArray, *, margin_px: int = 2) -> Projection:
    """Rasterise a mesh (n, 3), (m, 3) into the window of the view that it fills; an empty window where it is not seen."""
    pixels, depth = camera.project(vertices_world)
    window = _window(pixels, camera, margin_px)
    shifted = pixels - (window.x0, window.y0)
    return Projection(window, pixels, rasterise_pixels(shifted, depth, triangles, (window.width, window.height)))


def shade(projection: Projection, triangles: NDArray, source: Source) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Grey levels (h, w) of the projected mesh in its window, and where they are known (bicubic look-ups)."""
    shape = projection.raster.triangle.shape
    image, known = np.zeros(shape, np.float32), np.zeros(shape, np.bool_)
    raster = projection.raster
    lookups = [(picture.image, picture.clear, picture.pixels, triangles, picture.serves) for picture in source.pictures]
    if source.texture is not None:
        unserved = ~source.served
        lookups.append((source.texture, source.texture_known, source.texture_pixels, source.texture_triangles, unserved))
    for picture, clear, pixels, corners, serves in lookups:
        box = _extent(projection, triangles, serves)
        _look_up(raster.triangle, raster.barycentric, corners, pixels, picture, clear, serves, box, image, known)
    return image, known


def look_up(
    raster: Raster, triangles: NDArray, pixels: NDArray[np.float32], picture: NDArray[np.float32], wanted: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Grey levels (h, w) of a picture where the surface points of a raster's wanted pixels lie in it, and where they lie inside.

    `pixels` (n, 2) are the vertices in the picture.
    """
    image, known = np.zeros(raster.triangle.shape, np.float32), np.zeros(raster.triangle.shape, np.bool_)
    triangle = np.where(wanted, raster.triangle, -1)
    everywhere, all_triangles = np.ones(picture.shape, np.bool_), np.ones(len(triangles), np.bool_)
    box = np.array([0, 0, raster.triangle.shape[1], raster.triangle.shape[0]])
    _look_up(triangle, raster.barycentric, triangles, pixels, picture, everywhere, all_triangles, box, image, known)
    return image, known


def _extent(projection: Projection, triangles: NDArray, chosen: NDArray[np.bool_]) -> NDArray[np.int64]:
    """(4,) first column and row and those past the last that the chosen triangles can fill: a keyframe's are few."""
    window = projection.window
    bounds = _bounds(projection.pixels[triangles[chosen].ravel()])
    low, high = np.array(bounds[:2]) - (window.x0, window.y0), np.array(bounds[2:]) - (window.x0, window.y0)
    if not (low <= high).all():
        return np.zeros(4, np.int64)
    size = (window.width, window.height)
    return np.concatenate([np.clip(np.floor(low), 0, size), np.clip(np.ceil(high) + 1, 0, size)]).astype(np.int64)


def visible_share(raster: Raster, pixels: NDArray, triangles: NDArray) -> NDArray[np.float64]:
    """(m,) share of each triangle's projected area that the z-buffer leaves to it; 0 for triangles turned away.

    `pixels` (n, 2) are the projected vertices. Unlike a depth test this tells lips from the mouth right behind them.
    """
    return _visible_share(raster.triangle, np.ascontiguousarray(pixels, np.float64), triangles)


def visible_vertices(projection: Projection, triangles: NDArray, n_vertices: int) -> NDArray[np.bool_]:
    """(n,) true where most triangles at a vertex are seen."""
    local = projection.pixels - (projection.window.x0, projection.window.y0)
    seen = visible_share(projection.raster, local, triangles) > 0.5
    return _mostly(seen, triangles, n_vertices)


@njit(cache=True)
def _visible_share(triangle, pixels, triangles):
    share = np.zeros(len(triangles))
    for y in range(triangle.shape[0]):
        for x in range(triangle.shape[1]):
            if triangle[y, x] >= 0:
                share[triangle[y, x]] += 1.0
    for f in range(len(triangles)):
        if share[f] == 0.0:
            continue
        a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        ux, uy = pixels[b, 0] - pixels[a, 0], pixels[b, 1] - pixels[a, 1]
        vx, vy = pixels[c, 0] - pixels[a, 0], pixels[c, 1] - pixels[a, 1]
        # image y points down: outward faces have negative area
        area = -0.5 * (ux * vy - uy * vx)
        share[f] = min(share[f] / area, 1.0) if area > 0.5 else 0.0
    return share


@njit(cache=True)
def _mostly(chosen, triangles, n_vertices):
    """(n,) vertices more than 60 % of whose triangles are chosen."""
    every, some = np.zeros(n_vertices, np.int64), np.zeros(n_vertices, np.int64)
    for f in range(len(triangles)):
        for k in range(3):
            every[triangles[f, k]] += 1
            some[triangles[f, k]] += chosen[f]
    return some > 0.6 * np.maximum(every, 1)


def _window(pixels: NDArray, camera: Camera, margin_px: int) -> Window:
    x0, y0, x1, y1 = _bounds(pixels)
    if not x0 <= x1:
        return Window(0, 0, 0, 0)
    low = np.clip(np.floor([x0, y0]) - margin_px, 0, camera.size).astype(int)
    high = np.clip(np.ceil([x1, y1]) + margin_px + 1, low, camera.size).astype(int)
    return Window(int(low[0]), int(low[1]), int(high[0] - low[0]), int(high[1] - low[1]))


@njit(cache=True)
def _bounds(pixels):
    x0, y0, x1, y1 = np.inf, np.inf, -np.inf, -np.inf
    for i in range(len(pixels)):
        u, v = pixels[i, 0], pixels[i, 1]
        if np.isfinite(u) and np.isfinite(v):
            x0, y0, x1, y1 = min(x0, u), min(y0, v), max(x1, u), max(y1, v)
    return x0, y0, x1, y1


@njit(cache=True, inline="always")
def _cubic(t):
    # Catmull-Rom
    t2, t3 = t * t, t * t * t
    return 0.5 * (-t3 + 2 * t2 - t), 0.5 * (3 * t3 - 5 * t2 + 2), 0.5 * (-3 * t3 + 4 * t2 + t), 0.5 * (t3 - t2)


@njit(cache=True, error_model="numpy", fastmath=True)
def _look_up(triangle, barycentric, corners, pixels, picture, clear, serves, box, image, known):
    rows, columns = picture.shape
    for y in range(box[1], box[3]):
        for x in range(box[0], box[2]):
            f = triangle[y, x]
            if f < 0 or not serves[f]:
                continue
            u, v = 0.0, 0.0
            for k in range(3):
                weight, corner = barycentric[y, x, k], corners[f, k]
                u += weight * pixels[corner, 0]
                v += weight * pixels[corner, 1]
            left, top = int(np.floor(u)), int(np.floor(v))
            if left < 1 or top < 1 or left > columns - 3 or top > rows - 3:
                continue
            if not clear[int(v + 0.5), int(u + 0.5)]:
                continue
            a0, a1, a2, a3 = _cubic(u - left)
            b = _cubic(v - top)
            total = 0.0
            for j in range(4):
                line = top - 1 + j
                total += b[j] * (
                    a0 * picture[line, left - 1]
                    + a1 * picture[line, left]
                    + a2 * picture[line, left + 1]
                    + a3 * picture[line, left + 2]
                )
            image[y, x] = total
            known[y, x] = True
