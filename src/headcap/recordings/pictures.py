"""A recording's pictures judged by decoding each once: black, frozen, resized, damaged, a copy of another's."""

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
# grey is judged on a grid of every fourth pixel: enough for what is black, and for telling two recordings apart
STRIDE_PX = 4


@dataclass(frozen=True)
class PictureSurvey:
    """What all frames of a recording say together."""

    time_s: NDArray[np.float64]
    """(n,) own times of the frames that decoded, rising."""
    change: NDArray[np.float32]
    """(n,) by how many grey values (0 to 255) the cell of 8x8 pixels that changed most differs from the frame before; 0 at
    the first frame."""
    spread: float
    """Largest difference of any cell between any two frames, grey values."""
    brightest: float
    """Largest 99th percentile of grey over the frames."""
    sizes: frozenset[tuple[int, int, int]]
    """(width, height, rotation) as decoded."""
    damaged_s: tuple[float, ...]
    """Own times of frames that do not decode, or are marked as corrupt."""
    error: str
    """What the decoder said first, empty where it did not complain."""
    digest: str
    """Of the decoded pictures: two files with one digest show the same."""


def survey_pictures(recording: Recording) -> PictureSurvey:
    """Decode every frame once, 2 to 4 ms each at half a megapixel; raises `InputError` where the file cannot be opened."""
    table = read_packets(recording.path)
    collector = _Collector()
    with open_media(recording.path) as container:
        for frame in _frames(container, video_stream(container, recording.path), collector):
            collector.add(frame)
    lost = (set(table.pts) - set(collector.pts)) | collector.corrupt
    return collector.survey(table.time_base_s, sorted(lost))


def _frames(container: av.container.InputContainer, stream: av.VideoStream, collector: _Collector) -> Iterator[av.VideoFrame]:
    """All frames that decode; what the decoder complains of is noted and passed over."""
    try:
        for packet in container.demux(stream):
            try:
                yield from packet.decode()
            except av.error.FFmpegError as failure:
                collector.complain(failure.strerror or str(failure))
    except (av.error.FFmpegError, OSError) as failure:  # nothing more can be read
        collector.complain(failure.strerror or str(failure))


class _Collector:
    """Gathers what `PictureSurvey` holds, frame by frame."""

    def __init__(self) -> None:
        self.pts: list[int] = []
        self.change: list[float] = []
        self.sizes: set[tuple[int, int, int]] = set()
        self.corrupt: set[int] = set()
        self.brightest, self.error, self.digest = 0.0, "", hashlib.sha256()
        self.before = self.low = self.high = None

    def complain(self, what: str) -> None:
        """Note what the decoder said, if it is the first that it says."""
        self.error = self.error or what

    def add(self, frame: av.VideoFrame) -> None:
        """Take in the next frame that decoded."""
        if frame.is_corrupt:
            self.corrupt.add(frame.pts)
            self.complain("a frame is marked as corrupt")
        grey = frame.to_ndarray(format="gray")
        coarse = grey[::STRIDE_PX, ::STRIDE_PX]
        self.brightest = max(self.brightest, float(np.percentile(coarse, 99)))
        self.digest.update(coarse.tobytes())
        self.sizes.add((frame.width, frame.height, displayed_rotation_deg(frame)))
        columns, rows = max(frame.width // CELL_PX, 1), max(frame.height // CELL_PX, 1)
        cells = cv2.resize(grey.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
        if self.before is None or self.before.shape != cells.shape:
            self.before = self.low = self.high = cells
        self.pts.append(frame.pts)
        self.change.append(float(np.abs(cells - self.before).max()))
        self.low, self.high, self.before = np.minimum(self.low, cells), np.maximum(self.high, cells), cells

    def survey(self, time_base_s: float, lost: list[int]) -> PictureSurvey:
        """What was gathered; `lost` are presentation times of frames that did not decode, in the file's time base."""
        return PictureSurvey(
            time_s=np.array(self.pts) * time_base_s,
            change=np.array(self.change, np.float32),
            spread=float((self.high - self.low).max()) if self.pts else 0.0,
            brightest=self.brightest,
            sizes=frozenset(self.sizes),
            damaged_s=tuple(pts * time_base_s for pts in lost),
            error=self.error,
            digest=self.digest.hexdigest(),
        )


def picture_problems(recording: Recording, survey: PictureSurvey, settings: IngestSettings) -> list[InputError]:
    """Everything wrong with one recording's pictures, as errors to be told together."""
    found, name = [], f"{recording.camera} ({recording.path})"
    if survey.damaged_s or survey.error:
        found.append(_damage(name, recording, survey))
    if len(survey.sizes) > 1:
        sizes = ", ".join(f"{w}x{h} turned by {r}" for w, h, r in sorted(survey.sizes))
        remedy = "Cut the file where the size changes and give the parts as takes of their own"
        found.append(InputError(f"{name} changes its picture: {sizes}", expected="one size throughout", remedy=remedy))
    if survey.brightest < settings.black_level:
        remedy = "Take off the lens cap or light the scene; else leave this camera out of the take"
        what = f"{name} is black: the brightest percent is {survey.brightest:.0f} of 255"
        found.append(InputError(what, expected=f"at least {settings.black_level:.0f}", remedy=remedy))
    elif len(survey.time_s) and len(survey.sizes) == 1 and survey.spread < settings.frozen_level:
        remedy = "Restart the camera; leave it out of this take"
        what = f"{name} is frozen: no part of the picture changes by more than {survey.spread:.2f} grey values"
        found.append(InputError(what, expected=f"at least {settings.frozen_level}", remedy=remedy))
    return found


def _damage(name: str, recording: Recording, survey: PictureSurvey) -> InputError:
    """One error for all frames of a recording that do not decode."""
    count = len(survey.damaged_s)
    said = f" ({survey.error})" if survey.error else ""
    if count:
        at = ", the first" if count > 1 else ","
        what = f"{count} of {len(recording.frame_times_s)} frames do not decode{at} at {survey.damaged_s[0]:.2f} s{said}"
    else:
        what = f"its pictures are damaged{said}"
    return InputError(f"{name}: {what}", expected="frames that decode from the first to the last", remedy=COPY_AGAIN)
