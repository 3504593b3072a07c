"""The template's texture from all cameras at the first frame, weighted as in section 4.2."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera, Rig
from headcap.meshes.normals import triangle_normals
from headcap.meshes.rasteriser import Raster, rasterise_pixels
from headcap.registration.flow import sample
from headcap.registration.render import project, visible_share
from headcap.registration.template import Template

LEAST_COSINE = 0.15
GAIN_SAMPLES = 20_000
GAIN_ROUNDS = 10
GUTTER_TEXELS = 4


def bake_from_cameras(template: Template, rig: Rig, images: list[NDArray[np.uint8] | None], size_px: int) -> Template:
    """Texture (size_px, size_px) of a template in the world from BGR photographs (h, w, 3) of one moment.

    Each texel is the mean of the cameras that see it, weighted by the dot product of viewing direction and normal; visibility
    comes from the z-buffer, per-channel gains make the cameras agree. Where no camera sees the surface an earlier texture
    (the scan's) stays, brought to the cameras' gain. A camera without a photograph has None.
    """
    texels = _texels(template, size_px)
    views = [_view(template, camera, image) for camera, image in zip(rig, images, strict=True) if image is not None]
    gains = _gains(texels, views)
    total, weights = np.zeros((len(texels.triangle), 3)), np.zeros(len(texels.triangle))
    for view, gain in zip(views, gains, strict=True):
        weight, colour = _contribution(texels, view)
        seen = weight > 0
        total[seen] += weight[seen, None] * gain * colour[seen]
        weights[seen] += weight[seen]
    colours = total / np.maximum(weights, 1e-9)[:, None]
    texture = np.zeros((size_px, size_px, 3))
    known = np.zeros((size_px, size_px), bool)
    texture[texels.row, texels.column], known[texels.row, texels.column] = colours[:, ::-1], weights > 0
    texture, known = _keep_earlier(template, texture, known)
    return template.with_texture(_fill_gutter(texture, known), known)


@dataclass(frozen=True)
class _Texels:
    row: NDArray
    column: NDArray
    triangle: NDArray
    position: NDArray


@dataclass(frozen=True)
class _View:
    camera: Camera
    image: NDArray
    visible: NDArray
    cosine: NDArray


def _texels(template: Template, size_px: int) -> _Texels:
    raster = rasterise_texture(template, size_px)
    row, column = np.nonzero(raster.hit)
    triangle = raster.triangle[row, column]
    corners = template.vertices[template.triangles[triangle]]
    return _Texels(row, column, triangle, np.einsum("nc,nci->ni", raster.barycentric[row, column], corners))


def rasterise_texture(template: Template, size_px: int) -> Raster:
    """The texture plane (size_px, size_px) with the triangle and barycentrics of each texel's centre."""
    pixels = template.uv * size_px - 0.5
    return rasterise_pixels(pixels, np.ones(len(pixels)), template.uv_triangles, (size_px, size_px))


def _view(template: Template, camera: Camera, image: NDArray) -> _View:
    projection = project(camera, template.vertices, template.triangles)
    local = projection.pixels - (projection.window.x0, projection.window.y0)
    visible = visible_share(projection.raster, local, template.triangles) > 0.5
    normal = triangle_normals(template.vertices, template.triangles)
    towards = camera.centre - template.vertices[template.triangles].mean(1)
    length = np.linalg.norm(normal, axis=1) * np.linalg.norm(towards, axis=1)
    cosine = np.einsum("nk,nk->n", normal, towards) / np.maximum(length, 1e-20)
    return _View(camera, image.astype(np.float32), visible & (cosine > LEAST_COSINE), cosine)


def _contribution(texels: _Texels, view: _View, chosen: NDArray | slice = slice(None)) -> tuple[NDArray, NDArray]:
    """Weight (n,) and BGR colour (n, 3) that one view gives to texels."""
    triangle = texels.triangle[chosen]
    weight = np.where(view.visible[triangle], view.cosine[triangle], 0.0)
    colour = np.zeros((len(triangle), 3))
    seen = np.flatnonzero(weight > 0)
    found = sample(view.image, view.camera.project(texels.position[chosen][seen])[0])
    inside = np.isfinite(found).all(1)
    colour[seen] = np.where(inside[:, None], found, 0.0)
    weight[seen[~inside]] = 0.0
    return weight, colour


def _gains(texels: _Texels, views: list[_View]) -> NDArray:
    """(c, 3) gains per camera and channel that make the cameras agree where they see the same texels; their mean log is zero."""
    chosen = np.linspace(0, len(texels.triangle) - 1, min(GAIN_SAMPLES, len(texels.triangle))).astype(int)
    parts = [_contribution(texels, view, chosen) for view in views]
    weight = np.stack([part[0] for part in parts])[..., None]
    logs = np.log(np.maximum(np.stack([part[1] for part in parts]), 1.0))
    gains = np.zeros((len(views), 1, 3))
    for _ in range(GAIN_ROUNDS):
        consensus = (weight * (logs + gains)).sum(0) / np.maximum(weight.sum(0), 1e-9)
        gains = (weight * (consensus - logs)).sum(1, keepdims=True) / np.maximum(weight.sum(1, keepdims=True), 1e-9)
        gains -= gains.mean(0)
    return np.exp(gains[:, 0])


def _keep_earlier(template: Template, texture: NDArray, known: NDArray) -> tuple[NDArray, NDArray]:
    """Fill what no camera sees from the template's own texture, at a gain that fits where both are known."""
    if template.texture is None or template.texture_known is None:
        return texture, known
    size = known.shape[::-1]
    earlier = cv2.resize(template.texture, size, interpolation=cv2.INTER_AREA).astype(float)
    there = cv2.resize(template.texture_known.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST).astype(bool)
    both = there & known
    gain = np.median(texture[both], axis=0) / np.maximum(np.median(earlier[both], axis=0), 1.0) if both.any() else np.ones(3)
    only = there & ~known
    texture[only] = earlier[only] * gain
    return texture, known | there


def _fill_gutter(texture: NDArray, known: NDArray) -> NDArray[np.uint8]:
    """Carry colours a few texels over the borders of charts, so that interpolation there meets no black."""
    colour, inside = texture.astype(np.float32) * known[..., None], known.astype(np.float32)
    for _ in range(GUTTER_TEXELS):
        spread, share = cv2.boxFilter(colour, -1, (3, 3), normalize=False), cv2.boxFilter(inside, -1, (3, 3), normalize=False)
        new = (inside == 0) & (share > 0)
        colour[new] = spread[new] / share[new, None]
        inside[new] = 1.0
    return np.clip(np.rint(colour), 0, 255).astype(np.uint8)
