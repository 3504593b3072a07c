"""How loud a recording's speech is, whatever pauses and claps it holds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.speech.framing import FRAME_SAMPLES

NOMINAL_LEVEL = 0.1
"""Root mean square of active speech where it was not measured: 20 dB below full scale, the usual recording level."""
_ACTIVE_BELOW_LOUD_DB = 30.0  # the range of running speech
_FAINTEST = 1e-3  # 60 dB below full scale; fainter speech drowns in the steps of 16 bit


def speech_level(samples: NDArray) -> float:
    """Root mean square of the active speech in samples (n,), full scale 1; at least 1e-3.

    The median power of the 16 ms frames that are less than 30 dB below the 95th percentile: neither pauses nor a clap
    move it, where a peak or a mean would follow the clap. Karras et al. 2017 (the paper's preprocessing) scale by the
    peak. Raises `InputError` for samples that are no numbers.
    """
    samples = check_samples(samples)
    whole = len(samples) // FRAME_SAMPLES * FRAME_SAMPLES
    if whole == 0:
        return max(float(np.std(samples)) if len(samples) else 0.0, _FAINTEST)
    powers = samples[:whole].reshape(-1, FRAME_SAMPLES).var(axis=1, dtype=np.float64)
    active = powers[powers >= np.quantile(powers, 0.95) * 10 ** (-_ACTIVE_BELOW_LOUD_DB / 10)]
    return max(float(np.sqrt(np.median(active))), _FAINTEST)


def check_samples(samples: NDArray) -> NDArray:
    """The samples as an array (n,); raises `InputError` where they are not mono, not finite, or integers of unknown scale."""
    samples = np.asarray(samples)
    if samples.ndim != 1:
        raise InputError(
            f"sound of shape {samples.shape}", expected="mono samples (n,)", remedy="Read recordings with read_speech"
        )
    if not np.issubdtype(samples.dtype, np.floating):
        raise InputError(
            f"sound samples of type {samples.dtype}",
            expected="floating point numbers, full scale 1",
            remedy="Divide integers by their range",
        )
    bad = np.count_nonzero(~np.isfinite(samples))
    if bad:
        first = int(np.flatnonzero(~np.isfinite(samples))[0])
        raise InputError(
            f"{bad} of {len(samples)} sound samples are no numbers, the first is sample {first}",
            expected="finite samples",
            remedy="Export the sound again",
        )
    return samples
