"""What some formats cannot hold, refused by name."""

import numpy as np

from headcap.cameras import Rig
from headcap.errors import InputError


def require_no_k3(rig: Rig, format_name: str) -> None:
    """Raise `InputError` if a camera has a sixth-order radial term, which four-parameter formats would lose."""
    lost = [camera.name for camera in rig if abs(camera.distortion[4]) > 1e-12]
    if lost:
        raise InputError(
            f"{', '.join(lost)}: k3 is not zero",
            expected=f"k1, k2, p1, p2 alone, which is all that {format_name} holds",
            remedy="Write another format, or calibrate without k3.",
        )


def require_no_skew(rig: Rig, format_name: str) -> None:
    """Raise `InputError` if a camera matrix has skew, for formats of fx, fy, cx, cy."""
    lost = [camera.name for camera in rig if abs(camera.matrix[0, 1]) > 1e-9]
    if lost:
        raise InputError(
            f"{', '.join(lost)}: skewed pixels",
            expected=f"fx, fy, cx, cy, which is all that {format_name} holds",
            remedy="Write opencv_yaml, or calibrate without skew.",
        )


def five(distortion: object) -> np.ndarray:
    """Up to five OpenCV coefficients, padded with zeros; more that are not zero are refused."""
    values = np.ravel(np.asarray(distortion, float))
    if len(values) > 5 and np.abs(values[5:]).max() > 0:
        raise InputError(
            f"{len(values)} distortion coefficients",
            expected="k1, k2, p1, p2, k3",
            remedy="Calibrate with the five-parameter model.",
        )
    return np.pad(values[:5], (0, max(0, 5 - len(values))))


def pinhole(fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    """(3, 3) camera matrix."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
