"""Delay between two sounds by generalised cross-correlation with phase transform (Knapp and Carter 1976)."""

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

# a frequency this far under the strongest carries no phase worth counting
FLOOR = 1e-3
# weight of lags far from those expected
FAR_LAGS = 0.3


@dataclass(frozen=True)
class Delay:
    """How much later the second sound is than the first."""

    lag_s: float
    sharpness: float
    """0 to 1: height of the peak, 1 for two shifted copies."""


def spectrum(samples: NDArray, size: int) -> NDArray[np.complex128]:
    """Spectrum zero-padded to `size`."""
    return scipy.fft.rfft(np.asarray(samples, np.float64), size)


def gcc_phat(
    first: NDArray, second: NDArray, rate_hz: int, *, max_lag_s: float, band_hz: tuple[float, float], upsampling: int = 8
) -> Delay:
    """Delay of `second` behind `first`, both mono and of one rate; sub-sample by upsampling and a parabola."""
    size = scipy.fft.next_fast_len(len(first) + len(second), real=True)
    spectra = spectrum(first, size), spectrum(second, size)
    return delay_of_spectra(*spectra, size, rate_hz, max_lag_s=max_lag_s, band_hz=band_hz, upsampling=upsampling)


def delay_of_spectra(
    first: NDArray,
    second: NDArray,
    size: int,
    rate_hz: int,
    *,
    max_lag_s: float,
    band_hz: tuple[float, float],
    upsampling: int = 8,
    expected_within_s: float | None = None,
) -> Delay:
    """`gcc_phat` of spectra made by `spectrum(..., size)`, so that all pairs of many sounds share them.

    `expected_within_s` favours lags near zero: a peak much farther off (an echo, where the direct sound is weak) must be
    several times as high to be taken.
    """
    frequency_hz = scipy.fft.rfftfreq(size, 1 / rate_hz)
    inside = (frequency_hz >= band_hz[0]) & (frequency_hz <= min(band_hz[1], 0.45 * rate_hz))
    cross = second * first.conj()
    magnitude = np.abs(cross)
    weight = inside / (magnitude + FLOOR * magnitude[inside].max(initial=0.0) + 1e-30)
    phases = cross * weight
    # the integral over all frequencies is the height of the peak that a perfect copy would have
    correlation = scipy.fft.irfft(phases, size * upsampling) * upsampling * size / (2 * max(inside.sum(), 1))
    step_s = 1 / (rate_hz * upsampling)
    reach = min(round(max_lag_s / step_s), len(correlation) // 2 - 1)
    around = np.concatenate([correlation[-reach:], correlation[: reach + 1]])
    favour = 1.0
    if expected_within_s is not None:
        lags_s = step_s * np.arange(-reach, reach + 1)
        favour = FAR_LAGS + (1 - FAR_LAGS) * np.exp(-0.5 * (lags_s / expected_within_s) ** 2)
    peak = int((around * favour).argmax())
    lag = peak - reach + _parabola(around, peak)
    return Delay(float(lag * step_s), float(np.clip(around[peak], 0, 1)))


def _parabola(values: NDArray, peak: int) -> float:
    """Offset of the maximum of the parabola through a peak and its neighbours, -0.5 to 0.5."""
    if not 0 < peak < len(values) - 1:
        return 0.0
    left, middle, right = values[peak - 1 : peak + 2]
    bend = left - 2 * middle + right
    return float(0.5 * (left - right) / bend) if bend < 0 else 0.0
