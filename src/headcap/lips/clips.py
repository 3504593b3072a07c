"""What the base tracker looks at: one camera's pictures of a take, from a rig or from a single video (lip paper, section 3.2)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.calibration.result import load_camera
from headcap.cameras import Camera, Rig
from headcap.errors import InputError
from headcap.geometry.transforms import fit_similarity
from headcap.heads.procedural import base_head
from headcap.meshes.normals import vertex_normals
from headcap.recordings.takes import IngestedTake
from headcap.recordings.video import Image, VideoFrames
from headcap.registration.template import Template
from headcap.sync.offsets import TimeOffsets
from headcap.sync.timeline import TakeTimeline, open_take

_LEAST_LANDMARKS = 4


@dataclass(frozen=True, eq=False)
class Clip:
    """Pictures of one camera."""

    camera: Camera
    time_s: NDArray[np.float64]
    """(f,) rising."""
    open_pictures: Callable[[], Iterator[Image]]
    """Begins anew with each call: f pictures (height, width, 3) uint8 BGR."""
    focal_known: bool = True

    def __len__(self) -> int:
        return len(self.time_s)

    def pictures(self) -> Iterator[Image]:
        """All pictures in order, read as they are asked for."""
        return self.open_pictures()


def video_clip(path: Path | str, camera: Camera) -> Clip:
    """All frames of a video that a camera took, upright.

    Raises `InputError` for a camera of another picture size and files that cannot be read.
    """
    with VideoFrames(path) as frames:
        size, time_s = frames[0].shape[1::-1], frames.times_s
    if size != camera.size:
        raise InputError(
            f"{path} shows {size[0]}x{size[1]} pixels",
            expected=f"the {camera.width}x{camera.height} of camera {camera.name}",
            remedy="Name the camera that took this video, in the orientation in which the video is shown.",
        )

    def pictures() -> Iterator[Image]:
        """Every frame, from the first."""
        with VideoFrames(path) as opened:
            yield from opened

    return Clip(camera, time_s, pictures)


def rig_clip(camera: Camera, take: IngestedTake, offsets: TimeOffsets, timeline: TakeTimeline) -> Clip:
    """What one camera of a rig shows at the moments at which the take was tracked, brought there by the camera's own flow.

    Moments that the camera did not record, as in the last frames of cameras that stop first, are left out. Raises `InputError`
    where these are more than half of the take.
    """
    alone = IngestedTake(take.take, take.kind, (take[camera.name],))
    with open_take(alone, offsets) as opened:
        covered = np.array([opened.covers(camera.name, moment) for moment in timeline.time_s], bool)
    if covered.sum() < 0.5 * len(timeline):
        raise InputError(
            f"{camera.name} has pictures of {covered.sum()} of {len(timeline)} frames of {take.take}",
            expected="a camera that recorded at least half of the take",
            remedy="Name another camera under lip_camera.",
        )
    time_s = timeline.time_s[covered]

    def pictures() -> Iterator[Image]:
        """What the camera shows at each moment, from the first."""
        with open_take(alone, offsets) as opened:
            yield from (opened.at(camera.name, moment) for moment in time_s)

    return Clip(camera, time_s, pictures)


@dataclass(frozen=True)
class ClipFiles:
    """Where a clip lies: a video with its camera, or a take of a rig with one of its cameras."""

    camera: Path
    """One camera, as `save_cameras` writes it."""
    video: Path | None = None
    ingested: Path | None = None
    offsets: Path | None = None
    timeline: Path | None = None

    def open(self) -> Clip:
        """The clip; raises `InputError` as `video_clip` and `rig_clip`, and `ArtifactError`."""
        camera = load_camera(self.camera)
        if self.video is not None:
            return video_clip(self.video, camera)
        take = IngestedTake.load(self.ingested)
        return rig_clip(camera, take, TimeOffsets.load(self.offsets), TakeTimeline.load(self.timeline))


def frontal_camera(rig: Rig, start: Template) -> str:
    """Name of the camera that looks most nearly straight at a head in the rig's world.

    The paper takes "one of the frontal cameras" (section 3.2). Which way a head faces its landmarks tell, laid on those of the
    base head; where fewer than four have the same names, the mean normal of the face, which the chin's underside bends down.
    """
    middle, out = start.vertices[start.regions["face"]].mean(axis=0), _facing(start)
    ways = {camera.name: camera.centre - middle for camera in rig}
    return max(ways, key=lambda name: float(ways[name] @ out / np.linalg.norm(ways[name])))


def _facing(start: Template) -> NDArray[np.float64]:
    """(3,) out of a head's face."""
    base = base_head()
    names = [name for name in base.landmarks if name in start.landmarks]
    if len(names) < _LEAST_LANDMARKS:
        return vertex_normals(start.vertices, start.triangles)[start.regions["face"]].mean(axis=0)
    own, theirs = (head.vertices[[head.landmarks[name] for name in names]] for head in (base, start))
    return fit_similarity(own, theirs)[0][:3, 2]
