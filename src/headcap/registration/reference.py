"""What every camera should see of the surface: one fixed reference for all frames, so that drift cannot add up."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera, Rig
from headcap.meshes.normals import triangle_normals
from headcap.registration.render import Projection, Source, project, visible_share
from headcap.registration.template import Template

DEPTH_JUMP_M = 4e-3
"""Neighbouring pixels whose depths differ more lie on either side of an occluding edge."""


LEAST_COSINE = 0.25
"""A photograph serves triangles that it sees less obliquely than this cosine."""


@dataclass(frozen=True)
class Reference:
    """The template at the reference frame and each camera's picture of it, at one image scale."""

    template: Template
    cameras: tuple[Camera, ...]
    sources: tuple[Source, ...]
    shown: NDArray[np.bool_]
    """(n,) vertices that some camera saw well."""


def build_reference(
    template: Template, rig: Rig, photographs: list[NDArray[np.float32] | None], *, own_photographs: bool, edge_margin_px: int
) -> Reference:
    """Tie each camera's first grey photograph (h, w) to the template at the reference frame (world, textured).

    A camera without one has None. Without `own_photographs` all cameras share the baked texture alone (equation 6 to the letter).
    """
    texture = None if template.texture is None else cv2.cvtColor(template.texture, cv2.COLOR_RGB2GRAY).astype(np.float32)
    sources, shown = [], np.zeros(len(template.vertices), bool)
    for camera, photograph in zip(rig, photographs, strict=True):
        projection = project(camera, template.vertices, template.triangles)
        well = _shown_well(camera, projection, template) & (photograph is not None)
        shown[template.triangles[well]] = True
        clear = np.zeros((camera.height, camera.width), np.bool_)
        clear[projection.window.slices] = _away_from_edges(projection, edge_margin_px)
        pixels = projection.pixels.astype(np.float32)
        sources.append(_source(template, texture, photograph, clear, well & own_photographs, pixels))
    return Reference(template, rig.cameras, tuple(sources), shown)


def scaled_reference(reference: Reference, width_px: int) -> Reference:
    """The same reference for images reduced to a shorter side of `width_px` (area averaging); larger ones only, 0 for none."""
    cameras, sources = [], []
    for camera, source in zip(reference.cameras, reference.sources, strict=True):
        factor = min(1.0, width_px / min(camera.size)) if width_px > 0 else 1.0
        cameras.append(camera.scaled(factor) if factor < 1 else camera)
        sources.append(_scaled_source(source, cameras[-1].size, factor) if factor < 1 else source)
    return replace(reference, cameras=tuple(cameras), sources=tuple(sources))


def _scaled_source(source: Source, size: tuple[int, int], factor: float) -> Source:
    pixels = ((source.photograph_pixels + 0.5) * factor - 0.5).astype(np.float32)
    clear = cv2.resize(source.photograph_clear.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.75
    photograph = source.photograph
    if photograph is not None:
        photograph = cv2.resize(photograph, size, interpolation=cv2.INTER_AREA)
    return replace(source, photograph=photograph, photograph_pixels=pixels, photograph_clear=clear)


def _source(template, texture, photograph, clear, serves, pixels) -> Source:
    if texture is None:
        return Source(photograph, pixels, clear, serves, None, None, None, None)
    height, width = texture.shape
    texels = (template.uv * (width, height) - 0.5).astype(np.float32)
    return Source(photograph, pixels, clear, serves, texture, texels, template.uv_triangles, template.texture_known)


def _shown_well(camera: Camera, projection: Projection, template: Template) -> NDArray[np.bool_]:
    local = projection.pixels - (projection.window.x0, projection.window.y0)
    share = visible_share(projection.raster, local, template.triangles)
    normal = triangle_normals(template.vertices, template.triangles)
    towards = camera.centre - template.vertices[template.triangles].mean(1)
    length = np.linalg.norm(normal, axis=1) * np.linalg.norm(towards, axis=1)
    cosine = np.einsum("nk,nk->n", normal, towards) / np.maximum(length, 1e-20)
    return (share > 0.5) & (cosine > LEAST_COSINE)


def _away_from_edges(projection: Projection, margin_px: int) -> NDArray[np.bool_]:
    """(h, w) of the window: seen, and not near a jump in depth, where the lens blur mixes two surfaces that move apart.

    Folds whose sides touch (closed lips, eyelids) stay: their dark line belongs to the skin on either side, and when they open
    the dark behind them continues it.
    """
    depth = np.where(projection.raster.hit, projection.raster.depth, np.float32(1e3))
    edge = np.zeros(depth.shape, np.uint8)
    for axis in range(2):
        jump = np.abs(np.diff(depth, axis=axis)) > DEPTH_JUMP_M
        for side in (slice(1, None), slice(None, -1)):
            view = edge[side] if axis == 0 else edge[:, side]
            view |= jump
    size = 2 * margin_px + 1
    return projection.raster.hit & (cv2.dilate(edge, np.ones((size, size), np.uint8)) == 0)
