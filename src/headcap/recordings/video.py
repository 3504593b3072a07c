"""Frames of one recording as images, by number or by time."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import OrderedDict
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.recordings.packets import COPY_AGAIN, open_media, read_packets, video_stream
from headcap.recordings.probe import displayed_rotation_deg

Image = NDArray[np.uint8]

_EARLIER_KEYS = 3
"""Key frames that are tried before the file is read from its start."""


class VideoFrames:
    """Frames of a video file as upright (height, width, 3) uint8 BGR images, read in any order.

    Reading forward decodes each frame once; a jump seeks to the key frame before. Containers without an index (MPEG program and
    transport streams) are sought by the times in their packs and land behind the key frame asked for: then an earlier one is
    asked for, and how much earlier is kept in mind. The last `cached` images are kept and handed out read-only. Use as a context
    manager, or `close` it.
    """

    def __init__(self, path: Path | str, *, cached: int = 4) -> None:
        self.path = Path(path)
        table = read_packets(self.path)
        self._pts, self._key_pts, self._keys = table.pts, table.key_pts, frozenset(table.key_pts)
        self.times_s: NDArray[np.float64] = np.array(table.pts) * table.time_base_s
        self._cache: OrderedDict[int, Image] = OrderedDict()
        self._cached = max(cached, 1)
        self._lead = 0
        """How many key frames before the one that is needed a seek has to ask for, as far as is known."""
        self._open()

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
            self._keep(number, self._decode(number))
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

    def _open(self) -> None:
        """Open the file at its start."""
        self._opened = open_media(self.path)
        self._container = self._opened.__enter__()
        self._stream = video_stream(self._container, self.path)
        self._decoder = self._container.decode(self._stream)
        self._next_pts: int | None = self._pts[0] if self._pts else None

    def _decode(self, number: int) -> Image:
        pts = self._pts[number]
        frame = self._advance(pts) if self._lies_ahead(pts) else self._sought(pts)
        if frame is None or frame.pts != pts:
            found = f"{self.path}: the frame at {self.times_s[number]:.3f} s does not decode"
            raise InputError(found, expected="a whole file", remedy=COPY_AGAIN)
        turns = displayed_rotation_deg(frame) // 90
        return np.ascontiguousarray(np.rot90(frame.to_ndarray(format="bgr24"), turns))

    def _lies_ahead(self, pts: int) -> bool:
        """Whether decoding on is the shortest way: the frame is the next one, or no key frame comes before it."""
        if self._next_pts is None or pts < self._next_pts:
            return False
        coming = self._pts[bisect_left(self._pts, self._next_pts)]
        return bisect_right(self._key_pts, pts) == bisect_right(self._key_pts, coming)

    def _sought(self, pts: int) -> av.VideoFrame | None:
        """The frame from the nearest key frame before it that a seek leads to, or from the start of the file."""
        key = bisect_right(self._key_pts, pts) - 1
        for lead in range(self._lead, self._lead + _EARLIER_KEYS):
            if key < lead:
                break
            if not self._lands_on_key(self._key_pts[key - lead]):
                continue
            frame = self._advance(pts)
            if frame is not None and frame.pts == pts:
                self._lead = lead
                return frame
        self.close()
        self._open()
        return self._advance(pts)

    def _lands_on_key(self, pts: int) -> bool:
        """Seek to a key frame, or where the container leads instead; whether decoding begins at one of the key frames there are.

        A program stream entered in the middle of a frame gives the next frame that one's time: it would pass for its neighbour.
        """
        self._container.seek(pts, stream=self._stream, backward=True)
        decoder = self._container.decode(self._stream)
        first = self._next(decoder)
        if first is None or first.pts not in self._keys:
            return False
        self._decoder = chain([first], decoder)
        return True

    def _next(self, decoder: Iterator[av.VideoFrame]) -> av.VideoFrame | None:
        """The next frame that has a time; None at the end of the file."""
        try:
            return next((frame for frame in decoder if frame.pts is not None), None)
        except av.error.FFmpegError as error:
            self._next_pts = None
            raise InputError(f"{self.path} does not decode ({error})", expected="a whole file", remedy=COPY_AGAIN) from error

    def _advance(self, pts: int) -> av.VideoFrame | None:
        """Decode until the frame at `pts` or the first one behind it; None at the end of the file."""
        frame = self._next(self._decoder)
        while frame is not None and frame.pts < pts:
            frame = self._next(self._decoder)
        self._next_pts = None if frame is None else frame.pts + 1
        return frame
