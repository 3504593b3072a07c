"""How many cameras see a surface point: in front of the z-buffer and not too far from head-on."""

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera, Rig
from headcap.meshes.rasteriser import rasterise

# A pixel's depth belongs to its centre: a point up to 0.7 px away differs by the slope of the surface times that, to
# which a skin-thin margin is added for the step between the flat triangle and the point.
_PIXEL_REACH = 0.75
_MARGIN_M = 3e-4


def count_cameras(
    rig: Rig, vertices: NDArray, triangles: NDArray, points: NDArray, normals: NDArray, *, max_angle_deg: float
) -> NDArray[np.int64]:
    """Cameras (n,) that see each surface point (n, 3) with outward normal (n, 3) of a mesh (v, 3), (m, 3).

    A camera sees a point inside its image, no deeper than its z-buffer, whose normal is within `max_angle_deg` of the
    direction to the camera.
    """
    return sum((_seen(camera, vertices, triangles, points, normals, max_angle_deg) for camera in rig), np.zeros(len(points), int))


def _seen(
    camera: Camera, vertices: NDArray, triangles: NDArray, points: NDArray, normals: NDArray, max_angle_deg: float
) -> NDArray[np.bool_]:
    towards = camera.centre - points
    cosine = np.einsum("nk,nk->n", towards, normals) / np.linalg.norm(towards, axis=1)
    facing = np.flatnonzero(cosine >= np.cos(np.radians(max_angle_deg)))
    pixels, depth = camera.project(points[facing])
    column, row = np.rint(np.nan_to_num(pixels, nan=-9.0)).astype(np.int64).T
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    facing, column, row, depth = facing[inside], column[inside], row[inside], depth[inside]
    seen = np.zeros(len(points), bool)
    if len(facing):
        slope = np.sqrt(1 - np.clip(cosine[facing], 0, 1) ** 2) / np.maximum(cosine[facing], 1e-3)
        reach = _MARGIN_M + _PIXEL_REACH * slope * depth / camera.matrix[0, 0]
        # a surface hides what lies behind it with its front: its back is seen only through the holes of an open mesh
        seen[facing] = depth <= rasterise(camera, vertices, triangles, cull_back_faces=True).depth[row, column] + reach
    return seen
