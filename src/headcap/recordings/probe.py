"""What a recording is, read from its packets: size, frame times, rate, sound; damage refused by name."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import av
import numpy as np

from headcap.errors import InputError
from headcap.recordings.packets import COPY_AGAIN, PacketTable, open_media, read_packets, video_stream


@dataclass(frozen=True)
class Recording:
    """One camera's file: its pictures as they are shown (upright), and the own time of each frame."""

    camera: str
    path: Path
    width: int
    height: int
    rate_hz: float
    """Of the frames' own grid, dropped frames filled in."""
    frame_times_s: tuple[float, ...]
    """Presentation times on the recording's own clock, rising; the truth about when a frame was taken."""
    rotation_deg: int
    """How the file asks to be turned, counter-clockwise, 0 to 270; `width` and `height` are after the turn."""
    audio_rate_hz: int | None

    @property
    def duration_s(self) -> float:
        """From the first frame to the end of the last."""
        return self.frame_times_s[-1] - self.frame_times_s[0] + 1 / self.rate_hz

    def to_json(self) -> dict:
        """Plain JSON form; `from_json` is its inverse."""
        return {**asdict(self), "path": str(self.path), "frame_times_s": list(self.frame_times_s)}

    @classmethod
    def from_json(cls, document: dict) -> Recording:
        """Inverse of `to_json`."""
        return cls(**{**document, "path": Path(document["path"]), "frame_times_s": tuple(document["frame_times_s"])})


def probe(path: Path | str, camera: str | None = None) -> Recording:
    """Read a recording's facts from its packets and one decoded frame; `camera` is the file's stem unless given.

    Raises `InputError` where the file is missing, unreadable, truncated, or has fewer than two frames.
    """
    path = Path(path)
    table = read_packets(path)
    if len(table.pts) < 2:
        raise InputError(f"{path} holds {len(table.pts)} frames", expected="at least 2", remedy=COPY_AGAIN)
    with open_media(path) as container:
        stream = video_stream(container, path)
        announced = stream.frames
        audio_rate_hz = container.streams.audio[0].rate if container.streams.audio else None
        width, height, rotation_deg = _first_frame_geometry(container, stream, path)
    _refuse_truncated(path, table, announced)
    times = np.array(table.pts) * table.time_base_s
    return Recording(
        camera=camera or path.stem,
        path=path,
        width=width,
        height=height,
        rate_hz=grid_rate_hz(times),
        frame_times_s=tuple(times.tolist()),
        rotation_deg=rotation_deg,
        audio_rate_hz=audio_rate_hz,
    )


def grid_rate_hz(times_s: np.ndarray) -> float:
    """Rate of the grid under rising times (n,): dropped frames leave whole steps out, they do not slow the grid.

    The median interval is quantised by the container's time base, so the slope over the numbered grid refines it.
    """
    steps = np.diff(times_s)
    step_s = float(np.median(steps))
    numbers = np.concatenate([[0], np.cumsum(np.maximum(np.rint(steps / step_s), 1))])
    slope_s = float(np.polyfit(numbers, times_s - times_s[0], 1)[0])
    # where frames come at no fixed rate the numbering means nothing, and the median is the honest answer
    return 1 / (slope_s if abs(slope_s / step_s - 1) < 0.02 else step_s)


def displayed_rotation_deg(frame: av.VideoFrame) -> int:
    """How far a decoded frame must be turned counter-clockwise to stand upright: 0, 90, 180 or 270."""
    return int(round(frame.rotation / 90) * 90) % 360


def _first_frame_geometry(container, stream: av.VideoStream, path: Path) -> tuple[int, int, int]:
    """(width, height, rotation) of the upright picture."""
    try:
        frame = next(container.decode(stream))
    except (av.error.FFmpegError, StopIteration) as error:
        raise InputError(f"{path}: not one frame decodes ({error})", expected="H.264 or alike", remedy=COPY_AGAIN) from error
    rotation_deg = displayed_rotation_deg(frame)
    size = (frame.width, frame.height) if rotation_deg % 180 == 0 else (frame.height, frame.width)
    return *size, rotation_deg


def _refuse_truncated(path: Path, table: PacketTable, announced: int) -> None:
    """Raise where packets are cut or fewer frames are there than the file's own index announces."""
    if not table.damaged and table.packets >= announced:
        return
    # an edit list may hide frames that the index still counts: they are there when it is ignored
    found = read_packets(path, ignore_editlist="1") if not table.damaged else table
    if not found.damaged and found.packets >= announced:
        return
    until_s = (table.pts[-1] - table.pts[0]) * table.time_base_s
    what = f"{path} is cut off: {found.packets - found.damaged} whole frames, the last at {until_s:.2f} s"
    raise InputError(what, expected=f"{announced} frames as its index says" if announced else "whole frames", remedy=COPY_AGAIN)
