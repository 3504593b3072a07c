"""Larynx and speech coefficients of a person's meshes under a trained model (section 5.2, "Details": eq. 12, 13, 20)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.heads import HeadModel
from headcap.neck.larynx_coefficients import Nuisance, SlideSettings, slide_and_scale
from headcap.neck.model import NeckPerson


@dataclass(frozen=True, eq=False)
class SpeechFit:
    """Coefficients of f frames."""

    tau_m: NDArray[np.float64]
    """(f,) metres, upwards; NaN where the frame's mesh was not finite."""
    alpha: NDArray[np.float64]
    """(f,)"""
    phi: NDArray[np.float64]
    """(f, p)"""

    @property
    def known(self) -> NDArray[np.bool_]:
        """(f,) frames that could be fitted."""
        return np.isfinite(self.tau_m)

    def frames(self, chosen: slice) -> SpeechFit:
        """Some of the frames."""
        return SpeechFit(self.tau_m[chosen], self.alpha[chosen], self.phi[chosen])


class SpeechFitter:
    """Fits tau, alpha and phi of one person, all at once: nothing is iterated, every frame stands for itself."""

    def __init__(self, head: HeadModel, person: NeckPerson, settings: SlideSettings | None = None) -> None:
        person.larynx.check(head)
        self.person, self.settings = person, settings or SlideSettings()
        basis = np.asarray(head.speech_basis, float)
        # training leaves N orthonormal; a model from elsewhere, or one stored in single precision, may not be
        self.rows, self.turn = _orthonormal_rows(basis.reshape(len(basis), 3 * basis.shape[1]))
        inside = self.rows.reshape(len(basis), basis.shape[1], 3)[:, person.larynx.vertices]
        self.inside, self.along = inside.reshape(len(basis), 3 * inside.shape[1]), inside @ person.larynx.direction

    def fit(self, meshes: NDArray) -> SpeechFit:
        """Coefficients of meshes (f, n, 3) in metres, at rest, free of pose and expression (eq. 7)."""
        base, larynx = self.person.base, self.person.larynx
        if meshes.ndim != 3 or meshes.shape[1:] != base.shape:
            raise InputError(f"meshes {meshes.shape}", expected=f"(frames, {len(base)}, 3)", remedy="Use the model's topology.")
        fine = np.isfinite(meshes).all(axis=(1, 2))
        offsets = np.asarray(meshes[fine], float) - base
        spoken = offsets.reshape(len(offsets), -1) @ self.rows.T
        tau, alpha = slide_and_scale(offsets[:, larynx.vertices], larynx, self.settings, Nuisance(self.along, spoken))
        moved = larynx.offset(tau, alpha).values.reshape(len(offsets), -1)
        phi = (spoken - moved @ self.inside.T) @ self.turn
        return SpeechFit(*(spread(values, fine) for values in (tau, alpha, phi)))


def _orthonormal_rows(basis: NDArray) -> tuple[NDArray, NDArray]:
    """Orthonormal rows Q (p, c) and R^-1 with which weights of Q become weights of the basis: phi = q @ turn."""
    q, r = np.linalg.qr(basis.T)
    return np.ascontiguousarray(q.T), np.linalg.inv(r).T


def spread(values: NDArray, fine: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Values (k, ...) of the chosen frames among all of them (f, ...); NaN for the others."""
    out = np.full((len(fine), *values.shape[1:]), np.nan)
    out[fine] = values
    return out
