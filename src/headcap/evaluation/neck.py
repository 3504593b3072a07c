"""A fitted larynx against the true one."""

import numpy as np
from numpy.typing import NDArray

from headcap.neck.fits import TakeFit


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
