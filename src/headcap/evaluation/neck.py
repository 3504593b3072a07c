"""A fitted larynx against the true one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.evaluation.sync import clock_shift_s
from headcap.evaluation.truth import Truth
from headcap.neck.fits import TakeFit
from headcap.sync.offsets import TimeOffsets


def larynx_correlation(fit: TakeFit, time_s: NDArray, height_m: NDArray, *, clock_shift_s: float) -> float:
    """Pearson correlation of the fitted slide tau with the true larynx's height (t,) over a take; NaN where either is still.

    `time_s` (t,) is on the true clock, of which the take's common clock runs `clock_shift_s` ahead.
    """
    known = fit.speech.known
    tau = fit.speech.tau_m[known]
    true_m = np.interp(fit.time_s[known] - clock_shift_s, time_s, height_m)
    if len(tau) < 3 or np.std(tau) == 0 or np.std(true_m) == 0:
        return float("nan")
    return float(np.corrcoef(tau, true_m)[0, 1])


@dataclass(frozen=True, eq=False)
class LarynxCurve:
    """The true larynx's height in a take."""

    time_s: NDArray[np.float64]
    """(t,) on the true clock."""
    height_m: NDArray[np.float64]
    """(t,) upwards."""
    clock_shift_s: float = 0.0
    """By how much the take's common clock runs ahead of the true one."""


@dataclass(frozen=True)
class LarynxFile:
    """Where the truth about a person's larynx in a take lies: in a session's truth folder, or in a file of its own."""

    person: str
    take: str
    heights: Path | None = None
    """npz of `time_s` and `larynx_dy_m`, on the take's own clock."""
    truth: Path | None = None
    """A truth folder, whose clock is another one."""
    offsets: Path | None = None
    """Start times of the take, to tell one clock from the other."""

    def load(self) -> LarynxCurve | None:
        """The curve; None where the truth holds none of this take."""
        if self.heights is not None:
            with np.load(self.heights, allow_pickle=False) as arrays:
                return LarynxCurve(arrays["time_s"].astype(float), arrays["larynx_dy_m"].astype(float))
        truth = Truth(self.truth)
        height = truth.larynx_height(self.take) if self.take in truth.takes else None
        if height is None:
            return None
        return LarynxCurve(*height, clock_shift_s(TimeOffsets.load(self.offsets), truth.start_s(self.take)))
