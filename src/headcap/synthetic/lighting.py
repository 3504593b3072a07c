"""Soft light on a moving surface: per vertex, from soft lights with soft shadows and from all around."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.synthetic.settings import LightSettings

_MAP_CELLS = 192
_MAP_EXTENT_M = 0.46
_LIFT_M = 0.004
# exponential shadow maps (Annen et al. 2008): light dies away over 1 / sharpness behind an occluder
_SHARPNESS_PER_M = 170.0


@dataclass(frozen=True)
class Lights:
    """Lights ready for use: unit directions, linear RGB irradiance, softness."""

    directions: NDArray[np.float64]
    """(lights, 3) from the subject to the light."""
    colours: NDArray[np.float64]
    """(lights, 3)."""
    softness: NDArray[np.float64]
    """(lights,) sine of the half angle each light spans."""
    ambient: float
    gloss: float

    @classmethod
    def from_settings(cls, lights: tuple[LightSettings, ...], ambient: float, gloss: float) -> Lights:
        """Lights of a rehearsal."""
        directions = np.array([light.direction for light in lights], float).reshape(-1, 3)
        return cls(
            directions / np.linalg.norm(directions, axis=1, keepdims=True),
            np.array([np.array(light.colour) * light.intensity for light in lights]).reshape(-1, 3),
            np.sin(np.radians([light.spread_deg for light in lights])),
            ambient,
            gloss,
        )


def illuminate(
    lights: Lights, vertices_m: NDArray, normals: NDArray, openness: NDArray, occluder: NDArray, eye_m: NDArray
) -> NDArray[np.float32]:
    """Per vertex (n, 4): irradiance in linear RGB and the shine towards an eye at `eye_m`.

    `openness` (n,) is the share of the sky each vertex sees; `occluder` (m, 3) are the triangles that cast shadows.
    """
    light = np.repeat((lights.ambient * openness)[:, None], 4, axis=1)
    light[:, 3] = 0.0
    for direction, colour, softness in zip(lights.directions, lights.colours, lights.softness, strict=True):
        seen = visibility(vertices_m, normals, occluder, direction, blur_m=0.02 * softness)
        _add_light(light, vertices_m, normals, seen, direction, colour, softness, lights.gloss, np.asarray(eye_m, float))
    return light.astype(np.float32)


def openness(vertices_m: NDArray, normals: NDArray, occluder: NDArray, directions: int = 40) -> NDArray[np.float64]:
    """Share of the sky (n,) that each vertex sees, weighted by the cosine: ambient occlusion of the resting subject."""
    k = np.arange(directions) + 0.5
    height, turn = 1 - 2 * k / directions, np.pi * (1 + 5**0.5) * k  # Fibonacci points on the sphere
    across = np.sqrt(1 - height**2)
    total, weight = np.zeros(len(vertices_m)), np.zeros(len(vertices_m))
    for direction in np.stack([across * np.cos(turn), height, across * np.sin(turn)], axis=1):
        cosine = np.clip(normals @ direction, 0, None)
        total += cosine * visibility(vertices_m, normals, occluder, direction, blur_m=0.004)
        weight += cosine
    return total / weight


def visibility(vertices_m: NDArray, normals: NDArray, occluder: NDArray, direction: NDArray, *, blur_m: float) -> NDArray:
    """How much (n,), 0 to 1, of a distant light each vertex sees past the occluder."""
    helper = np.array([0.0, 1.0, 0.0]) if abs(direction[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    right = np.cross(helper, direction)
    right /= np.linalg.norm(right)
    frame = np.stack([right, np.cross(direction, right), direction])
    cell = _MAP_EXTENT_M / _MAP_CELLS
    cells, tested = np.empty(vertices_m.shape), np.empty(vertices_m.shape)
    _to_cells(np.asarray(vertices_m, float), np.asarray(normals, float), frame, cell, cells, tested)
    depth = np.full((_MAP_CELLS, _MAP_CELLS), -_MAP_EXTENT_M, np.float32)
    _fill_nearest(cells, occluder, depth)
    sigma = max(blur_m / cell, 0.8)
    exponential = cv2.GaussianBlur(np.exp(np.float32(_SHARPNESS_PER_M) * depth), (0, 0), sigma)
    return _look_up(exponential, tested)


@njit(cache=True)
def _to_cells(vertices, normals, frame, cell, cells, tested):
    """Column and row on the map and metres towards the light, of vertices and of what is tested in their place."""
    centre = np.empty(3)
    for axis in range(3):
        low = high = vertices[0, axis]
        for k in range(len(vertices)):
            low, high = min(low, vertices[k, axis]), max(high, vertices[k, axis])
        centre[axis] = 0.5 * (low + high)
    for k in range(len(vertices)):
        x, y, z = vertices[k, 0] - centre[0], vertices[k, 1] - centre[1], vertices[k, 2] - centre[2]
        # a vertex is tested a little outside its surface, lest the surface shade itself
        u, v, w = _LIFT_M * normals[k, 0], _LIFT_M * normals[k, 1], _LIFT_M * normals[k, 2]
        for axis in range(3):
            place = x * frame[axis, 0] + y * frame[axis, 1] + z * frame[axis, 2]
            lift = u * frame[axis, 0] + v * frame[axis, 1] + w * frame[axis, 2]
            cells[k, axis] = place / cell + _MAP_CELLS / 2 if axis < 2 else place
            tested[k, axis] = cells[k, axis] + (lift * (1 / cell) if axis < 2 else lift)


@njit(cache=True, error_model="numpy")
def _fill_nearest(cells, triangles, depth):
    size = depth.shape[0]
    for f in range(len(triangles)):
        a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        ax, ay, bx, by, cx, cy = cells[a, 0], cells[a, 1], cells[b, 0], cells[b, 1], cells[c, 0], cells[c, 1]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if area == 0.0:
            continue
        x0, x1 = max(0, int(np.ceil(min(ax, bx, cx)))), min(size - 1, int(np.floor(max(ax, bx, cx))))
        y0, y1 = max(0, int(np.ceil(min(ay, by, cy)))), min(size - 1, int(np.floor(max(ay, by, cy))))
        for y in range(y0, y1 + 1):
            for x in range(x0, x1 + 1):
                u = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
                v = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
                if u < 0.0 or v < 0.0 or u + v > 1.0:
                    continue
                z = u * cells[a, 2] + v * cells[b, 2] + (1 - u - v) * cells[c, 2]
                depth[y, x] = max(depth[y, x], z)


@njit(cache=True)
def _look_up(exponential, cells):
    out = np.ones(len(cells))
    size = exponential.shape[0]
    for k in range(len(cells)):
        x, y = cells[k, 0], cells[k, 1]
        i, j = int(np.floor(x)), int(np.floor(y))
        if i < 0 or j < 0 or i >= size - 1 or j >= size - 1:
            continue
        tx, ty = x - i, y - j
        top = exponential[j, i] * (1 - tx) + exponential[j, i + 1] * tx
        bottom = exponential[j + 1, i] * (1 - tx) + exponential[j + 1, i + 1] * tx
        nearest = top * (1 - ty) + bottom * ty
        out[k] = min(1.0, np.exp(_SHARPNESS_PER_M * cells[k, 2]) / nearest) if nearest > 0 else 1.0
    return out


@njit(cache=True)
def _add_light(light, vertices, normals, seen, direction, colour, softness, gloss, eye):
    for k in range(len(vertices)):
        cosine = normals[k, 0] * direction[0] + normals[k, 1] * direction[1] + normals[k, 2] * direction[2]
        # an area light sets behind the horizon gradually: a parabola joins darkness and the cosine
        if cosine <= -softness:
            continue
        lit = cosine if cosine >= softness else (cosine + softness) ** 2 / (4 * softness)
        lit *= seen[k]
        for channel in range(3):
            light[k, channel] += colour[channel] * lit
        if gloss > 0:
            vx, vy, vz = eye[0] - vertices[k, 0], eye[1] - vertices[k, 1], eye[2] - vertices[k, 2]
            scale = 1 / np.sqrt(vx * vx + vy * vy + vz * vz)
            hx, hy, hz = direction[0] + vx * scale, direction[1] + vy * scale, direction[2] + vz * scale
            half = (hx * normals[k, 0] + hy * normals[k, 1] + hz * normals[k, 2]) / np.sqrt(hx * hx + hy * hy + hz * hz + 1e-12)
            if half > 0:
                half *= half
                half *= half
                half *= half  # to the eighth, then the sixteenth
                light[k, 3] += gloss * colour[1] * lit * half * half
