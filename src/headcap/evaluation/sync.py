"""Start times against the true ones, and the shift between the two clocks."""

from collections.abc import Mapping

import numpy as np

from headcap.errors import InputError
from headcap.sync.offsets import TimeOffsets


def offset_error_ms(offsets: TimeOffsets, true_start_s: Mapping[str, float]) -> float:
    """`sync.offset_error_ms`: rms over cameras of estimated minus true start time, the common mean taken out."""
    differences = _start_differences_s(offsets, true_start_s)
    return float(1e3 * np.std(differences))


def clock_shift_s(offsets: TimeOffsets, true_start_s: Mapping[str, float]) -> float:
    """Seconds the estimated common clock runs ahead of the true one: mean over cameras of estimated minus true start.

    True time of a moment on the common clock is that moment minus this shift: nothing of the image or of the result enters.
    """
    return float(np.mean(_start_differences_s(offsets, true_start_s)))


def _start_differences_s(offsets: TimeOffsets, true_start_s: Mapping[str, float]) -> np.ndarray:
    missing = sorted(set(offsets.cameras) - set(true_start_s))
    if missing:
        raise InputError(
            f"the truth knows no camera {', '.join(missing)}",
            expected=f"cameras among {', '.join(sorted(true_start_s))}",
            remedy="Name the cameras of the session as the truth folder does (cam00, cam01, ... where it names none).",
        )
    starts = dict(zip(offsets.cameras, offsets.start_s, strict=True))
    return np.array([starts[camera] - true_start_s[camera] for camera in offsets.cameras])
