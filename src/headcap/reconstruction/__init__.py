"""Depth maps (COLMAP on CUDA, own PatchMatch on CPU) and their fusion to points with normals and confidence.

The way in is `headcap.reconstruction.frame.reconstruct_frame`; only the light type is imported here.
"""

from headcap.reconstruction.points import PointCloud

__all__ = ["PointCloud"]
