"""Where the larynx is in each frame: tau by normalised cross-correlation, alpha by least squares (section 5.2, eq. 12, 13)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from headcap.neck.larynx.larynx_map import LarynxMap


class SlideSettings(BaseModel):
    """The search for tau."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    reach_up_mm: float = Field(25.0, gt=0, description="How far the larynx may rise: a swallow lifts it by 20 to 25 mm")
    reach_down_mm: float = Field(15.0, gt=0, description="How far it may sink")
    step_mm: float = Field(0.5, gt=0, description="Step of the search; the maximum is then found between steps")


@dataclass(frozen=True, eq=False)
class Nuisance:
    """Other motion of the throat that a frame may show besides the larynx's; it is solved for together with tau and alpha.

    Rows of the basis are orthonormal over all that the frame shows, of which the throat along t_s is a part.
    """

    throat: NDArray[np.float64]
    """(q, k) the basis on the larynx region, along t_s."""
    weights: NDArray[np.float64]
    """(f, q) each frame's product with the whole basis."""

    @classmethod
    def smooth(cls, along: NDArray, larynx: LarynxMap) -> Nuisance:
        """Polynomials of second order over the chart: what a throat does by and large, for offsets along t_s (f, k)."""
        u, v = (1e2 * (larynx.uv_m - larynx.uv_m.mean(axis=0))).T
        basis = np.linalg.qr(np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1))[0].T
        return cls(basis, along @ basis.T)


def slide_and_scale(
    offsets: NDArray,
    larynx: LarynxMap,
    settings: SlideSettings,
    nuisance: Nuisance | None = None,
    before: NDArray | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """tau (f,) metres and alpha (f,) of a throat's offsets from its base (f, k, 3) by eq. 12 and 13.

    The paper subtracts the speech blendshapes as the step before left them (eq. 11). Here every slide is tried with the best
    weights of the `nuisance` blendshapes: they are projected out of offsets and map alike, so that fitting a trained model takes
    one step instead of several. The correlation is taken without subtracting means. It is then largest exactly where least
    squares over alpha and weights leave least, and the step never raises the energy. `before` holds earlier taus (f,), kept where
    they explain more. A frame that no slide explains with a positive alpha gets alpha = 0.
    """
    along = np.asarray(offsets, float) @ larynx.direction
    nuisance = nuisance or Nuisance(np.zeros((0, along.shape[1])), np.zeros((len(along), 0)))
    search = _Search(along, larynx, nuisance)
    tau = search.best_slide(settings)
    if before is not None:
        tau = np.where(search.explained(before) > search.explained(tau), before, tau)
    return tau, search.scale(tau)


@dataclass(frozen=True, eq=False)
class _Search:
    along: NDArray
    larynx: LarynxMap
    nuisance: Nuisance

    def best_slide(self, settings: SlideSettings) -> NDArray[np.float64]:
        """tau (f,) of the largest correlation, to a fraction of a step."""
        step = 1e-3 * settings.step_mm
        low, high = -np.ceil(1e-3 * settings.reach_down_mm / step), np.ceil(1e-3 * settings.reach_up_mm / step)
        slides = np.arange(low, high + 1) * step
        weights, _ = self.larynx.weights_at(slides)
        carried = weights @ self.nuisance.throat.T
        length = np.sqrt(_left(weights, carried))
        score = (self.along @ weights.T - self.nuisance.weights @ carried.T) / length
        best = np.clip(score.argmax(axis=1), 1, len(slides) - 2)
        at = slides[best]
        between = at + step * _peak(*(score[np.arange(len(score)), best + k] for k in (-1, 0, 1)))
        # a parabola through three correlations may lie: the step itself stays where it explains more
        return np.where(self.explained(between) >= self.explained(at), between, at)

    def explained(self, tau: NDArray) -> NDArray[np.float64]:
        """(f,) by how much the best alpha >= 0 lowers the squared error."""
        product, left = self._products(tau)
        return product**2 / left

    def scale(self, tau: NDArray) -> NDArray[np.float64]:
        """alpha (f,) of eq. 13."""
        product, left = self._products(tau)
        return product / left

    def _products(self, tau: NDArray) -> tuple[NDArray, NDArray]:
        weights, _ = self.larynx.weights_at(tau)
        carried = weights @ self.nuisance.throat.T
        product = np.einsum("fk,fk->f", self.along, weights) - np.einsum("fq,fq->f", self.nuisance.weights, carried)
        return np.maximum(product, 0.0), _left(weights, carried)


LEAST_LEFT = 0.02
"""Share of a weight map's energy that blendshapes must leave to it: below it the larynx could not be told from them."""


def _left(weights: NDArray, carried: NDArray) -> NDArray[np.float64]:
    """(f,) squared length of the weights (f, k) outside the nuisance blendshapes."""
    whole = np.einsum("fk,fk->f", weights, weights)
    return np.maximum(whole - np.einsum("fq,fq->f", carried, carried), LEAST_LEFT * whole + 1e-18)


def _peak(low: NDArray, middle: NDArray, high: NDArray) -> NDArray[np.float64]:
    """Where a parabola through three equidistant values is largest, in steps from the middle one."""
    bend = low - 2 * middle + high
    return np.where(bend < 0, np.clip(0.5 * (low - high) / np.where(bend < 0, bend, 1.0), -1, 1), 0.0)
