"""Frames of one recording as images, by number or by time."""

from __future__ import annotations

from bisect import bisect_right
from collections import OrderedDict
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.recordings.packets import COPY_AGAIN, open_media, read_packets, video_stream
from headcap.recordings.probe import displayed_rotation_deg

Image = NDArray[np.uint8]


class VideoFrames:
    """Frames of a video file as upright (height, width, 3) uint8 BGR images, read in any order.

    Reading forward decodes each frame once; a jump seeks to the key frame before. The last `cached` images are kept and
    handed out read-only. Use as a context manager, or `close` it.
    """

    def __init__(self, path: Path | str, *, cached: int = 4) -> None:
        self.path = Path(path)
        table = read_packets(self.path)
        self._pts, self._key_pts = table.pts, table.key_pts
        self.times_s: NDArray[np.float64] = np.array(table.pts) * table.time_base_s
        self._cache: OrderedDict[int, Image] = OrderedDict()
        self._cached = max(cached, 1)
        self._opened = open_media(self.path)
        self._container = self._opened.__enter__()
        self._stream = video_stream(self._container, self.path)
        self._decoder = None
        self._next_pts: int | None = None

    def __len__(self) -> int:
        return len(self._pts)

    def __enter__(self) -> VideoFrames:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __iter__(self):
        return (self[number] for number in range(len(self)))

    def close(self) -> None:
        """Close the file; images already read stay valid."""
        self._decoder = None
        self._opened.__exit__(None, None, None)

    def __getitem__(self, number: int) -> Image:
        """Frame by number in order of showing; raises `IndexError`, and `InputError` where it does not decode."""
        if not 0 <= number < len(self):
            raise IndexError(f"{self.path} has frames 0 to {len(self) - 1}, asked for {number}")
        if number not in self._cache:
            self._keep(number, self._decode(self._pts[number]))
        self._cache.move_to_end(number)
        return self._cache[number]

    def nearest_number(self, time_s: float) -> int:
        """Number of the frame whose own presentation time is nearest to `time_s`."""
        return int(np.abs(self.times_s - time_s).argmin())

    def at(self, time_s: float) -> Image:
        """The frame whose own presentation time is nearest to `time_s`."""
        return self[self.nearest_number(time_s)]

    def _keep(self, number: int, image: Image) -> None:
        image.setflags(write=False)
        self._cache[number] = image
        while len(self._cache) > self._cached:
            self._cache.popitem(last=False)

    def _decode(self, pts: int) -> Image:
        if self._must_seek(pts):
            self._seek(pts)
        frame = self._advance(pts)
        if frame is None or frame.pts != pts:
            self._seek(self._pts[0])  # a wrong index may have landed behind the frame: read from the start
            frame = self._advance(pts)
        if frame is None or frame.pts != pts:
            found = f"{self.path}: the frame at {pts * float(self._stream.time_base):.3f} s does not decode"
            raise InputError(found, expected="a whole file", remedy=COPY_AGAIN)
        turns = displayed_rotation_deg(frame) // 90
        return np.ascontiguousarray(np.rot90(frame.to_ndarray(format="bgr24"), turns))

    def _must_seek(self, pts: int) -> bool:
        if self._next_pts is None or pts < self._next_pts:
            return True
        return bisect_right(self._key_pts, pts) > bisect_right(self._key_pts, self._next_pts)

    def _seek(self, pts: int) -> None:
        self._container.seek(pts, stream=self._stream, backward=True)
        self._decoder = self._container.decode(self._stream)

    def _advance(self, pts: int) -> av.VideoFrame | None:
        """Decode until the frame at `pts` or the first one behind it; None at the end of the file."""
        try:
            for frame in self._decoder:
                if frame.pts is not None and frame.pts >= pts:
                    self._next_pts = frame.pts + 1
                    return frame
        except av.error.FFmpegError as error:
            self._next_pts = None
            raise InputError(f"{self.path} does not decode ({error})", expected="a whole file", remedy=COPY_AGAIN) from error
        self._next_pts = None
        return None
