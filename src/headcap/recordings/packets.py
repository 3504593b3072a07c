"""A video stream's packets: when each frame is shown, without decoding it."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import av
from av.container import InputContainer

from headcap.errors import InputError

COPY_AGAIN = "Copy the file again from the camera, or leave this camera out of the session file"


@dataclass(frozen=True)
class PacketTable:
    """What demuxing tells of a video stream."""

    pts: tuple[int, ...]
    """Of the shown frames, in order of showing; seconds are pts * time_base_s."""
    time_base_s: float
    key_pts: tuple[int, ...]
    """Of the frames that decode alone."""
    packets: int
    """In the stream, those included that an edit list hides."""
    damaged: int
    """Packets the container marks as incomplete."""


@contextmanager
def open_media(path: Path | str, **options: str) -> Iterator[InputContainer]:
    """Open a media file for reading; raises `InputError` where it is missing or no readable container."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path} is not there", expected="a recording", remedy="Correct the path, or leave the camera out")
    try:
        container = av.open(str(path), options=options)
    except (av.error.FFmpegError, OSError) as error:
        what = f"{path} ({path.stat().st_size} bytes) cannot be opened: {error.strerror or error}"
        raise InputError(what, expected="a whole video or sound file", remedy=COPY_AGAIN) from error
    with container:
        yield container


def video_stream(container: InputContainer, path: Path | str) -> av.VideoStream:
    """The file's first picture stream; raises `InputError` where there is none."""
    if not container.streams.video:
        remedy = "Give the camera's video file, or leave this camera out of the session file"
        raise InputError(f"{path} has no picture", expected="a video stream", remedy=remedy)
    stream = container.streams.video[0]
    stream.codec_context.thread_count = 1  # jobs run side by side, one core each
    return stream


def read_packets(path: Path | str, **options: str) -> PacketTable:
    """Demux all picture packets; an error in the middle of the file ends the table there.

    Raises `InputError` where the file cannot be opened, has no video stream, or its packets carry no times.
    """
    shown, keys, packets, damaged = [], [], 0, 0
    with open_media(path, **options) as container:
        stream = video_stream(container, path)
        time_base = float(stream.time_base)
        try:
            for packet in container.demux(stream):
                if packet.size == 0:
                    continue
                packets += 1
                damaged += packet.is_corrupt
                if packet.is_discard:
                    continue
                if packet.pts is None:
                    remedy = "Wrap it into mp4 or mkv with times, for example `ffmpeg -i IN -c copy OUT.mp4`"
                    raise InputError(f"{path} carries no presentation times", expected="a time on every frame", remedy=remedy)
                shown.append(packet.pts)
                if packet.is_keyframe:
                    keys.append(packet.pts)
        except (av.error.FFmpegError, OSError):
            damaged += 1
    return PacketTable(tuple(sorted(set(shown))), time_base, tuple(sorted(keys)), packets, damaged)
