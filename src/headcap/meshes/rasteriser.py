"""A z-buffer that gives, per pixel, the triangle, its barycentrics and the depth.

Vertices are projected with the full lens model and triangles are filled between them, so lens distortion is exact at
vertices and off by less than (edge in pixels)^2 * 1e-6 between them.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.cameras import Camera


@dataclass(frozen=True)
class Raster:
    """What each pixel of one view sees."""

    triangle: NDArray[np.int32]
    """(height, width) triangle index, -1 where nothing is hit."""
    barycentric: NDArray[np.float32]
    """(height, width, 3) perspective-correct weights of the triangle's corners."""
    depth: NDArray[np.float32]
    """(height, width) camera z in metres, +inf where nothing is hit."""

    @property
    def hit(self) -> NDArray[np.bool_]:
        """(height, width) true where a triangle is seen."""
        return self.triangle >= 0

    def interpolate(self, corner_triangles: NDArray, values: NDArray) -> NDArray:
        """Values (n, k) at corners `corner_triangles` (n_triangles, 3), per pixel (height, width, k); NaN outside."""
        out = np.full((*self.triangle.shape, values.shape[1]), np.nan)
        hit = self.hit
        corners = values[corner_triangles[self.triangle[hit]]]
        out[hit] = np.einsum("nc,nck->nk", self.barycentric[hit], corners)
        return out


def rasterise(camera: Camera, vertices_world: NDArray, triangles: NDArray, *, cull_back_faces: bool = False) -> Raster:
    """Rasterise a mesh (n, 3), (m, 3) into a camera; a triangle with a corner behind the camera is left out."""
    pixels, depth = camera.project(np.asarray(vertices_world, float))
    return rasterise_pixels(pixels, depth, triangles, camera.size, cull_back_faces=cull_back_faces)


def rasterise_pixels(
    pixels: NDArray, depth: NDArray, triangles: NDArray, size: tuple[int, int], *, cull_back_faces: bool = False
) -> Raster:
    """Rasterise from projected corners: pixels (n, 2), depth (n,), triangles (m, 3), size (width, height)."""
    width, height = size
    triangle = np.full((height, width), -1, np.int32)
    barycentric = np.zeros((height, width, 3), np.float32)
    nearest = np.zeros((height, width), np.float32)
    pixels, triangles = np.ascontiguousarray(pixels, np.float64), np.ascontiguousarray(triangles, np.int32)
    inverse_depth = np.where(np.isfinite(pixels).all(1) & (depth > 1e-9), 1.0 / np.where(depth > 1e-9, depth, 1.0), 0.0)
    _fill(pixels, inverse_depth, triangles, triangle, nearest, cull_back_faces)
    _interpolate(pixels, inverse_depth, triangles, triangle, barycentric, nearest)
    return Raster(triangle, barycentric, nearest)


ON_EDGE_PX = 1e-9
"""A pixel on a shared edge belongs to both triangles: rounding must not leave it to neither."""


@njit(cache=True, error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def _fill(pixels, inverse_depth, triangles, triangle, nearest, cull_back_faces):
    """The nearest triangle of each pixel and 1 / z there, which is linear in the image."""
    height, width = triangle.shape
    for f in range(len(triangles)):
        a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        wa, wb, wc = inverse_depth[a], inverse_depth[b], inverse_depth[c]
        if wa == 0.0 or wb == 0.0 or wc == 0.0:
            continue
        ax, ay, bx, by, cx, cy = pixels[a, 0], pixels[a, 1], pixels[b, 0], pixels[b, 1], pixels[c, 0], pixels[c, 1]
        y0, y1 = max(0, int(np.ceil(min(ay, by, cy)))), min(height - 1, int(np.floor(max(ay, by, cy))))
        # image y points down: a triangle whose outward side faces the camera has negative area here
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if y1 < y0 or area == 0.0 or (cull_back_faces and area > 0.0):
            continue
        # barycentrics u, v, 1 - u - v are linear in x: each tells where along a row it turns negative
        step_u, step_v = (by - cy) / area, (cy - ay) / area
        step_w = -step_u - step_v
        root_u, root_v, root_w = _reciprocal(step_u), _reciprocal(step_v), _reciprocal(step_w)
        step_near = step_u * (wa - wc) + step_v * (wb - wc)
        for y in range(y0, y1 + 1):
            u, v = (bx * (cy - y) - (by - y) * cx) / area, (cx * (ay - y) - (cy - y) * ax) / area
            low, high = _clip(0.0, width - 1.0, u, step_u, root_u)
            low, high = _clip(low, high, v, step_v, root_v)
            low, high = _clip(low, high, 1 - u - v, step_w, root_w)
            if low > high + 2 * ON_EDGE_PX:
                continue
            near = wc + u * (wa - wc) + v * (wb - wc)
            for x in range(int(np.ceil(low - ON_EDGE_PX)), int(np.floor(high + ON_EDGE_PX)) + 1):
                here = np.float32(near + x * step_near)
                if here > nearest[y, x]:
                    nearest[y, x] = here
                    triangle[y, x] = f


@njit(cache=True, inline="always", error_model="numpy")
def _reciprocal(slope):
    return 1.0 / slope if slope != 0.0 else 0.0


@njit(cache=True, inline="always", error_model="numpy")
def _clip(low, high, value, slope, reciprocal):
    """The part of low to high where value + slope x is not negative; empty where low > high."""
    if slope > 0.0:
        return max(low, -value * reciprocal), high
    if slope < 0.0:
        return low, min(high, -value * reciprocal)
    return (low, high) if value >= 0.0 else (1.0, -1.0)


@njit(cache=True, error_model="numpy")
def _interpolate(pixels, inverse_depth, triangles, triangle, barycentric, nearest):
    """Perspective-correct weights of each pixel's triangle; `nearest` becomes depth."""
    for y in range(triangle.shape[0]):
        for x in range(triangle.shape[1]):
            f = triangle[y, x]
            if f < 0:
                nearest[y, x] = np.inf
                continue
            a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
            ax, ay, bx, by, cx, cy = pixels[a, 0], pixels[a, 1], pixels[b, 0], pixels[b, 1], pixels[c, 0], pixels[c, 1]
            area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
            u = max(((bx - x) * (cy - y) - (by - y) * (cx - x)) / area, 0.0)
            v = max(((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area, 0.0)
            wu, wv, ww = u * inverse_depth[a], v * inverse_depth[b], max(1.0 - u - v, 0.0) * inverse_depth[c]
            depth = 1.0 / (wu + wv + ww)
            barycentric[y, x, 0], barycentric[y, x, 1], barycentric[y, x, 2] = wu * depth, wv * depth, ww * depth
            nearest[y, x] = depth
