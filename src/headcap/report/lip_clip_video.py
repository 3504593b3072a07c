"""A video's lips over its own pictures: as the base tracker has them, corrected, and the contours that were found.

Images are (height, width, 3) uint8 RGB.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.lips.clips import Clip
from headcap.lips.features import LipContours
from headcap.lips.kit import CorrectedClip
from headcap.lips.mesh_contours import MeshContours
from headcap.recordings.audio import read_audio
from headcap.recordings.writer import write_video
from headcap.report.figures import Image
from headcap.report.lips_pictures import captioned, even_sided, mouth_places
from headcap.report.overlays import box_of, crop, draw_mesh, side_by_side, viewport

OUTER, INNER = (255, 196, 0), (0, 224, 255)
"""Colours of contours."""
_HEIGHT_PX = 264
_MARGIN, _OPACITY = 0.3, 0.45
_STILL_HZ = 25.0
"""Of a clip of one frame."""
_CRF = 24.0
_SOUND_HZ = 48_000


@dataclass(frozen=True, eq=False)
class LipOverlay:
    """Draws one clip's frames, cut to the mouth."""

    camera: Camera
    view: Camera
    """What the cut shows."""
    box: tuple[float, float, float, float]
    see: MeshContours
    triangles: NDArray[np.int32]

    @classmethod
    def of(cls, corrected: CorrectedClip, camera: Camera, height: int = _HEIGHT_PX) -> LipOverlay:
        """Of a corrected clip as its camera sees it. Raises `InputError` where no frame of the base tracker's has an answer."""
        take = corrected.take
        model, mouth = take.space.model, take.space.mouth
        about = mouth_places(take.base.world(take.base.meshes), mouth.vertices)
        box = box_of(camera, about, margin=_MARGIN, aspect=1.0)
        see = MeshContours.of(np.asarray(model.vertices, float), mouth, model.regions)
        return cls(camera, viewport(camera, box, height), box, see, model.triangles)

    def __call__(self, picture: Image, base: NDArray, corrected: NDArray, found: LipContours | None) -> Image:
        """Base tracker, corrected, picture, picture with the found contours; meshes (n, 3), NaN without an answer."""
        plain = crop(picture, self.box, self.view.size)
        panels = [
            self._shown(plain, base, "base tracker"),
            self._shown(plain, corrected, "corrected"),
            captioned(plain, "picture", known=True),
            captioned(plain if found is None else self.lined(plain, found), "contours found", known=found is not None),
        ]
        return side_by_side(panels)

    def lined(self, image: Image, contours: LipContours) -> Image:
        """Contours of the camera's picture drawn into the cut."""
        out, (left, top) = image.copy(), self.box[:2]
        scale = self.view.height / (self.box[3] - self.box[1])
        for ring, colour in ((contours.outer, OUTER), (contours.inner, INNER)):
            # as `viewport` has it: integer coordinates are pixel centres in both pictures
            placed = (ring - (left, top)) * scale - 0.5
            cv2.polylines(out, [np.rint(placed * 16).astype(np.int32)], True, colour, 1, cv2.LINE_AA, shift=4)
        return out

    def _shown(self, plain: Image, mesh: NDArray, told: str) -> Image:
        """The cut with a mesh and its contours over it."""
        mesh = np.asarray(mesh, float)
        if not np.isfinite(mesh).all():
            return captioned(plain, told, known=False)
        drawn = draw_mesh(plain, self.view, mesh, self.triangles, opacity=_OPACITY)
        return captioned(self.lined(drawn, self.see(mesh, self.camera)), told, known=True)


def overlay_frames(clip: Clip, corrected: CorrectedClip) -> Iterator[Image]:
    """Each frame of a clip, seen by the camera that tracked it, as `LipOverlay` draws it."""
    draw, base = LipOverlay.of(corrected, clip.camera), corrected.take.base
    found = corrected.contours.contours()
    for frame, picture in enumerate(clip.pictures()):
        placed = base.world_from_canonical[frame]
        mesh = base.meshes[frame] @ placed[:3, :3].T + placed[:3, 3]
        yield draw(np.ascontiguousarray(picture[..., ::-1]), mesh, corrected.meshes[frame], found[frame])


def write_overlay(path: Path | str, clip: Clip, corrected: CorrectedClip, video: Path | None = None) -> None:
    """Write `overlay_frames` as mp4 (H.264, which every browser plays), each at its own moment, with the sound of `video`.

    A video without sound gives none.
    """
    rate_hz = float(1 / np.median(np.diff(clip.time_s))) if len(clip) > 1 else _STILL_HZ
    slots = np.rint((clip.time_s - clip.time_s[0]) * rate_hz).astype(int)
    # frames closer than the usual interval are shown one after the other all the same
    slots = np.maximum.accumulate(slots - np.arange(len(slots))) + np.arange(len(slots))
    frames = (even_sided(image) for image in overlay_frames(clip, corrected))
    first = next(frames)
    size = first.shape[1], first.shape[0]

    def numbered() -> Iterator[tuple[int, Image]]:
        """Every frame with its slot."""
        yield int(slots[0]), first
        yield from zip(slots[1:].tolist(), frames, strict=True)

    sound = None if video is None else sound_of_frames(video, clip.time_s)
    write_video(path, numbered(), size, rate_hz, crf=_CRF, sound=sound, sound_rate_hz=_SOUND_HZ)


def sound_of_frames(video: Path | str, time_s: NDArray) -> NDArray[np.float32] | None:
    """Samples (n,) at 48 kHz from the first of frames at `time_s` (f,) to the last, silence where there are none.

    None for a video without sound, or with sound that does not decode.
    """
    try:
        samples, rate_hz, start_s = read_audio(video, _SOUND_HZ)
    except InputError:
        return None
    skipped = round((time_s[0] - start_s) * rate_hz)
    samples = samples[skipped:] if skipped >= 0 else np.pad(samples, (-skipped, 0))
    wanted = round((time_s[-1] - time_s[0]) * rate_hz) + 1
    return np.pad(samples[:wanted], (0, max(0, wanted - len(samples))))
