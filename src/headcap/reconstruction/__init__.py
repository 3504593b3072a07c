"""Depth maps (COLMAP on CUDA, own PatchMatch on CPU) and their fusion to points with normals and confidence."""

from headcap.reconstruction.points import PointCloud

__all__ = ["PointCloud"]
