"""Grey photographs of all cameras around one moment, each with its own time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera, Rig
from headcap.registration.local_contrast import grey


class FrameSource(Protocol):
    """What the tracker asks of a take's frames (`headcap.recordings.frames.TakeFrames`)."""

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names of the cameras that recorded the take."""

    def nearest(self, camera: str, time_s: float) -> tuple[NDArray[np.uint8], float]:
        """The photograph nearest to a moment, and its common time."""


@dataclass(frozen=True)
class Photograph:
    """One camera's grey picture, and when it was taken relative to the frame."""

    camera: int
    """Index in the rig."""
    image: NDArray[np.float32]
    """(h, w)"""
    delay_s: float
    """Photograph's common time minus the frame's."""


def take_photographs(frames: FrameSource, rig: Rig, time_s: float, *, gap_s: float, smoothing_px: float) -> list[Photograph]:
    """The cameras' photographs nearest to a moment; a camera without one within `gap_s` is left out."""
    recorded, found = set(frames.cameras), []
    for c, camera in enumerate(rig):
        if camera.name not in recorded:
            continue
        image, taken_s = frames.nearest(camera.name, time_s)
        if abs(taken_s - time_s) <= gap_s:
            found.append(Photograph(c, grey(image, sigma_px=smoothing_px), taken_s - time_s))
    return found


def resize(photographs: Sequence[Photograph], cameras: Sequence[Camera]) -> list[Photograph]:
    """The same photographs at the sizes of scaled cameras (area averaging)."""
    out = []
    for photograph in photographs:
        size = cameras[photograph.camera].size
        image = photograph.image
        if image.shape != size[::-1]:
            image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        out.append(Photograph(photograph.camera, image, photograph.delay_s))
    return out
