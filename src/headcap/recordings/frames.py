"""Images of all cameras of a take at one moment of the common clock."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.recordings.between import Field, Grey, Motion, flow, half_grey, image_between, motion, moving_region
from headcap.recordings.probe import Recording
from headcap.recordings.settings import FrameSettings
from headcap.recordings.video import Image, VideoFrames

# four grey images and four flows make one image between two frames
MEMORY_PER_CAMERA = 8


@dataclass(frozen=True)
class Timeline:
    """The moments at which a take is reconstructed: the frame times of the camera that started last."""

    reference_camera: str
    time_s: NDArray[np.float64]
    """(frames,) on the common clock; frame k of the take is frame k of the reference camera."""

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True)
class Bracket:
    """The two frames of one camera around a moment."""

    before: int
    after: int
    """Frame numbers; equal where the moment is the first or last frame's."""
    fraction: float
    """0 at `before`, 1 at `after`."""


class TakeFrames:
    """Frames of a take by camera and common time.

    `common_times_s` gives each camera's frame times (frames,) on the common clock. Cameras do not fire together:
    `nearest` returns what was photographed and says when, `at` brings it to the moment asked for by the camera's own
    optical flow between the two frames around it. Files are opened when first read. Use as a context manager.
    """

    def __init__(
        self, recordings: Iterable[Recording], common_times_s: Mapping[str, NDArray], settings: FrameSettings | None = None
    ) -> None:
        self.settings = settings or FrameSettings()
        self._recordings = {recording.camera: recording for recording in recordings}
        self._times = {camera: np.asarray(common_times_s[camera], float) for camera in self._recordings}
        for camera, recording in self._recordings.items():
            times = self._times[camera]
            if times.shape != (len(recording.frame_times_s),) or np.any(np.diff(times) <= 0):
                raise ValueError(f"{camera}: {times.shape} rising common times for {len(recording.frame_times_s)} frames")
        self._videos: dict[str, VideoFrames] = {}
        self._memory: OrderedDict[Hashable, NDArray] = OrderedDict()

    def __enter__(self) -> TakeFrames:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close all files."""
        while self._videos:
            self._videos.popitem()[1].close()

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names in the order of the recordings."""
        return tuple(self._recordings)

    def times_s(self, camera: str) -> NDArray[np.float64]:
        """(frames,) common times of one camera's frames."""
        return self._times[camera]

    def timeline(self) -> Timeline:
        """Moments of the take; towards its end cameras that stopped earlier no longer cover them (see `covers`)."""
        reference = max(self._times, key=lambda camera: self._times[camera][0])
        return Timeline(reference, self._times[reference])

    def covers(self, camera: str, time_s: float) -> bool:
        """Whether the camera was recording then: inside its frames and in no gap of several dropped ones."""
        times, step_s = self._times[camera], 1 / self._recordings[camera].rate_hz
        grace_s = self.settings.untouched_fraction * step_s
        if not times[0] - grace_s <= time_s <= times[-1] + grace_s:
            return False
        around = self.bracket(camera, time_s)
        nearest_s = min(time_s - times[around.before], times[around.after] - time_s)
        gap_s = times[around.after] - times[around.before]
        return bool(nearest_s <= grace_s or gap_s <= (self.settings.bridged_frames + 1.5) * step_s)

    def bracket(self, camera: str, time_s: float) -> Bracket:
        """The frames around a moment; before the first or behind the last frame that frame alone."""
        times = self._times[camera]
        after = int(np.searchsorted(times, time_s, side="right"))
        if after == 0 or after == len(times):
            only = 0 if after == 0 else len(times) - 1
            return Bracket(only, only, 0.0)
        before = after - 1
        return Bracket(before, after, float((time_s - times[before]) / (times[after] - times[before])))

    def frame(self, camera: str, number: int) -> Image:
        """One frame by its number, (height, width, 3) uint8 BGR, read-only."""
        return self._video(camera)[number]

    def nearest(self, camera: str, time_s: float) -> tuple[Image, float]:
        """The photograph nearest to a moment, untouched, and the common time at which it was taken."""
        number = int(np.abs(self._times[camera] - time_s).argmin())
        return self.frame(camera, number), float(self._times[camera][number])

    def at(self, camera: str, time_s: float) -> Image:
        """The camera's image at a moment, (height, width, 3) uint8 BGR.

        Nearer to a frame than `untouched_fraction` of the interval it is that frame, untouched; else both frames around
        are warped to the moment along their flow, bent by the flow to the frames before and behind them (see
        `image_between`). What does not move is copied from the nearer frame. Raises `ValueError` where the camera does not
        cover the moment.
        """
        if not self.covers(camera, time_s):
            span = f"{self._times[camera][0]:.4f} to {self._times[camera][-1]:.4f} s"
            raise ValueError(f"{camera} has no picture at {time_s:.4f} s: it recorded {span}, or dropped frames there")
        around = self.bracket(camera, time_s)
        limit = self.settings.untouched_fraction
        if around.fraction <= limit:
            return self.frame(camera, around.before)
        if around.fraction >= 1 - limit:
            return self.frame(camera, around.after)
        return self._between(camera, around)

    def images_at(self, time_s: float) -> dict[str, Image]:
        """`at` for every camera that covers the moment, in the order of the recordings."""
        return {camera: self.at(camera, time_s) for camera in self.cameras if self.covers(camera, time_s)}

    def _between(self, camera: str, around: Bracket) -> Image:
        before, after = self.frame(camera, around.before), self.frame(camera, around.after)
        region = moving_region(before, after, self.settings)
        nearer = before if around.fraction < 0.5 else after
        if region is None:
            return nearer
        moved = image_between(
            before,
            after,
            self._motion(camera, around.before, around.after),
            self._motion(camera, around.after, around.before),
            around.fraction,
        )
        out = nearer.copy()
        out[region] = moved[region]
        return out

    def _motion(self, camera: str, number: int, ahead: int) -> Motion:
        """Motion of a frame towards a neighbour, bent by its flow to the neighbour on the other side."""
        behind, times = 2 * number - ahead, self._times[camera]
        forward = self._flow(camera, number, ahead)
        if not 0 <= behind < len(times):
            return motion(forward, None)
        ratio = (times[behind] - times[number]) / (times[number] - times[ahead])
        return motion(forward, self._flow(camera, number, behind), float(ratio))

    def _flow(self, camera: str, source: int, target: int) -> Field:
        return self._recall(
            (camera, source, target), lambda: flow(self._half_grey(camera, source), self._half_grey(camera, target))
        )

    def _half_grey(self, camera: str, number: int) -> Grey:
        return self._recall((camera, number), lambda: half_grey(self.frame(camera, number)))

    def _recall(self, key: Hashable, compute: Callable[[], NDArray]) -> NDArray:
        """Neighbouring moments share greys and flows: keep as many as one moment of every camera needs."""
        if key not in self._memory:
            self._memory[key] = compute()
            while len(self._memory) > MEMORY_PER_CAMERA * len(self._recordings):
                self._memory.popitem(last=False)
        self._memory.move_to_end(key)
        return self._memory[key]

    def _video(self, camera: str) -> VideoFrames:
        if camera not in self._videos:
            self._videos[camera] = VideoFrames(self._recordings[camera].path, cached=self.settings.frames_cached)
        return self._videos[camera]
