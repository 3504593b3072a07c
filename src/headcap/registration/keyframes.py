"""Keyframes: later photographs that show what the reference frame hides.

Closed lips hide their inner rims, so nothing of them is in the reference texture: when the mouth opens they could only follow
their neighbours. The first frame in which the point cloud confirms a hidden strip next to known skin becomes a keyframe: its
photographs serve that strip from then on. A strip is tied once, close to texture that is already tracked, and never again, so
that errors of tying do not add up over a take. Only lips grow; teeth and tongue behind them move by themselves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial import cKDTree

from headcap.meshes.normals import triangle_normals
from headcap.reconstruction.points import PointCloud
from headcap.registration.motion import Motion
from headcap.registration.photographs import Photograph
from headcap.registration.reference import Reference, away_from_edges, scaled_picture, shown_well
from headcap.registration.render import Picture, project
from headcap.registration.template import Template


class KeyframeSettings(BaseModel):
    """When a frame becomes a keyframe, and which strip of the lips it serves."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    most: int = Field(8, ge=0, description="Most keyframes of a take; 0 keeps to the reference frame alone")
    least_area_mm2: float = Field(15.0, gt=0, description="Newly served lip that makes a keyframe, square millimetres")
    support_mm: float = Field(0.4, gt=0, description="A strip's cloud points lie this near to its triangles' planes, millimetres")
    reach_mm: float = Field(1.5, gt=0, description="And this near along them, millimetres")


@dataclass(frozen=True)
class Keyframe:
    """Where the surface lies in the photographs of a later frame, and what each of them serves."""

    time_s: float
    """The frame's common time."""
    pixels: NDArray[np.float32]
    """(cameras, n, 2) vertices in the photographs at full size; NaN for a camera without one."""
    serves: NDArray[np.bool_]
    """(cameras, m) triangles."""


def lip_triangles(template: Template) -> NDArray[np.bool_]:
    """(m,) triangles of the lips, outside and inside."""
    masks = [mask for name, mask in template.regions.items() if name.startswith("lips")]
    if not masks:
        return np.zeros(len(template.triangles), np.bool_)
    return np.any(masks, axis=0)[template.triangles].all(axis=1)


def newly_seen(reference: Reference, vertices: NDArray, cloud: PointCloud, settings: KeyframeSettings) -> NDArray[np.bool_]:
    """Lip triangles (m,) that no picture serves yet, that touch served ones and lie on the cloud.

    `vertices` (n, 3) are the mesh at the cloud's moment.
    """
    triangles = reference.template.triangles
    served = np.logical_or.reduce([source.served for source in reference.sources])
    known = np.zeros(len(vertices), np.bool_)
    known[triangles[served]] = True
    strip = lip_triangles(reference.template) & ~served & known[triangles].any(axis=1)
    chosen = np.flatnonzero(strip)
    strip[chosen] = _supported(vertices, triangles[chosen], cloud, settings)
    return strip


def area_mm2(vertices: NDArray, triangles: NDArray) -> float:
    """Area of triangles (k, 3) of a mesh (n, 3) in metres, square millimetres."""
    return 0.5e6 * float(np.linalg.norm(triangle_normals(vertices, triangles), axis=1).sum())


def find_keyframe(
    reference: Reference,
    time_s: float,
    vertices: NDArray,
    motion: Motion,
    photographs: list[Photograph],
    cloud: PointCloud,
    settings: KeyframeSettings,
) -> Keyframe | None:
    """A frame's full-size photographs as a keyframe, if they serve enough of the lips that nothing served before.

    `vertices` (n, 3) are the mesh at the frame's moment, `motion` leads to each photograph's.
    """
    triangles = reference.template.triangles
    strip = newly_seen(reference, vertices, cloud, settings)
    if area_mm2(vertices, triangles[strip]) < settings.least_area_mm2:
        return None
    offsets = motion.offsets([photograph.delay_s for photograph in photographs])
    keyframe = tie_keyframe(reference, time_s, vertices, offsets, photographs, strip)
    # a strip that cameras see at a slant alone would take a keyframe's place and give nothing for it
    served_mm2 = area_mm2(vertices, triangles[keyframe.serves.any(axis=0)])
    return keyframe if served_mm2 >= settings.least_area_mm2 else None


