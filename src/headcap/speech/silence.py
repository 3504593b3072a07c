"""A person's coefficients in silence, which differ between people and which no voice can tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from headcap.speech.regressor import SpeechCoefficients
from headcap.speech.training import SpeechTake

LEAST_PAUSES = 5
"""Visual frames of a pause from which silence is taken: a sixth of a second."""


@dataclass(frozen=True, eq=False)
class Silence:
    """Coefficients of a silent person."""

    phi: NDArray[np.float64]
    """(k,)"""
    tau: float
    alpha: float

    @classmethod
    def of(cls, takes: Sequence[SpeechTake]) -> Silence | None:
        """The median over the fitted frames of a person's takes that hear a pause; None where there are fewer than five."""
        rows = [np.column_stack([take.coefficients.phi, take.larynx])[take.features.pauses] for take in takes]
        rows = np.concatenate(rows)
        rows = rows[np.isfinite(rows).all(axis=1)]
        if len(rows) < LEAST_PAUSES:
            return None
        *phi, tau, alpha = np.median(rows, axis=0)
        return cls(np.array(phi), float(tau), float(alpha))

    def removed_from(self, take: SpeechTake) -> SpeechTake:
        """The take as if the person were in silence what the neutral head is: phi = 0, tau = 0, alpha = 1 (eq. 1)."""
        own = take.coefficients
        return replace(take, coefficients=SpeechCoefficients(own.phi - self.phi, own.tau - self.tau, own.alpha - self.alpha + 1))
