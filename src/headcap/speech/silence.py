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
    larynx: tuple[float, float] | None
    """tau and alpha; None of takes without."""

    @classmethod
    def of(cls, takes: Sequence[SpeechTake]) -> Silence | None:
        """The median over the fitted frames of a person's takes that hear a pause; None where there are fewer than five."""
        rows = np.concatenate([take.columns[take.features.pauses] for take in takes])
        rows = rows[np.isfinite(rows).all(axis=1)]
        if len(rows) < LEAST_PAUSES:
            return None
        found, count = np.median(rows, axis=0), takes[0].coefficients.phi.shape[1]
        return cls(found[:count], (float(found[-2]), float(found[-1])) if len(found) > count else None)

    def removed_from(self, take: SpeechTake) -> SpeechTake:
        """The take as if the person were in silence what the neutral head is: phi = 0, tau = 0, alpha = 1 (eq. 1)."""
        own = take.coefficients
        if self.larynx is None or own.tau is None or own.alpha is None:
            return replace(take, coefficients=SpeechCoefficients(own.phi - self.phi))
        tau, alpha = self.larynx
        return replace(take, coefficients=SpeechCoefficients(own.phi - self.phi, own.tau - tau, own.alpha - alpha + 1))
