"""The moments at which a take is worked on, and its frames opened on the common clock."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_json, save_json
from headcap.errors import InputError
from headcap.recordings.frames import TakeFrames
from headcap.recordings.settings import FrameSettings
from headcap.recordings.takes import IngestedTake
from headcap.sync.offsets import TimeOffsets

KIND, SCHEMA = "take_timeline", 1


@dataclass(frozen=True)
class TakeTimeline:
    """Frames of a take, numbered as the reference camera's, and their moments on the common clock."""

    take: str
    reference_camera: str
    frames: NDArray[np.int64]
    """(t,) consecutive frame numbers of the reference camera."""
    time_s: NDArray[np.float64]
    """(t,) their moments."""

    def __len__(self) -> int:
        return len(self.frames)

    def save(self, path: Path | str) -> None:
        """Write as JSON artifact `headcap.take_timeline/1`."""
        content = {"take": self.take, "reference_camera": self.reference_camera}
        save_json(path, KIND, SCHEMA, content | {"frames": self.frames.tolist(), "time_s": self.time_s.tolist()})

    @classmethod
    def load(cls, path: Path | str) -> TakeTimeline:
        """Read what `save` wrote; raises `ArtifactError`."""
        content = load_json(path, KIND, SCHEMA)
        arrays = {"frames": np.array(content.pop("frames"), np.int64), "time_s": np.array(content.pop("time_s"))}
        return cls(**content, **arrays)

    def span(self, first: int, count: int) -> tuple[int, int]:
        """First and last position of at most `count` frames from position `first` on."""
        return first, min(first + count, len(self)) - 1

    def part(self, first: int, count: int) -> TakeTimeline:
        """The frames from position `first` on, at most `count` of them."""
        chosen = slice(first, first + count)
        return TakeTimeline(self.take, self.reference_camera, self.frames[chosen], self.time_s[chosen])


def open_take(take: IngestedTake, offsets: TimeOffsets, settings: FrameSettings | None = None) -> TakeFrames:
    """The take's frames on the common clock; use as a context manager."""
    common = {r.camera: offsets.common_time(r.camera, np.array(r.frame_times_s)) for r in take.recordings}
    return TakeFrames(take.recordings, common, settings)


def make_timeline(
    take: IngestedTake, offsets: TimeOffsets, *, frames: tuple[int, int] | None = None, min_cameras: int = 3
) -> TakeTimeline:
    """The frames asked for, first and last; by default all up to the last that `min_cameras` cameras photographed.

    A camera photographed a frame where it has a picture within one frame interval of it. Raises `InputError` where frames are
    asked for that too few cameras recorded.
    """
    with open_take(take, offsets) as opened:
        timeline = opened.timeline()
        step_s = {recording.camera: 1 / recording.rate_hz for recording in take.recordings}
        near = [np.abs(timeline.time_s[:, None] - opened.times_s(c)).min(1) <= step_s[c] for c in opened.cameras]
        covered = np.sum(near, axis=0) >= min_cameras
    count = int(np.argmin(covered)) if not covered.all() else len(covered)
    first, last = frames or (0, count - 1)
    if last >= count or count == 0:
        raise InputError(
            f"{take.take}: frames {first} to {last} asked for, but only {count} were photographed by {min_cameras} cameras",
            expected=f"frames within 0 to {count - 1} of {timeline.reference_camera}, the camera that started last",
            remedy="Correct the take's frames in the session file, or its offsets if the recordings do overlap",
        )
    chosen = np.arange(first, last + 1)
    return TakeTimeline(take.take, timeline.reference_camera, chosen, timeline.time_s[chosen])
