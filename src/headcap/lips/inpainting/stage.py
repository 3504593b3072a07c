"""A tattooed take of a rig, as one camera recorded it, to a recording of bare lips (section 3.2.1).

Tattoos bias what one camera tells (section 3.2). Beside the same performance photographed without one, over 12 frames of a kiss:
the base track about the mouth is 2.6 mm off (lips 2.0), after painting 0.8 mm (0.9); the outer lip contour is 1.7 px off, after
painting 0.7, the inner one 0.6 and 0.3 px.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera, Rig
from headcap.errors import InputError
from headcap.lips.inpainting.figure import inpainting_figure
from headcap.lips.inpainting.moments import most_alike, most_unlike, slightly_open
from headcap.lips.inpainting.painter import LipPainter
from headcap.lips.inpainting.region import LipRegion
from headcap.lips.inpainting.settings import InpaintingSettings
from headcap.lips.inpainting.takes import MeshMotion, TrackedTake
from headcap.lips.inpainting.texture import LipTexture, lip_texture
from headcap.recordings.frames import TakeFrames
from headcap.recordings.takes import IngestedTake
from headcap.recordings.writer import write_picture, write_video
from headcap.registration.sequence import joined
from headcap.registration.template import Template

_ROWS, _GAP_PX = 3, 8
"""Of the figure."""


@dataclass(frozen=True, eq=False)
class BareLips:
    """The lips without tattoo."""

    texture: LipTexture
    gap_mm: float
    """How far the mouth is open there."""


def bare_lips(start: Template, rig: Rig, take: TrackedTake, camera: str, settings: InpaintingSettings) -> BareLips:
    """The lips' texture from that moment of an untattooed take that suits best (`slightly_open`), as all cameras see it.

    `start` is the head on the take's first frame, in the rig's world, its mouth at rest. Raises `InputError` as `slightly_open`
    and `lip_texture`, and where `camera`, which will be painted into, has no picture of the take.
    """
    meshes, time_s = joined(take.sequence, len(start.vertices)), take.sequence.time_s
    with take.open() as opened:
        known = camera in opened.cameras
        seen = [k for k in range(len(meshes)) if known and opened.covers(camera, time_s[k])]
        if not seen:
            raise InputError(
                f"camera {camera} has no picture of {take.recorded.take}",
                expected="a frontal camera that recorded the take without tattoo",
                remedy="Name another camera under lip_camera, or another take under untattooed_take.",
            )
        place, gap_mm = slightly_open((meshes[k : k + 1][0] for k in seen), start, LipRegion.of(start, settings))
        chosen = seen[place]
        images = opened.images_at(float(time_s[chosen]))
        pictures = [images.get(name) for name in rig.names]
        return BareLips(lip_texture(start, meshes[chosen : chosen + 1][0], rig, pictures, camera, settings), gap_mm)


def inpaint_take(
    bare: LipTexture, camera: Camera, take: TrackedTake, video: Path | str, picture: Path | str
) -> tuple[IngestedTake, dict[str, float]]:
    """Write what a camera recorded of a tattooed take with bare lips, and figure 5; gives the take of that one recording.

    The video holds the frames that the camera took while the head was tracked, upright, at the times of the raw recording, which
    the take's recording repeats exactly. Figures: frames painted, and how far the reference pose is from the untattooed one, mm.
    Raises `InputError` where there are no such frames, and as `LipPainter`.
    """
    motion = MeshMotion(take.sequence, len(bare.mesh))
    with take.open() as opened:
        numbers = _tracked_frames(opened, camera.name, motion, take)
        times_s = opened.times_s(camera.name)[numbers]
        place, away_m = most_alike((motion.at(t) for t in times_s), bare.mesh, bare.region)
        reference = motion.at(times_s[place])
        painter = LipPainter(bare, camera, reference, opened.frame(camera.name, numbers[place]))
        frames = _Frames(painter, motion, opened, numbers, times_s)
        raw = take.recorded[camera.name]
        own_s = np.array(raw.frame_times_s)[numbers]
        _write(video, frames, own_s * raw.rate_hz, raw.rate_hz, camera)
        shown = most_unlike(lambda: (motion.at(t) for t in times_s), reference, bare.region, _ROWS)
        _save_figure(picture, [inpainting_figure(painter, *frames.tattooed(k)) for k in shown])
    painted = replace(raw, path=Path(video), frame_times_s=tuple(own_s.tolist()), rotation_deg=0, audio_rate_hz=None)
    figures = {"lips.inpainted_frames": float(len(numbers)), "lips.reference_away_mm": 1e3 * away_m}
    return IngestedTake(take.recorded.take, take.recorded.kind, (painted,)), figures


@dataclass(frozen=True, eq=False)
class _Frames:
    painter: LipPainter
    motion: MeshMotion
    opened: TakeFrames
    numbers: NDArray[np.int64]
    times_s: NDArray[np.float64]

    def tattooed(self, place: int) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
        """Mesh and picture."""
        picture = self.opened.frame(self.painter.camera.name, int(self.numbers[place]))
        return self.motion.at(float(self.times_s[place])), picture

    def painted(self) -> Iterator[NDArray[np.uint8]]:
        """Frame by frame."""
        return (self.painter.paint(*self.tattooed(place)) for place in range(len(self.numbers)))


def _tracked_frames(opened: TakeFrames, camera: str, motion: MeshMotion, take: TrackedTake) -> NDArray[np.int64]:
    """Numbers of the camera's frames that lie within the tracked time: elsewhere nobody knows the head."""
    time_s = opened.times_s(camera)
    grace_s = opened.settings.untouched_fraction / take.recorded[camera].rate_hz
    found = np.flatnonzero((time_s >= motion.time_s[0] - grace_s) & (time_s <= motion.time_s[-1] + grace_s))
    if len(found) < 2:
        raise InputError(
            f"{camera} has {len(found)} frames of {take.recorded.take} while the head was tracked",
            expected="at least 2",
            remedy="Name another camera under lip_camera, or track more frames of the take.",
        )
    return found


def _write(video: Path | str, frames: _Frames, slots: NDArray, rate_hz: float, camera: Camera) -> None:
    if camera.width % 2 or camera.height % 2:
        raise InputError(
            f"{camera.name} shows {camera.width}x{camera.height} pixels",
            expected="even numbers of pixels, as H.264 needs them",
            remedy="Name another camera under lip_camera.",
        )
    shown = ((float(slot), picture[..., ::-1]) for slot, picture in zip(slots, frames.painted(), strict=True))
    write_video(video, shown, camera.size, rate_hz)


def _save_figure(path: Path | str, rows: list[NDArray[np.uint8]]) -> None:
    """Rows of the figure, a wider one left with white beside the narrower ones."""
    width = max(row.shape[1] for row in rows)
    padded = [cv2.copyMakeBorder(row, 0, _GAP_PX, 0, width - row.shape[1], cv2.BORDER_CONSTANT, value=(255,) * 3) for row in rows]
    write_picture(path, np.concatenate(padded))
