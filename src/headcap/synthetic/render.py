"""Photographs of the subject: exact lens at every vertex, two by two samples per pixel, filtered solid texture.

The neighbouring rasteriser answers which triangle a pixel's centre sees; this one makes pictures, so it works on
samples, keeps only what shading needs and averages linear light.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.synthetic.texture import Grain, albedo

SAMPLES = 2
"""Samples per pixel, along each axis."""


@dataclass(frozen=True)
class Surface:
    """What of a subject's surface never changes."""

    triangles: NDArray[np.int32]
    """(m, 3), counter-clockwise seen from outside."""
    material: NDArray[np.uint8]
    """(m,) of `texture.SKIN`, ..."""
    look: NDArray[np.float32]
    """(n, 7) columns `texture.LOOK_COLUMNS`."""
    rest_area_mm2: NDArray[np.float32]
    """(m,) area of each triangle at rest."""


def render_surface(
    camera: Camera,
    vertices_m: NDArray,
    surface: Surface,
    light: NDArray,
    grain: Grain,
    background: NDArray,
    rows: tuple[int, int] | None = None,
) -> NDArray[np.float32]:
    """Linear RGB (rows, width, 3) of a surface at `vertices_m` (n, 3) under `light` (n, 4).

    `background` (rows, width, 3) shows where no triangle is hit; `rows` (first, one past the last) renders a band of the
    picture alone, for rolling shutters.
    """
    first, last = rows or (0, camera.height)
    shape = ((last - first) * SAMPLES, camera.width * SAMPLES)
    nearest, depth = np.full(shape, -1, np.int32), np.zeros(shape, np.float32)
    corners = _sample_positions(camera, vertices_m, first)
    footprint = np.zeros(len(surface.triangles), np.float32)
    _rasterise(corners, surface.triangles, surface.rest_area_mm2, nearest, depth, footprint)
    picture = np.ascontiguousarray(background, np.float32).copy()
    light = np.ascontiguousarray(light, np.float32)
    _shade(
        nearest, corners, surface.triangles, surface.material, surface.look, light, footprint, grain.coarse, grain.fine, picture
    )
    return picture


def _sample_positions(camera: Camera, vertices_m: NDArray, first_row: int) -> NDArray[np.float32]:
    """Column and row on the sample grid and 1/z, 0 where not in front, (n, 3); sample k lies at (k + 0.5) / SAMPLES - 0.5."""
    rotation, translation = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    out = np.empty((len(vertices_m), 3), np.float64)
    _project(np.ascontiguousarray(vertices_m, np.float64), rotation, translation, camera.matrix, camera.distortion, out)
    out[:, :2] = (out[:, :2] + 0.5) * SAMPLES - 0.5
    out[:, 1] -= first_row * SAMPLES
    return out


@njit(cache=True, error_model="numpy")
def _project(points, rotation, translation, matrix, distortion, out):
    k1, k2, p1, p2, k3 = distortion[0], distortion[1], distortion[2], distortion[3], distortion[4]
    for k in range(len(points)):
        px, py, pz = points[k, 0], points[k, 1], points[k, 2]
        z = rotation[2, 0] * px + rotation[2, 1] * py + rotation[2, 2] * pz + translation[2]
        if z < 1e-3:
            out[k] = 0.0
            continue
        x = (rotation[0, 0] * px + rotation[0, 1] * py + rotation[0, 2] * pz + translation[0]) / z
        y = (rotation[1, 0] * px + rotation[1, 1] * py + rotation[1, 2] * pz + translation[1]) / z
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        out[k, 0] = matrix[0, 0] * xd + matrix[0, 1] * yd + matrix[0, 2]
        out[k, 1] = matrix[1, 1] * yd + matrix[1, 2]
        out[k, 2] = 1 / z


@njit(cache=True, error_model="numpy")
def _rasterise(corners, triangles, rest_area_mm2, nearest, inverse_depth, footprint):
    """The nearest triangle of each sample; `footprint` is told for triangles that are seen.

    Backs come last: nearly all of them are then found hidden at once, by the depth that is there already.
    """
    backs, count = np.empty(len(triangles), np.int32), 0
    for f in range(len(triangles)):
        # rows grow downwards: a triangle seen from outside has negative area
        if _doubled_area(corners, triangles[f, 0], triangles[f, 1], triangles[f, 2]) < 0.0:
            _fill(f, corners, triangles, rest_area_mm2, nearest, inverse_depth, footprint)
        else:
            backs[count] = f
            count += 1
    for k in range(count):
        _fill(backs[k], corners, triangles, rest_area_mm2, nearest, inverse_depth, footprint)


@njit(cache=True, inline="always", error_model="numpy")
def _doubled_area(corners, a, b, c):
    ax, ay = corners[a, 0], corners[a, 1]
    return (corners[b, 0] - ax) * (corners[c, 1] - ay) - (corners[b, 1] - ay) * (corners[c, 0] - ax)


