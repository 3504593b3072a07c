"""What a camera tells about the texels of the region on a mesh."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.lips.inpainting.region import LipRegion
from headcap.meshes.normals import vertex_normals
from headcap.meshes.rasteriser import rasterise
from headcap.registration.flow import sample

LEAST_COSINE = 0.2
_MARGIN_PX = 4
_BEHIND_M, _BEFORE_M = 0.0007, 0.003
"""A texel so far behind the nearest surface is hidden; one so far before what its neighbours see lies at a silhouette, where a
pixel mixes two surfaces."""


@dataclass(frozen=True, eq=False)
class TexelView:
    """Colours of texels as one camera saw them."""

    colours: NDArray[np.float64]
    """(t, 3) of the picture's channels, 0 to 255; 0 where not seen."""
    weight: NDArray[np.float64]
    """(t,) square of the cosine between normal and line of sight; 0 where not seen."""


def window(camera: Camera, points: NDArray) -> tuple[int, int, int, int]:
    """Columns and rows x0, y0, x1, y1 (one past the last) of a picture that hold the projections of points (n, 3)."""
    pixels = camera.project(points)[0]
    pixels = pixels[np.isfinite(pixels).all(axis=1)]
    if len(pixels) == 0:
        return 0, 0, 0, 0
    low = np.clip(np.floor(pixels.min(axis=0)) - _MARGIN_PX, 0, camera.size).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=0)) + _MARGIN_PX + 1, low, camera.size).astype(int)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def cropped(camera: Camera, box: tuple[int, int, int, int], factor: int = 1) -> Camera:
    """The camera of a part of its picture, enlarged: samples of a pixel lie evenly about its centre."""
    x0, y0, x1, y1 = box
    matrix = camera.matrix.copy()
    matrix[:2, 2] -= [x0, y0]
    part = replace(camera, width=x1 - x0, height=y1 - y0, matrix=matrix)
    return part.scaled(factor) if factor != 1 else part


def view_texels(region: LipRegion, camera: Camera, mesh: NDArray, picture: NDArray[np.uint8]) -> TexelView:
    """Texels on a mesh (n, 3) in a picture (height, width, 3); seen where nothing is before them and no silhouette is near."""
    mesh = np.asarray(mesh, float)
    unseen = TexelView(np.zeros((len(region.texel), 3)), np.zeros(len(region.texel)))
    box = window(camera, mesh[region.vertices])
    if box[2] <= box[0] or box[3] <= box[1]:
        return unseen
    part = cropped(camera, box)
    points = region.at_texels(mesh)
    pixels, depth = part.project(points)
    inside = np.isfinite(pixels).all(axis=1) & (pixels > -0.5).all(axis=1) & (pixels < np.array(part.size) - 0.5).all(axis=1)
    cosine = _cosines(region, mesh, points, camera.centre)
    candidates = np.flatnonzero(inside & (cosine > LEAST_COSINE))
    seen = candidates[_in_front(part, mesh, region.triangles, pixels[candidates], depth[candidates], cosine[candidates])]
    x0, y0, x1, y1 = box
    found = sample(picture[y0:y1, x0:x1].astype(np.float32), pixels[seen])
    known = np.isfinite(found).all(axis=1)
    unseen.colours[seen[known]] = found[known]
    unseen.weight[seen[known]] = cosine[seen[known]] ** 2
    return unseen


def _cosines(region: LipRegion, mesh: NDArray, points: NDArray, eye: NDArray) -> NDArray[np.float64]:
    normal = region.at_texels(vertex_normals(mesh, region.triangles))
    towards = eye - points
    length = np.linalg.norm(normal, axis=1) * np.linalg.norm(towards, axis=1)
    return np.einsum("tk,tk->t", normal, towards) / np.maximum(length, 1e-20)


def _in_front(part: Camera, mesh: NDArray, triangles: NDArray, pixels: NDArray, depth: NDArray, cosine: NDArray) -> NDArray:
    """(c,) texels that nothing hides and that lie off silhouettes."""
    surface = rasterise(part, mesh, triangles).depth
    around = np.ones((3, 3), np.uint8)
    nearest, farthest = cv2.erode(surface, around), cv2.dilate(surface, around)
    column, row = np.clip(np.rint(pixels).astype(int), 0, np.array(part.size) - 1).T
    # a slanted surface itself spans so much depth within the pixels looked at
    slant = 2 * depth / part.matrix[0, 0] * np.sqrt(1 - np.minimum(cosine, 1) ** 2) / cosine
    return (depth < nearest[row, column] + _BEHIND_M + slant) & (farthest[row, column] < depth + _BEFORE_M + slant)
