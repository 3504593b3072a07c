"""One frame of a rig to a point cloud, with whichever engine this machine has."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Rig
from headcap.errors import InputError
from headcap.reconstruction.colmap_engine import estimate_maps_colmap, fuse_colmap, has_cuda
from headcap.reconstruction.estimate import Mesh, estimate_maps
from headcap.reconstruction.fusion import fuse
from headcap.reconstruction.points import PointCloud
from headcap.reconstruction.settings import ReconstructSettings


def reconstruct_frame(
    rig: Rig,
    images_bgr: list[NDArray[np.uint8]],
    *,
    time_s: float,
    settings: ReconstructSettings | None = None,
    prior: Mesh | None = None,
    masks: list[NDArray] | None = None,
) -> PointCloud:
    """Points on the subject at one moment, from one photograph per camera of that moment.

    `images_bgr`: per camera (height, width, 3) uint8 as recorded, in the rig's order; `time_s` is written into the cloud.
    `prior`: a mesh (vertices, triangles) near the surface; `masks`: per camera (height, width), true on the subject.
    Raises `InputError` for fewer than three cameras, wrong sizes, or where no point is found.
    """
    settings = settings or ReconstructSettings()
    if settings.engine == "colmap" or (settings.engine == "auto" and has_cuda()):
        maps, cell_px = estimate_maps_colmap(rig, images_bgr, settings=settings, masks=masks), 1
    else:
        maps, cell_px = estimate_maps(rig, images_bgr, settings=settings, prior=prior, masks=masks), settings.matching.cell_px
    if settings.fusion_engine == "colmap":
        cloud = fuse_colmap(maps, time_s=time_s, settings=settings)
    else:
        cloud = fuse(maps, time_s=time_s, settings=settings.fusion, cell_px=cell_px)
    if not len(cloud):
        raise InputError(
            f"no point at {time_s:.3f} s",
            expected="views that agree on a surface",
            remedy="Check the calibration, the time offsets and the exposure of the recordings.",
        )
    return cloud
