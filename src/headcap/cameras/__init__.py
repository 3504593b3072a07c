"""Lens models, projection with Jacobians, undistortion, the rig; readers and writers of other tools' calibrations.

Convention: integer pixel (0, 0) is the centre of the top-left pixel (OpenCV); camera axes x right, y down, z forward;
distortion is OpenCV's (k1, k2, p1, p2, k3).
"""

from headcap.cameras.camera import Camera, Rig

__all__ = ["Camera", "Rig"]
