"""Ridge regression of many outputs (eq. 25), its penalty by cross-validation over takes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.lapack import dpstrf

from headcap.errors import InputError
from headcap.speech.moments import Moments, pooled
from headcap.speech.settings import RidgeSettings


@dataclass(frozen=True)
class RidgeForm:
    """Which ridge regression."""

    bias: bool
    """A constant per output, not penalised; the paper has one for tau and alpha and none for phi (eq. 24)."""
    standardise: bool
    """Inputs are penalised in units of their deviations; the paper penalises them as they are."""
    penalty: Literal["common", "own", "leaning"]
    """One lambda for all of a regressor's outputs, as the paper has; one for each output; or one for each that leans on the
    others: chosen by the output's own error plus the mean of all outputs', each as a share of predicting the mean. An
    output's own curve, from a handful of takes, is noisy, and outputs of one set of inputs want like penalties."""


PAPER_SPEECH = RidgeForm(bias=False, standardise=False, penalty="common")
"""R_b, eq. 24 and 25."""
PAPER_LARYNX = RidgeForm(bias=True, standardise=False, penalty="own")
"""R_tau and R_alpha, two regressors and so two penalties (eq. 22, 23)."""
IMPROVED = RidgeForm(bias=True, standardise=True, penalty="leaning")
IMPROVED_LARYNX = RidgeForm(bias=True, standardise=True, penalty="own")
"""tau and alpha are no set of like outputs: a voice may tell the one and not the other."""


_FEW_FRAMES = 0.6
"""Frames for each input up to which it is quicker to work in what they span."""


@dataclass(frozen=True)
class LinearMap:
    """x -> x weights + bias."""

    weights: NDArray[np.float64]
    """(p, q)"""
    bias: NDArray[np.float64]
    """(q,)"""
    penalties: NDArray[np.float64]
    """(q,) multiples of the inputs' mean power, see `RidgeSettings`; infinite where the mean alone is predicted."""
    mean: NDArray[np.float64]
    """(q,) mean of the outputs it was trained on."""

    def __call__(self, inputs: NDArray) -> NDArray[np.float64]:
        """Outputs (n, q) of inputs (n, p)."""
        return np.asarray(inputs, np.float64) @ self.weights + self.bias


@dataclass(frozen=True)
class HeldOut:
    """Errors on takes that were left out of everything, the choice of the penalty included."""

    squared_error: NDArray[np.float64]
    """(takes, q) sums over frames."""
    squared_error_of_mean: NDArray[np.float64]
    """(takes, q) the same of predicting the training takes' mean."""
    frames: NDArray[np.int64]
    """(takes,)"""
    penalties: NDArray[np.float64]
    """(takes, q)"""

    @property
    def r_squared(self) -> NDArray[np.float64]:
        """1 - error / error of predicting the mean, all takes together (q,)."""
        return 1 - self.squared_error.sum(axis=0) / self.squared_error_of_mean.sum(axis=0)


Units = Sequence[Sequence[Moments]]
"""What is left out together, each in the parts by which penalties may be chosen within it."""


def few_coordinates(units: Units, form: RidgeForm) -> tuple[Units, Callable[[LinearMap], LinearMap]]:
    """Units of fewer frames than inputs in coordinates of what their inputs span, and how maps of these come back.

    Weights of least |R| lie in the span of the frames (eq. 25 asks for no others), so that no regression of any of them needs
    more: of 450 frames with 2,048 inputs all regressions of a cross-validation cost a tenth. Units are returned as they are where
    nothing is gained, or inputs are to be standardised.
    """
    parts = [part for unit in units for part in unit]
    if form.standardise or sum(part.frames for part in parts) > _FEW_FRAMES * parts[0].inputs:
        return units, lambda found: found
    gram, _ = pooled(parts).gram(centred=False)
    factor, order, rank, _ = dpstrf(gram, lower=1)
    tall = np.empty((len(gram), rank))
    tall[order - 1] = np.tril(factor[:, :rank])
    directions = np.linalg.qr(tall)[0]
    within = [[part.within(directions) for part in unit] for unit in units]
    return within, lambda found: replace(found, weights=directions @ found.weights)


def fit(moments: Moments, form: RidgeForm, penalties: NDArray | float) -> LinearMap:
    """The ridge regression of given penalties, one for all outputs or one for each (q,).

    argmin over R of sum_i |x_i R + bias - y_i|^2 + lambda |R|^2 (eq. 25), lambda = penalty tr(X^T X) / p, from the normal
    equations by Cholesky. A column that never varies (pitch of a take without voice) gets the weight 0.
    """
    penalties = np.broadcast_to(np.asarray(penalties, np.float64), moments.outputs)
    weights = np.empty((moments.inputs, moments.outputs))
    for penalty, found in zip(*_path(moments, form, np.unique(penalties)), strict=True):
        chosen = penalties == penalty
        weights[:, chosen] = found[:, chosen]
    return LinearMap(weights, _bias(moments, form, weights), penalties.copy(), moments.mean[moments.inputs :].copy())


def cross_validated(takes: Sequence[Moments], form: RidgeForm, settings: RidgeSettings | None = None) -> LinearMap:
    """The ridge regression of all takes with the penalty that errs least on takes left out one at a time.

    Raises `InputError` for fewer than two takes.
    """
    penalties = np.array((settings or RidgeSettings()).penalties)
    return fit(pooled(takes), form, _choose(fold_errors(takes, form, penalties).sum(axis=0), form, penalties))


