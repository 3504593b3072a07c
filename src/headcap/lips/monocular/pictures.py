"""Pictures as the tracker wants them: linear light, at the resolutions the mesh can show."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.lips.monocular.photometric import Level
from headcap.lips.monocular.surface import Estimate, FaceSurface

_CODES = np.arange(256) / 255.0
_LINEAR = np.where(_CODES <= 0.04045, _CODES / 12.92, ((_CODES + 0.055) / 1.055) ** 2.4).astype(np.float32)
_LEAST_SIDE_PX = 24
USUAL_FOCAL_RATIO = 1.3
"""Focal length over the longer side of a picture of which nothing is known: between a telephone's and a portrait lens."""


def unknown_camera(width: int, height: int) -> Camera:
    """A pinhole camera for a picture of unknown lens, to start the estimate of the focal length from."""
    focal = USUAL_FOCAL_RATIO * max(width, height)
    matrix = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    return Camera("unknown", width, height, matrix, np.zeros(5), np.eye(4))


def linear_light(picture: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Linear intensities 0 to 1 of an sRGB-encoded picture (height, width, 3) uint8 (IEC 61966-2-1)."""
    return _LINEAR[picture]


def finest_share(surface: FaceSurface, camera: Camera, estimate: Estimate, edge_px: float) -> float:
    """The share of full resolution at which the median edge of the skin in view is `edge_px` long, at most 1."""
    vertices = surface.in_camera(estimate)
    pixels = estimate.camera(camera).project(vertices)[0]
    facing = surface.normals(vertices)[:, 2] < -0.3
    triangles = surface.triangles[facing[surface.triangles].all(axis=1)]
    length = np.linalg.norm(pixels[triangles[:, 0]] - pixels[triangles[:, 1]], axis=1)
    return float(min(1.0, edge_px / max(np.median(length), 1e-9))) if len(triangles) else 1.0


def cameras_of_levels(camera: Camera, finest: float, count: int) -> list[Camera]:
    """The camera, in its own axes, at the finest share of its resolution and at halves of it, `count` at most."""
    out = []
    for k in range(count):
        share = finest * 0.5**k
        size = round(camera.width * share), round(camera.height * share)
        if out and min(size) < _LEAST_SIDE_PX:
            break
        out.append(resized(camera, *size))
    return out


def resized(camera: Camera, width: int, height: int) -> Camera:
    """The camera of the picture resized to (width, height), in its own axes: outer borders of pixels coincide."""
    matrix = camera.matrix.copy()
    ratio = np.array([width / camera.width, height / camera.height])
    matrix[[0, 1], [0, 1]] *= ratio
    matrix[:2, 2] = (matrix[:2, 2] + 0.5) * ratio - 0.5
    return replace(camera, width=width, height=height, matrix=matrix, camera_from_world=np.eye(4))


def levels_of(picture: NDArray[np.uint8], cameras: list[Camera]) -> list[Level]:
    """A picture (height, width, 3) uint8 at each camera's resolution, linear, finest first."""
    out, finer = [], linear_light(picture)
    for camera in cameras:
        if finer.shape[1::-1] != camera.size:
            finer = cv2.resize(finer, camera.size, interpolation=cv2.INTER_AREA)
        out.append(Level.of(camera, cv2.GaussianBlur(finer, (0, 0), 0.6)))
    return out
