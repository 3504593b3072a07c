"""A recording's picture judged from a few decoded frames: black, frozen, resized, broken at the end, a copy of another's."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.recordings.packets import COPY_AGAIN, open_media, read_packets, video_stream
from headcap.recordings.probe import Recording, displayed_rotation_deg
from headcap.recordings.settings import IngestSettings

CELL_PX = 8
# packets decoded in full before the end; those before may leave out frames that no other depends on
LAST_PACKETS = 8


@dataclass(frozen=True)
class PictureSamples:
    """Frames decoded from across a recording and from its end."""

    cells: NDArray[np.float32]
    """(n, rows, columns) mean grey of cells of 8x8 pixels, of frames of the first one's size."""
    brightest: float
    """Largest 99th percentile of grey over the frames."""
    sizes: frozenset[tuple[int, int, int]]
    """(width, height, rotation) as decoded."""
    last_time_s: float
    """Own time of the last frame that decoded."""
    error: str
    """What the decoder said, empty where it did not complain."""
    digest: str
    """Of the decoded pictures: two files with one digest show the same."""


def sample_pictures(recording: Recording, settings: IngestSettings) -> PictureSamples:
    """Decode some key frames and the run of frames up to the end; raises `InputError` where the file cannot be opened.

    A run longer than `tail_frames_max` is too dear: its first second shows whether anything moves, and its packets
    have been found whole by `probe`.
    """
    table = read_packets(recording.path)
    keys = table.key_pts or table.pts[:1]
    with open_media(recording.path) as container:
        stream = video_stream(container, recording.path)
        collector = _Collector()
        try:
            for frame in _key_frames(container, stream, keys, settings.key_frames_sampled):
                collector.add(frame)
            container.seek(keys[-1], stream=stream, backward=True)
            tail = [packet for packet in container.demux(stream) if packet.size]
            whole = len(tail) <= settings.tail_frames_max
            for frame in _decode_sparsely(stream, tail if whole else tail[: round(recording.rate_hz)]):
                collector.add(frame)
        except (av.error.FFmpegError, StopIteration) as failure:
            collector.error, whole = str(failure) or "a key frame does not decode", True
        last_pts = collector.last_pts if whole else table.pts[-1]
    return collector.samples(last_pts * table.time_base_s)


class _Collector:
    """Gathers what `PictureSamples` holds, frame by frame."""

    def __init__(self) -> None:
        self.cells, self.sizes, self.brightest, self.last_pts, self.error = [], set(), 0.0, 0, ""
        self.digest = hashlib.sha256()

    def add(self, frame: av.VideoFrame) -> None:
        grey = frame.to_ndarray(format="gray")
        coarse = grey[::4, ::4]
        self.last_pts = max(self.last_pts, frame.pts)
        self.sizes.add((frame.width, frame.height, displayed_rotation_deg(frame)))
        self.error = self.error or ("a frame is marked as corrupt" if frame.is_corrupt else "")
        self.brightest = max(self.brightest, float(np.percentile(coarse, 99)))
        self.digest.update(coarse.tobytes())
        rows, columns = max(frame.height // CELL_PX, 1), max(frame.width // CELL_PX, 1)
        cells = cv2.resize(grey.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
        if not self.cells or cells.shape == self.cells[0].shape:
            self.cells.append(cells)

    def samples(self, last_time_s: float) -> PictureSamples:
        cells, sizes = np.array(self.cells), frozenset(self.sizes)
        return PictureSamples(cells, self.brightest, sizes, last_time_s, self.error, self.digest.hexdigest())


def picture_problems(recording: Recording, samples: PictureSamples, settings: IngestSettings) -> list[InputError]:
    """Everything wrong with one recording's picture, as errors to be told together."""
    found, name = [], f"{recording.camera} ({recording.path})"
    missing_s = recording.frame_times_s[-1] - samples.last_time_s
    if samples.error or missing_s > 0.5 / recording.rate_hz:
        what = samples.error or f"the last {missing_s:.2f} s do not decode"
        found.append(InputError(f"{name}: {what}", expected="frames that decode up to the end", remedy=COPY_AGAIN))
    if len(samples.sizes) > 1:
        sizes = ", ".join(f"{w}x{h} turned by {r}" for w, h, r in sorted(samples.sizes))
        remedy = "Cut the file where the size changes and give the parts as takes of their own"
        found.append(InputError(f"{name} changes its picture: {sizes}", expected="one size throughout", remedy=remedy))
    if samples.brightest < settings.black_level:
        remedy = "Take off the lens cap or light the scene; else leave this camera out of the take"
        what = f"{name} is black: the brightest percent is {samples.brightest:.0f} of 255"
        found.append(InputError(what, expected=f"at least {settings.black_level:.0f}", remedy=remedy))
    elif len(samples.cells) and len(samples.sizes) == 1:
        change = float(np.ptp(samples.cells, axis=0).max())
        if change < settings.frozen_level:
            remedy = "Restart the camera; leave it out of this take"
            what = f"{name} is frozen: no part of the picture changes by more than {change:.2f} grey values"
            found.append(InputError(what, expected=f"at least {settings.frozen_level}", remedy=remedy))
    return found


def _key_frames(container, stream: av.VideoStream, keys: tuple[int, ...], wanted: int) -> Iterator[av.VideoFrame]:
    """Single frames spread over the recording, the last key frame left to the tail."""
    chosen = np.unique(np.linspace(0, len(keys) - 1, wanted).astype(int))[:-1]
    for key in (keys[i] for i in chosen):
        container.seek(key, stream=stream, backward=True)
        yield next(container.decode(stream))


def _decode_sparsely(stream: av.VideoStream, packets: list[av.Packet]) -> Iterator[av.VideoFrame]:
    context = stream.codec_context
    for number, packet in enumerate(packets):
        context.skip_frame = "NONREF" if number < len(packets) - LAST_PACKETS else "DEFAULT"
        yield from context.decode(packet)
    yield from context.decode(None)
