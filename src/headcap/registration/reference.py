"""What every camera should see of the surface: one fixed reference for all frames, so that drift cannot add up."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera, Rig
from headcap.meshes.normals import triangle_normals
from headcap.registration.render import Picture, Projection, Source, project, visible_share
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
        well = shown_well(camera, projection, template.vertices, template.triangles) & (photograph is not None)
        shown[template.triangles[well]] = True
        clear = np.zeros((camera.height, camera.width), np.bool_)
        clear[projection.window.slices] = away_from_edges(projection, edge_margin_px)
        own = Picture(photograph, projection.pixels.astype(np.float32), clear, well) if own_photographs and well.any() else None
        sources.append(_source(template, texture, (own,) if own else ()))
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
    return replace(source, pictures=tuple(scaled_picture(picture, size, factor) for picture in source.pictures))


def scaled_picture(picture: Picture, size: tuple[int, int], factor: float) -> Picture:
    """The same picture reduced by `factor` to `size` (width, height)."""
    pixels = ((picture.pixels + 0.5) * factor - 0.5).astype(np.float32)
    clear = cv2.resize(picture.clear.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.75
    return Picture(cv2.resize(picture.image, size, interpolation=cv2.INTER_AREA), pixels, clear, picture.serves)


def _source(template, texture, pictures) -> Source:
    if texture is None:
        return Source(pictures, None, None, template.uv_triangles, None)
    height, width = texture.shape
    texels = (template.uv * (width, height) - 0.5).astype(np.float32)
    return Source(pictures, texture, texels, template.uv_triangles, template.texture_known)


def part_of(reference: Reference, chosen: NDArray[np.bool_]) -> tuple[Reference, NDArray[np.int64]]:
    """The reference of the triangles whose corners are all chosen (n,), and its vertices' indices (k,) in the whole."""
    template, kept, inside = reference.template.part(chosen)
    sources = tuple(
        replace(
            source,
            pictures=tuple(
                replace(picture, pixels=picture.pixels[kept], serves=picture.serves[inside]) for picture in source.pictures
            ),
            texture_triangles=source.texture_triangles[inside],
        )
        for source in reference.sources
    )
    return Reference(template, reference.cameras, sources, reference.shown[kept]), kept


def shown_well(camera: Camera, projection: Projection, vertices: NDArray, triangles: NDArray) -> NDArray[np.bool_]:
    """(m,) triangles that a camera sees free and not too obliquely."""
    local = projection.pixels - (projection.window.x0, projection.window.y0)
    share = visible_share(projection.raster, local, triangles)
    normal = triangle_normals(vertices, triangles)
    towards = camera.centre - vertices[triangles].mean(1)
    length = np.linalg.norm(normal, axis=1) * np.linalg.norm(towards, axis=1)
    cosine = np.einsum("nk,nk->n", normal, towards) / np.maximum(length, 1e-20)
    return (share > 0.5) & (cosine > LEAST_COSINE)


def away_from_edges(projection: Projection, margin_px: int) -> NDArray[np.bool_]:
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
