"""Lenses a session file knows already."""

from collections.abc import Iterable, Mapping

import numpy as np

from headcap.calibration.detection import CameraDetections
from headcap.calibration.intrinsics import Lens


def known_lenses(intrinsics: Mapping[str, Mapping], detections: Iterable[CameraDetections]) -> dict[str, Lens]:
    """By camera name: `intrinsics` gives matrix (3, 3) and distortion (5,), the recordings give the image size."""
    return {
        seen.camera: Lens(
            seen.width,
            seen.height,
            np.array(intrinsics[seen.camera]["matrix"], float),
            np.array(intrinsics[seen.camera]["distortion"], float),
        )
        for seen in detections
        if seen.camera in intrinsics
    }
