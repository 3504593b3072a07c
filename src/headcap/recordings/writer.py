"""Writing pictures: a recording, H.264 and where there is sound AAC, in mp4, frame by frame, or one alone as PNG."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import atomic_path

_AUDIO_BLOCK = 1024
_TICKS_PER_FRAME = 512


def write_video(
    path: Path | str,
    frames: Iterable[tuple[float, NDArray[np.uint8]]],
    size: tuple[int, int],
    rate_hz: float,
    *,
    crf: float = 13.0,
    preset: str = "veryfast",
    sound: NDArray[np.float32] | None = None,
    sound_rate_hz: int = 48_000,
) -> None:
    """Write frames (slot, RGB (height, width, 3)) of `size` (width, height), both even, and sound (n,) to an mp4.

    Slot k is presented at k / rate, missing slots are gaps; parts of a slot count, to a 512th. `crf` is H.264's quality, lower is
    better, and `preset` x264's name for how much work goes into it. Only one frame is held at a time; the file appears whole or
    not at all.
    """
    with atomic_path(path) as temporary, av.open(str(temporary), "w", format="mp4") as container:
        picture = _picture_stream(container, size, rate_hz, crf, preset)
        track = None if sound is None else _sound_stream(container, sound_rate_hz)
        blocks = iter(()) if sound is None else _sound_blocks(sound, sound_rate_hz)
        for slot, image in frames:
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24").reformat(format="yuv420p")
            frame.pts, frame.time_base = round(slot * _TICKS_PER_FRAME), picture.codec_context.time_base
            container.mux(picture.encode(frame))
            # sound goes in beside the picture, so that players and readers need not seek
            for block in blocks:
                container.mux(track.encode(block))
                if block.pts > (slot + 1) * sound_rate_hz / rate_hz:
                    break
        for block in blocks:
            container.mux(track.encode(block))
        container.mux(picture.encode(None))
        if track is not None:
            container.mux(track.encode(None))


def write_picture(path: Path | str, picture: NDArray[np.uint8]) -> None:
    """Write one picture (height, width, 3), BGR as `VideoFrames` gives them, to a PNG that appears whole or not at all.

    Packed quickly: packed as tightly as can be a file is a third smaller and takes thirty times as long.
    """
    coded = cv2.imencode(".png", picture)[1]
    with atomic_path(path) as temporary:
        temporary.write_bytes(coded.tobytes())


def _picture_stream(
    container: av.container.OutputContainer, size: tuple[int, int], rate_hz: float, crf: float, preset: str
) -> av.VideoStream:
    rate = Fraction(rate_hz).limit_denominator(1001)
    # one thread gives the same bits every time, and recordings are written side by side anyway; the macroblock tree is left
    # out because its floating-point part came out differently from run to run on a busy machine
    options = {"crf": str(crf), "preset": preset, "threads": "1", "x264-params": "mbtree=0:rc-lookahead=0"}
    stream = container.add_stream("libx264", rate=rate, options=options)
    stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
    stream.codec_context.time_base = Fraction(1, 1) / (rate * _TICKS_PER_FRAME)
    stream.codec_context.thread_count = 1
    return stream


def _sound_stream(container: av.container.OutputContainer, rate_hz: int) -> av.AudioStream:
    stream = container.add_stream("aac", rate=rate_hz, layout="mono")
    stream.bit_rate = 160_000
    return stream


def _sound_blocks(sound: NDArray[np.float32], rate_hz: int) -> Iterator[av.AudioFrame]:
    for first in range(0, len(sound), _AUDIO_BLOCK):
        block = av.AudioFrame.from_ndarray(
            sound[None, first : first + _AUDIO_BLOCK].astype(np.float32), format="fltp", layout="mono"
        )
        block.sample_rate, block.pts, block.time_base = rate_hz, first, Fraction(1, rate_hz)
        yield block