@njit(cache=True, inline="always", error_model="numpy")
def _fill(f, corners, triangles, rest_area_mm2, nearest, inverse_depth, footprint):
    height, width = nearest.shape
    a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
    ax, ay, bx, by, cx, cy = corners[a, 0], corners[a, 1], corners[b, 0], corners[b, 1], corners[c, 0], corners[c, 1]
    wa, wb, wc = corners[a, 2], corners[b, 2], corners[c, 2]
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    x0, x1 = max(0, int(np.ceil(min(ax, bx, cx)))), min(width - 1, int(np.floor(max(ax, bx, cx))))
    y0, y1 = max(0, int(np.ceil(min(ay, by, cy)))), min(height - 1, int(np.floor(max(ay, by, cy))))
    if x0 > x1 or y0 > y1 or area == 0.0 or wa == 0.0 or wb == 0.0 or wc == 0.0:
        return
    # rounding may carry a sample's depth over that of the nearest corner, by far less than this
    most, scale, seen = max(wa, wb, wc) * (1.0 + 1e-9), 1.0 / area, False
    for y in range(y0, y1 + 1):
        for x in range(x0, x1 + 1):
            if inverse_depth[y, x] >= most:
                continue
            u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) * scale
            v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) * scale
            w = 1.0 - u - v
            if min(u, v, w) < 0.0:
                continue
            closer = u * wa + v * wb + w * wc
            if closer > inverse_depth[y, x]:
                inverse_depth[y, x] = closer
                nearest[y, x] = f
                seen = True
    if seen:
        # millimetres of resting skin between samples; its sign tells the side that is seen
        footprint[f] = np.sqrt(2 * rest_area_mm2[f] / abs(area)) * (1.0 if area < 0 else -1.0)


@njit(cache=True, fastmath=True, error_model="numpy")
def _shade(nearest, corners, triangles, material, look, light, footprint, coarse, fine, picture):
    height, width = picture.shape[0], picture.shape[1]
    share = np.float32(1.0 / (SAMPLES * SAMPLES))
    for row in range(height):
        for column in range(width):
            red, green, blue, hits = np.float32(0), np.float32(0), np.float32(0), 0
            for sample in range(SAMPLES * SAMPLES):
                y, x = row * SAMPLES + sample // SAMPLES, column * SAMPLES + sample % SAMPLES
                f = nearest[y, x]
                if f < 0:
                    continue
                hits += 1
                a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
                ax, ay, bx, by = corners[a, 0] - x, corners[a, 1] - y, corners[b, 0] - x, corners[b, 1] - y
                cx, cy = corners[c, 0] - x, corners[c, 1] - y
                # 1/z is linear in the picture, which makes the weights perspective-correct
                u = (bx * cy - by * cx) * corners[a, 2]
                v = (cx * ay - cy * ax) * corners[b, 2]
                w = (ax * by - ay * bx) * corners[c, 2]
                scale = 1.0 / (u + v + w)
                u, v, w = np.float32(u * scale), np.float32(v * scale), np.float32(w * scale)
                if footprint[f] < 0:  # the inside of the neck's cut, the back of a lid
                    shade = np.float32(0.03) * (u * light[a, 0] + v * light[b, 0] + w * light[c, 0])
                    red, green, blue = red + shade, green + shade, blue + shade
                    continue
                r, g, bl = albedo(
                    material[f],
                    u * look[a, 0] + v * look[b, 0] + w * look[c, 0],
                    u * look[a, 1] + v * look[b, 1] + w * look[c, 1],
                    u * look[a, 2] + v * look[b, 2] + w * look[c, 2],
                    u * look[a, 3] + v * look[b, 3] + w * look[c, 3],
                    u * look[a, 4] + v * look[b, 4] + w * look[c, 4],
                    u * look[a, 5] + v * look[b, 5] + w * look[c, 5],
                    u * look[a, 6] + v * look[b, 6] + w * look[c, 6],
                    coarse,
                    fine,
                    footprint[f],
                )
                shine = u * light[a, 3] + v * light[b, 3] + w * light[c, 3]
                red += r * (u * light[a, 0] + v * light[b, 0] + w * light[c, 0]) + shine
                green += g * (u * light[a, 1] + v * light[b, 1] + w * light[c, 1]) + shine
                blue += bl * (u * light[a, 2] + v * light[b, 2] + w * light[c, 2]) + shine
            if hits > 0:
                rest = np.float32(1.0) - hits * share
                picture[row, column, 0] = red * share + rest * picture[row, column, 0]
                picture[row, column, 1] = green * share + rest * picture[row, column, 1]
                picture[row, column, 2] = blue * share + rest * picture[row, column, 2]
