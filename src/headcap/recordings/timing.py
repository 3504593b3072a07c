"""What a recording's frame times tell: dropped frames, gaps, a rate that varies."""

from dataclasses import dataclass

import numpy as np

from headcap.recordings.probe import Recording


@dataclass(frozen=True)
class Gap:
    """Frames that were not recorded, between two that were."""

    after_frame: int
    time_s: float
    """Own time of the frame before the gap."""
    missing_frames: int


@dataclass(frozen=True)
class Timing:
    """How regular a recording's frames are."""

    gaps: tuple[Gap, ...]
    jitter_ms: float
    """Rms distance of frame times from the recording's own regular grid, the container's rounding included."""
    variable_rate: bool
    """The intervals fit no grid: more than a tenth of them are off a whole number of steps by over a tenth."""

    @property
    def missing_frames(self) -> int:
        """Dropped frames in all."""
        return sum(gap.missing_frames for gap in self.gaps)


def timing(recording: Recording) -> Timing:
    """Find gaps and jitter in a recording's frame times, which stay the truth about each frame."""
    times = np.array(recording.frame_times_s)
    steps = np.diff(times) * recording.rate_hz
    off_grid = np.abs(steps - np.rint(steps)) > 0.1
    variable = bool(off_grid.mean() > 0.1)
    # where the rate varies a long interval is not a dropped frame unless it is twice the usual one
    missing = np.maximum(np.floor(steps + (0.0 if variable else 0.5)).astype(int) - 1, 0)
    gaps = tuple(Gap(int(i), float(times[i]), int(missing[i])) for i in np.flatnonzero(missing))
    numbers = np.concatenate([[0], np.cumsum(missing + 1)])
    residual = times - np.polyval(np.polyfit(numbers, times, 1), numbers)
    return Timing(gaps, 1e3 * float(np.sqrt(np.mean(residual**2))), variable)
