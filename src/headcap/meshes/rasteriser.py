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
    z_buffer = np.full((height, width), np.inf, np.float32)
    inverse_depth = np.where(np.isfinite(pixels).all(1) & (depth > 1e-9), 1.0 / np.where(depth > 1e-9, depth, 1.0), 0.0)
    _fill(
        np.ascontiguousarray(pixels, np.float64),
        inverse_depth,
        np.ascontiguousarray(triangles, np.int32),
        triangle,
        barycentric,
        z_buffer,
        cull_back_faces,
    )
    return Raster(triangle, barycentric, z_buffer)


@njit(cache=True, error_model="numpy")
def _fill(pixels, inverse_depth, triangles, triangle, barycentric, z_buffer, cull_back_faces):
    height, width = triangle.shape
    for f in range(len(triangles)):
        a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        wa, wb, wc = inverse_depth[a], inverse_depth[b], inverse_depth[c]
        if wa == 0.0 or wb == 0.0 or wc == 0.0:
            continue
        ax, ay, bx, by, cx, cy = pixels[a, 0], pixels[a, 1], pixels[b, 0], pixels[b, 1], pixels[c, 0], pixels[c, 1]
        # image y points down: a triangle whose outward side faces the camera has negative area here
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0 or (cull_back_faces and area > 0.0):
            continue
        x0 = max(0, int(np.ceil(min(ax, bx, cx))))
        x1 = min(width - 1, int(np.floor(max(ax, bx, cx))))
        y0 = max(0, int(np.ceil(min(ay, by, cy))))
        y1 = min(height - 1, int(np.floor(max(ay, by, cy))))
        inverse_area = 1.0 / area
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) * inverse_area
                v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) * inverse_area
                w = 1.0 - u - v
                if u < 0.0 or v < 0.0 or w < 0.0:
                    continue
                # 1/z is linear in the image, which makes the barycentrics perspective-correct
                z = 1.0 / (u * wa + v * wb + w * wc)
                if z < z_buffer[y, x]:
                    z_buffer[y, x] = z
                    triangle[y, x] = f
                    barycentric[y, x, 0] = u * wa * z
                    barycentric[y, x, 1] = v * wb * z
                    barycentric[y, x, 2] = w * wc * z