def fold_errors(takes: Sequence[Moments], form: RidgeForm, penalties: NDArray[np.float64]) -> NDArray[np.float64]:
    """Squared error on each take of the regression of all others, (takes, penalties + 1, q).

    The last row is the error of predicting the others' mean. Raises `InputError` for fewer than two takes.
    """
    _need(takes, 2, "cross-validation over takes")
    return np.array([_errors(_others(takes, k), [takes[k]], form, penalties)[0] for k in range(len(takes))])


def held_out(takes: Sequence[Moments], form: RidgeForm, settings: RidgeSettings | None = None) -> HeldOut:
    """Errors on each take of `cross_validated` of all others. Raises `InputError` for fewer than three takes."""
    _need(takes, 3, "errors on held-out takes with a penalty from the others")
    maps = left_out_maps([[take] for take in takes], form, settings)
    none = np.zeros((takes[0].inputs, takes[0].outputs))
    return HeldOut(
        np.array([take.squared_error(found.weights, found.bias) for take, found in zip(takes, maps, strict=True)]),
        np.array([take.squared_error(none, found.mean) for take, found in zip(takes, maps, strict=True)]),
        np.array([take.frames for take in takes]),
        np.array([found.penalties for found in maps]),
    )


def left_out_maps(units: Sequence[Sequence[Moments]], form: RidgeForm, settings: RidgeSettings | None = None) -> list[LinearMap]:
    """For each unit, which is the parts of a person or a take alone, the ridge regression of all others.

    Penalties are chosen by leaving one of the others out, so that the unit has no part in them; leaving i and j out serves i's
    choice and j's alike. Of two units the other has the parts to leave out. Raises `InputError` for one unit, or two of which one
    has a single part.
    """
    _need(units, 2, "regressors that leave one out")
    if len(units) == 2:
        return [cross_validated(units[1 - k], form, settings) for k in range(2)]
    whole = [pooled(unit) for unit in units]
    penalties = np.array((settings or RidgeSettings()).penalties)
    curves = np.zeros((len(whole), len(penalties) + 1, whole[0].outputs))
    for i, j in combinations(range(len(whole)), 2):
        on_i, on_j = _errors(_others(whole, i, j), [whole[i], whole[j]], form, penalties)
        curves[i] += on_j
        curves[j] += on_i
    return [fit(_others(whole, k), form, _choose(curves[k], form, penalties)) for k in range(len(whole))]


def _path(moments: Moments, form: RidgeForm, penalties: NDArray) -> tuple[NDArray, list[NDArray]]:
    """Weights (p, q) for each penalty."""
    gram, cross = moments.gram(centred=form.bias)
    power = np.diag(gram)
    scale = np.sqrt(power / moments.frames) if form.standardise else np.ones(len(power))
    # what rounding leaves of a constant column is no information
    varies = power > 1e-12 * moments.frames * (1e-12 + moments.mean[: moments.inputs] ** 2)
    scale = np.where(varies, scale, np.inf) if form.standardise else np.where(varies, 1.0, np.inf)
    gram, cross = gram / scale[:, None] / scale, cross / scale[:, None]
    unit = np.trace(gram) / (moments.dimensions or len(gram)) or 1.0
    found = []
    for penalty in penalties:
        if np.isinf(penalty):
            found.append(np.zeros_like(cross))
            continue
        shifted = gram.copy()
        shifted.flat[:: len(gram) + 1] += penalty * unit
        found.append(cho_solve(cho_factor(shifted, overwrite_a=True, check_finite=False), cross) / scale[:, None])
    return penalties, found


def _bias(moments: Moments, form: RidgeForm, weights: NDArray) -> NDArray[np.float64]:
    if not form.bias:
        return np.zeros(moments.outputs)
    return moments.mean[moments.inputs :] - moments.mean[: moments.inputs] @ weights


def _errors(training: Moments, tests: Sequence[Moments], form: RidgeForm, penalties: NDArray) -> NDArray[np.float64]:
    """Squared errors (tests, penalties + 1, q); the last row predicts the training mean."""
    _, path = _path(training, form, penalties)
    maps = [(weights, _bias(training, form, weights)) for weights in path]
    maps.append((np.zeros_like(path[0]), training.mean[training.inputs :]))
    return np.array([[test.squared_error(weights, bias) for weights, bias in maps] for test in tests])


def _choose(curve: NDArray, form: RidgeForm, penalties: NDArray) -> NDArray[np.float64]:
    """Penalty of each output (q,) from errors (penalties + 1, q), the last row those of predicting the mean.

    A common one minimises the sum of errors, as eq. 25 weighs outputs. Infinite where the mean errs least: what inputs do not
    tell is then not made up from noise.
    """
    errors, of_mean = curve[:-1], curve[-1]
    if form.bias:  # the mean is what an infinite penalty leaves
        errors, penalties = curve, np.append(penalties, np.inf)
    if form.penalty == "common":
        return np.full(errors.shape[1], penalties[errors.sum(axis=1).argmin()])
    if form.penalty == "leaning":
        shares = errors / np.where(of_mean > 0, of_mean, 1.0)
        errors = shares + shares.mean(axis=1, keepdims=True)
    return penalties[errors.argmin(axis=0)]


def _others(takes: Sequence[Moments], *left_out: int) -> Moments:
    return pooled([take for k, take in enumerate(takes) if k not in left_out])


def _need(takes: Sequence[Moments], least: int, purpose: str) -> None:
    if len(takes) < least:
        raise InputError(
            f"{len(takes)} take{'' if len(takes) == 1 else 's'} for {purpose}",
            expected=f"at least {least}",
            remedy="Record more takes, or give stretches of one as takes",
        )