def tie_keyframe(
    reference: Reference,
    time_s: float,
    vertices: NDArray,
    offsets: list[NDArray],
    photographs: list[Photograph],
    strip: NDArray[np.bool_],
) -> Keyframe:
    """Tie a frame's full-size photographs to the mesh (n, 3) for a strip of triangles (m,).

    `offsets` (n, 3) move the mesh from the frame to each photograph's moment. A camera serves the triangles of the strip that it
    sees well, away from occluding edges.
    """
    triangles = reference.template.triangles
    pixels = np.full((len(reference.cameras), len(vertices), 2), np.nan, np.float32)
    serves = np.zeros((len(reference.cameras), len(triangles)), np.bool_)
    for photograph, offset in zip(photographs, offsets, strict=True):
        c = photograph.camera
        moved = vertices + offset
        projection = project(reference.cameras[c], moved, triangles)
        pixels[c] = projection.pixels
        serves[c] = strip & ~reference.sources[c].served & shown_well(reference.cameras[c], projection, moved, triangles)
        serves[c] &= _share(projection.raster.triangle, away_from_edges(projection, 1), len(triangles)) > 0.5
    return Keyframe(time_s, pixels, serves)


def with_keyframe(reference: Reference, keyframe: Keyframe, photographs: list[Photograph]) -> Reference:
    """The reference with a keyframe's full-size photographs beside its first ones, at the reference's own scale."""
    sources = list(reference.sources)
    for photograph in photographs:
        c = photograph.camera
        if keyframe.serves[c].any():
            clear = np.ones(photograph.image.shape, np.bool_)
            own = Picture(photograph.image, keyframe.pixels[c], clear, keyframe.serves[c])
            factor = min(reference.cameras[c].size) / min(photograph.image.shape)
            if factor < 1:
                own = scaled_picture(own, reference.cameras[c].size, factor)
            sources[c] = replace(sources[c], pictures=(*sources[c].pictures, own))
    return replace(reference, sources=tuple(sources))


def _supported(vertices: NDArray, triangles: NDArray, cloud: PointCloud, settings: KeyframeSettings) -> NDArray[np.bool_]:
    """(k,) triangles with a cloud point of like normal on them."""
    if len(triangles) == 0 or len(cloud) == 0:
        return np.zeros(len(triangles), np.bool_)
    centres, normals = vertices[triangles].mean(axis=1), triangle_normals(vertices, triangles)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
    reach_m = 1e-3 * settings.reach_mm
    near = ((cloud.positions > centres.min(0) - reach_m) & (cloud.positions < centres.max(0) + reach_m)).all(axis=1)
    if not near.any():
        return np.zeros(len(triangles), np.bool_)
    positions, directions = cloud.positions[near], cloud.normals[near]
    distance, nearest = cKDTree(positions).query(centres, distance_upper_bound=reach_m)
    found = np.isfinite(distance)
    nearest = np.where(found, nearest, 0)
    along = np.abs(np.einsum("ki,ki->k", positions[nearest] - centres, normals))
    alike = np.einsum("ki,ki->k", directions[nearest], normals) > 0.7
    return found & alike & (along < 1e-3 * settings.support_mm)


def _share(triangle_of_pixel: NDArray, chosen: NDArray[np.bool_], count: int) -> NDArray[np.float64]:
    """(m,) share of each triangle's pixels that are chosen."""
    seen = triangle_of_pixel >= 0
    all_pixels = np.bincount(triangle_of_pixel[seen], minlength=count)
    return np.bincount(triangle_of_pixel[seen & chosen], minlength=count) / np.maximum(all_pixels, 1)
