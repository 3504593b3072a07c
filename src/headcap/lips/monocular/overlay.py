"""What the tracker believes, drawn over the picture: for the eye to judge."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.lips.monocular.surface import Estimate, FaceSurface
from headcap.meshes.rasteriser import rasterise

_LAMP = np.array([0.3, -0.4, -0.87])
"""Towards the lamp, in the camera's axes: over the photographer's right shoulder."""
_AMBIENT = 0.25


def draw_face(
    picture: NDArray[np.uint8], surface: FaceSurface, camera: Camera, estimate: Estimate, share: float = 0.5
) -> NDArray[np.uint8]:
    """The picture (height, width, 3) with the grey, shaded face over it by a share; lips in red, seen through the eyes."""
    vertices = surface.in_camera(estimate)
    raster = rasterise(estimate.camera(camera), vertices, surface.triangles, cull_back_faces=True)
    bright = _AMBIENT + (1 - _AMBIENT) * np.clip(surface.normals(vertices) @ _LAMP, 0, 1)
    colours = np.repeat(bright[:, None], 3, axis=1)
    for name, mask in surface.model.regions.items():
        if name.startswith("lips"):
            colours[mask[surface.vertices]] *= [0.5, 0.5, 1.2]
    drawn = raster.interpolate(surface.triangles, 255.0 * np.clip(colours, 0, 1))
    blind = surface.blind[surface.triangles].all(axis=1)
    here = raster.hit & ~blind[raster.triangle]
    out = picture.astype(float)
    out[here] += share * (drawn[here] - out[here])
    return np.rint(out).astype(np.uint8)
