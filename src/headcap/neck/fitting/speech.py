"""Larynx and speech coefficients of a person's meshes under a trained model (section 5.2, "Details": eq. 12, 13, 20)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.heads import HeadModel
from headcap.neck.larynx.coefficients import Nuisance, SlideSettings, slide_and_scale
from headcap.neck.larynx.larynx_map import LarynxMap
from headcap.neck.model import NeckPerson

LEAST_REST_ALPHA = 0.05
"""A neutral head that shows less of the larynx than this cannot set its scale."""


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

    def __init__(
        self,
        head: HeadModel,
        person: NeckPerson,
        settings: SlideSettings | None = None,
        seen: NDArray[np.bool_] | None = None,
    ) -> None:
        """Of one person; `seen` (n,) masks the vertices that cameras saw: the others tell nothing, neither of phi nor of tau.

        Blendshapes, or mixtures of them, that show nearly nothing (a hundredth) of themselves where it was seen stay at rest.
        Raises `InputError` for a mask of another length.
        """
        person.larynx.check(head)
        self.person, self.settings = person, settings or SlideSettings()
        self._seen = checked_mask(seen, len(head.vertices))
        self.larynx = seen_larynx(person.larynx, self._seen)
        self.rows, self.turn = seen_directions(np.asarray(head.speech_basis, float), self._seen)
        self._throat_basis = np.asarray(head.speech_basis[:, person.larynx.vertices], float)
        inside = self.rows.reshape(len(self.rows), len(head.vertices), 3)[:, person.larynx.vertices]
        self.inside, self.along = inside.reshape(len(self.rows), 3 * inside.shape[1]), inside @ person.larynx.direction

    def fit(self, meshes: NDArray) -> SpeechFit:
        """Coefficients of meshes (f, n, 3) in metres, at rest, free of pose and expression (eq. 7).

        They minimise the squared distance over the seen vertices: tau and alpha by eq. 12 and 13 with phi solved for along with
        them, then phi by eq. 20. A frame with a vertex that is not finite, seen or not, gives NaN.
        """
        fine = self._finite(meshes)
        offsets = np.asarray(meshes[fine], float) - self.person.base
        spoken = offsets.reshape(len(offsets), -1) @ self.rows.T
        nuisance = Nuisance(self.along, spoken)
        tau, alpha = slide_and_scale(offsets[:, self.larynx.vertices], self.larynx, self.settings, nuisance)
        phi = self._weights(spoken, tau, alpha)
        return SpeechFit(*(spread(values, fine) for values in (tau, alpha, phi)))

    def fit_larynx(self, meshes: NDArray, phi: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """tau (f,) and alpha (f,) of meshes as in `fit` where phi (f, p) is known (eq. 11 to 13)."""
        fine = self._finite(meshes)
        offsets = np.asarray(meshes[fine], float)[:, self.larynx.vertices] - self.person.base[self.larynx.vertices]
        offsets -= np.tensordot(phi[fine], self._throat_basis, axes=1)
        tau, alpha = slide_and_scale(offsets, self.larynx, self.settings)
        return spread(tau, fine), spread(alpha, fine)

    def fit_weights(self, meshes: NDArray, tau_m: NDArray, alpha: NDArray) -> NDArray[np.float64]:
        """phi (f, p) of meshes as in `fit` where tau and alpha (f,) are known (eq. 20)."""
        fine = self._finite(meshes)
        offsets = np.asarray(meshes[fine], float) - self.person.base
        spoken = offsets.reshape(len(offsets), -1) @ self.rows.T
        return spread(self._weights(spoken, tau_m[fine], alpha[fine]), fine)

    def _finite(self, meshes: NDArray) -> NDArray[np.bool_]:
        base = self.person.base
        if meshes.ndim != 3 or meshes.shape[1:] != base.shape:
            raise InputError(f"meshes {meshes.shape}", expected=f"(frames, {len(base)}, 3)", remedy="Use the model's topology.")
        return np.isfinite(meshes).all(axis=(1, 2))

    def _weights(self, spoken: NDArray, tau: NDArray, alpha: NDArray) -> NDArray:
        """phi of eq. 20 from products (f, q) of the offsets with the directions of N."""
        moved = self.larynx.offset(tau, alpha).values.reshape(len(spoken), -1)
        return (spoken - moved @ self.inside.T) @ self.turn


LEAST_SHOWN = 1e-4
"""Share of a blendshape's energy that must lie on seen vertices for its weight to be solved for."""


def seen_directions(basis: NDArray, seen: NDArray[np.bool_] | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Orthonormal rows Q (q, 3 n), zero where nothing was seen, that span blendshapes N (p, n, 3) there, and turn (q, p).

    For a displacement d (3 n,), phi = (Q d) turn is eq. 20 over the seen vertices (of the shortest phi, where several serve).
    Training leaves N orthonormal; a model from elsewhere, or one stored in single precision, may not be, and a part never is.
    """
    p, n = basis.shape[:2]
    if p == 0:
        return np.zeros((0, 3 * n)), np.zeros((0, 0))
    whole = basis.reshape(p, 3 * n)
    shown = whole if seen is None else np.where(seen[:, None], basis, 0.0).reshape(p, 3 * n)
    energy, turn = np.linalg.eigh(shown @ shown.T)
    kept = energy > LEAST_SHOWN * np.einsum("ic,ic->i", whole, whole).max()
    turn = turn[:, kept].T / np.sqrt(energy[kept])[:, None]
    return np.ascontiguousarray(turn @ shown), turn


def seen_larynx(larynx: LarynxMap, seen: NDArray[np.bool_] | None) -> LarynxMap:
    """The larynx as it shows on seen vertices: the window is shut on the others."""
    return larynx if seen is None else replace(larynx, window=np.where(seen[larynx.vertices], larynx.window, 0.0))


def checked_mask(seen: NDArray | None, vertices: int) -> NDArray[np.bool_] | None:
    """A mask of seen vertices (n,), None where all are; raises `InputError` for one of another length or that is empty."""
    if seen is None or (np.shape(seen) == (vertices,) and np.all(seen)):
        return None
    seen = np.asarray(seen, bool)
    if seen.shape != (vertices,) or not seen.any():
        raise InputError(
            f"a mask of seen vertices {seen.shape}, {int(seen.sum())} of them true",
            expected=f"({vertices},), one at least of them true",
            remedy="Pass the mask of this model's template.",
        )
    return seen


def anchored(name: str, neutral: NDArray, base: NDArray, larynx: LarynxMap, settings: SlideSettings) -> tuple[NeckPerson, float]:
    """A person of a larynx model whose neutral head (n, 3) has alpha = 1, as eq. 1 has it, and by what alphas are divided for it.

    `base` (k, 3) is T_0 on L. A neutral head that shows less than `LEAST_REST_ALPHA` of the larynx cannot set its scale.
    """
    whole = np.array(neutral, float)
    rest_alpha = float(slide_and_scale((whole[larynx.vertices] - base)[None], larynx, settings)[1][0])
    scale = rest_alpha if rest_alpha > LEAST_REST_ALPHA else 1.0
    whole[larynx.vertices] = base
    return NeckPerson(name, whole, larynx.with_weights(scale * larynx.weights_m)), scale


def spread(values: NDArray, fine: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Values (k, ...) of the chosen frames among all of them (f, ...); NaN for the others."""
    out = np.full((len(fine), *values.shape[1:]), np.nan)
    out[fine] = values
    return out
