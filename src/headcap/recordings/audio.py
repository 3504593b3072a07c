"""Sound of a recording as mono samples on the recording's own clock."""

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.recordings.packets import COPY_AGAIN, open_media


def read_audio(path: Path | str, rate_hz: int | None = 48000) -> tuple[NDArray[np.float32], int, float]:
    """Sound as (mono samples (n,) float32, rate in Hz, own presentation time of the first sample in seconds).

    Samples are placed by their presentation times, so a gap in the sound is silence and not a shift; edit lists and
    encoder delays are honoured. `rate_hz` None keeps the file's own rate; another rate is reached by a zero-phase filter,
    which moves nothing in time. Raises `InputError` where the file has no sound or it does not decode.
    """
    with open_media(path) as container:
        if not container.streams.audio:
            raise InputError(
                f"{path} has no sound", expected="an audio stream", remedy="Record with sound, or give manual offsets"
            )
        stream = container.streams.audio[0]
        rate, end_s = stream.rate, _announced_end_s(stream)
        try:
            blocks = [(float(frame.pts * frame.time_base), _mono(frame)) for frame in container.decode(stream)]
        except av.error.FFmpegError as error:
            raise InputError(f"{path}: sound does not decode ({error})", expected="whole sound", remedy=COPY_AGAIN) from error
    if not blocks:
        raise InputError(
            f"{path} holds an empty sound stream", expected="sound", remedy="Record with sound, or give manual offsets"
        )
    samples, start_s = _lay_out(blocks, rate)
    if end_s is not None:  # the last block of a lossy codec is padded beyond the recording's end
        samples = samples[: max(round((end_s - start_s) * rate), 1)]
    if rate_hz is not None and rate_hz != rate:
        # takes a second to import, and few recordings need it
        from scipy.signal import resample_poly

        ratio = Fraction(rate_hz, rate)
        samples, rate = resample_poly(samples, ratio.numerator, ratio.denominator).astype(np.float32), rate_hz
    return samples, rate, start_s


def _announced_end_s(stream: av.AudioStream) -> float | None:
    """Own time at which the stream says that it ends, or None where it does not say."""
    if stream.duration is None:
        return None
    return float(((stream.start_time or 0) + stream.duration) * stream.time_base)


def _mono(frame: av.AudioFrame) -> NDArray[np.float32]:
    """All channels' mean, -1 to 1."""
    samples = frame.to_ndarray()
    if np.issubdtype(samples.dtype, np.integer):
        info = np.iinfo(samples.dtype)
        middle = 128 if samples.dtype == np.uint8 else 0
        samples = (samples.astype(np.float32) - middle) / (-float(info.min) or 128.0)
    if not frame.format.is_planar:
        samples = samples.reshape(-1, len(frame.layout.channels)).T
    return samples.astype(np.float32).mean(axis=0)


def _lay_out(blocks: list[tuple[float, NDArray[np.float32]]], rate: int) -> tuple[NDArray[np.float32], float]:
    """Place blocks at their times; a step of less than a millisecond is rounding of the times and is closed."""
    start_s = blocks[0][0]
    places, cursor = [], 0
    for time_s, block in blocks:
        wanted = round((time_s - start_s) * rate)
        cursor = wanted if abs(wanted - cursor) > rate / 1000 else cursor
        places.append(cursor)
        cursor += len(block)
    samples = np.zeros(max(p + len(b) for p, (_, b) in zip(places, blocks, strict=True)), np.float32)
    for place, (_, block) in zip(places, blocks, strict=True):
        if place >= 0:
            samples[place : place + len(block)] = block
    return samples, start_s
