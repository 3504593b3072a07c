"""Which audio frames belong to a visual frame: 64 frames of 256 samples at hop 128, centred on the picture's moment."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from headcap.errors import InputError

RATE_HZ = 16000
"""Rate of all sound in this room."""
FRAME_SAMPLES = 256
HOP_SAMPLES = 128
CONTEXT_FRAMES = 64
"""Audio frames of one visual frame, t-32 ... t+31 in the paper's eq. 21."""
CONTEXT_SAMPLES = (CONTEXT_FRAMES - 1) * HOP_SAMPLES + FRAME_SAMPLES
"""8320 samples, 520 ms."""


def visual_centres(n_frames: int, fps: float, *, start_s: float = 0.0, first: int = 0) -> NDArray[np.int64]:
    """Sample on which each visual frame is centred (n_frames,): rint((start_s + n / fps) 16000), n = first, first + 1, ...

    Rounded from n and never accumulated, so a long take does not drift. `start_s` is the moment of frame 0 on the sound's
    clock, whose zero is its first sample. Raises `InputError` for a rate that is not positive.
    """
    if not fps > 0:
        raise InputError(f"{fps} visual frames per second", expected="a positive rate", remedy="Give the take's frame rate")
    numbers = np.arange(first, first + n_frames)
    return np.rint(start_s * RATE_HZ + numbers * (RATE_HZ / fps)).astype(np.int64)


def centres_at(times_s: ArrayLike) -> NDArray[np.int64]:
    """Sample on which each visual frame is centred (n,), for moments on the sound's clock (cameras drop frames)."""
    return np.rint(np.asarray(times_s, np.float64) * RATE_HZ).astype(np.int64)


def frame_starts(centres: NDArray[np.int64]) -> NDArray[np.int64]:
    """First sample of each audio frame of each visual frame (n, 64): centre - 4160 + 128 i (paper section 6.1, 520 ms)."""
    return np.asarray(centres)[:, None] - CONTEXT_SAMPLES // 2 + HOP_SAMPLES * np.arange(CONTEXT_FRAMES)
