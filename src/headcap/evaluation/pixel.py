"""How much skin a pixel covers: what the reachable accuracy of a rig hangs on."""

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera, Rig
from headcap.meshes.normals import vertex_normals
from headcap.registration.template import Template


def pixel_on_skin_mm(rig: Rig, template: Template) -> float:
    """`rig.pixel_mm`: edge of a pixel on the face, mm; median over cameras of depth over focal length there.

    `template` stands in the world of `rig`. Of its face (all of it where it names no such region) each camera counts what
    is turned towards it and lies in its image; a camera that sees nothing of it does not count. NaN where none does.
    """
    normals = vertex_normals(template.vertices, template.triangles)
    face = template.regions.get("face", np.ones(len(normals), bool))
    pixels_mm = [_pixel_mm(camera, template.vertices[face], normals[face]) for camera in rig]
    seen = [pixel_mm for pixel_mm in pixels_mm if np.isfinite(pixel_mm)]
    return float(np.median(seen)) if seen else float("nan")


def _pixel_mm(camera: Camera, points: NDArray, normals: NDArray) -> float:
    pixels, depth_m = camera.project(points)
    inside = ((pixels > -0.5) & (pixels < np.array(camera.size) - 0.5)).all(axis=1)
    seen = inside & (np.einsum("nk,nk->n", camera.centre - points, normals) > 0)
    focal_px = np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1])
    return 1e3 * float(np.median(depth_m[seen])) / focal_px if seen.any() else float("nan")
