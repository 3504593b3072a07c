"""Training the regressors of one person or of a group, and their errors on other takes (paper sections 6.2, 7.3)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice, pairwise

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.speech.features import FeatureSet, SpeechFeatures
from headcap.speech.moments import Moments, moments_of, pooled
from headcap.speech.regressor import SpeechCoefficients, SpeechRegressor
from headcap.speech.ridge import (
    IMPROVED,
    IMPROVED_LARYNX,
    PAPER_LARYNX,
    PAPER_SPEECH,
    LinearMap,
    RidgeForm,
    Units,
    cross_validated,
    few_coordinates,
    left_out_maps,
)
from headcap.speech.settings import FeatureSettings, RidgeSettings


@dataclass(frozen=True)
class SpeechTake:
    """A take's sound and the coefficients that the neck model was fitted with, visual frame by visual frame."""

    name: str
    features: SpeechFeatures
    coefficients: SpeechCoefficients
    """NaN in frames that were not fitted; those are skipped and counted. Without tau and alpha for a group that trains phi."""

    def __post_init__(self) -> None:
        if len(self.coefficients.phi) != len(self.features):
            raise InputError(
                f"{self.name}: {len(self.coefficients.phi)} frames of coefficients and {len(self.features)} of sound",
                expected="one visual frame for each",
                remedy="Make features at the moments of the fitted frames",
            )

    def part(self, start: int, end: int) -> SpeechTake:
        """Visual frames `start` ... `end` - 1."""
        features = replace(self.features, windows=self.features.windows[start:end], first=self.features.first + start)
        kept = (None if part is None else part[start:end] for part in vars(self.coefficients).values())
        return SpeechTake(f"{self.name} {start}-{end}", features, SpeechCoefficients(*kept))

    @property
    def larynx(self) -> NDArray[np.float64] | None:
        """tau and alpha (n, 2), or None."""
        if self.coefficients.tau is None or self.coefficients.alpha is None:
            return None
        return np.column_stack([self.coefficients.tau, self.coefficients.alpha])

    @property
    def columns(self) -> NDArray[np.float64]:
        """phi beside tau and alpha (n, k + 2), or phi alone."""
        return self.coefficients.phi if self.larynx is None else np.column_stack([self.coefficients.phi, self.larynx])

    @property
    def known(self) -> NDArray[np.bool_]:
        """(n,) frames with all their coefficients."""
        return np.isfinite(self.columns).all(axis=1)


@dataclass(frozen=True)
class SpeechErrors:
    """The paper's table 2, over all frames of some takes, beside predicting the mean of the training takes."""

    frames: int
    skipped: int
    phi: float
    """Mean L2 norm of the difference in phi."""
    phi_of_mean: float
    tau: float | None = None
    """Mean squared difference, in squared units of tau."""
    tau_of_mean: float | None = None
    alpha: float | None = None
    alpha_of_mean: float | None = None


@dataclass(frozen=True)
class TakeMoments:
    """What regressions need of a take's frames; their number does not show in its size."""

    name: str
    features: FeatureSettings
    frames: int
    """Visual frames, those without coefficients included."""
    voiced_share: float
    speech: Moments
    """Filter windows and phi."""
    larynx: Moments | None
    """Source windows, and tau and alpha."""


def take_moments(take: SpeechTake, feature_set: FeatureSet, settings: RidgeSettings) -> TakeMoments:
    """Sums over a take's frames, whose windows are made in blocks; raises `InputError` where no frame has coefficients."""
    speech = _moments(take, take.coefficients.phi, SpeechFeatures.filter_windows, feature_set, settings)
    larynx = None
    if take.larynx is not None:
        larynx = _moments(take, take.larynx, SpeechFeatures.source_windows, feature_set, settings)
    features = take.features
    return TakeMoments(take.name, features.settings, len(features), features.voiced_share, speech, larynx)


def train_speech_regressor(
    takes: Iterable[SpeechTake],
    model_version: str,
    feature_set: FeatureSet = FeatureSet.POOLED,
    *,
    group: str = "",
    settings: RidgeSettings | None = None,
) -> SpeechRegressor:
    """R_b and, where all takes have tau and alpha, R_tau and R_alpha (eq. 21 to 25).

    `takes` are read once and one at a time, windows in blocks, so memory does not grow with frames. With the paper's
    features the regressions are the paper's: phi without bias and with one lambda, tau and alpha with bias; with pooled
    features inputs are standardised, all outputs have a bias and lambdas of their own. Penalties come from leaving takes
    out; a single take is cut into stretches for that, which hear up to 0.26 s of each other. Takes without any voice train
    the larynx on loudness alone, which the figure `voiced_share` shows. Raises `InputError` for no take, takes of different
    coefficients, too few frames.
    """
    settings = settings or RidgeSettings()
    takes = takes_or_stretches(takes, settings.parts_of_one_take)
    units = [[take_moments(take, feature_set, settings)] for take in takes]
    return regressors_of(units, model_version, feature_set, group=group, settings=settings, left_out=False)[0]


def regressors_of(
    units: Sequence[Sequence[TakeMoments]],
    model_version: str,
    feature_set: FeatureSet,
    *,
    group: str = "",
    settings: RidgeSettings | None = None,
    left_out: bool = True,
) -> tuple[SpeechRegressor, list[SpeechRegressor]]:
    """The regressor of all units, each the parts of a person or a take, and for each unit that of all others (eq. 21 to 25).

    Penalties are chosen by leaving units out, the parts of one where only one is trained on; a unit has no part in the
    penalties of its own others. Raises `InputError` for parts of different coefficients, one part alone, or, with `left_out`,
    one unit.
    """
    parts = [part for unit in units for part in unit]
    _check_alike(parts)
    speech_form, larynx_form = (PAPER_SPEECH, PAPER_LARYNX) if feature_set is FeatureSet.PAPER else (IMPROVED, IMPROVED_LARYNX)
    speech = _maps([[part.speech for part in unit] for unit in units], speech_form, settings, left_out)
    larynx: list[LinearMap | None] = [None] * len(speech)
    if parts[0].larynx is not None:
        larynx = _maps([[part.larynx for part in unit] for unit in units], larynx_form, settings, left_out)
    figures = {
        "takes": float(len(parts)),
        "frames": float(sum(part.speech.frames for part in parts)),
        "skipped_frames": float(sum(part.speech.skipped for part in parts)),
        "voiced_share": float(np.average([part.voiced_share for part in parts], weights=[part.frames for part in parts])),
    }
    whole, *others = (
        SpeechRegressor(model_version, feature_set, parts[0].features, *maps, group) for maps in zip(speech, larynx, strict=True)
    )
    return replace(whole, figures=figures), others


def _maps(units: Units, form: RidgeForm, settings: RidgeSettings | None, left_out: bool) -> list[LinearMap]:
    """Of all units, then of all others of each."""
    if len(units) > 2:  # parts are asked for only where too few units are left
        units = [[pooled(unit)] for unit in units]
    units, back = few_coordinates(units, form)
    folds = [pooled(unit) for unit in units] if len(units) > 1 else units[0]
    maps = [cross_validated(folds, form, settings), *(left_out_maps(units, form, settings) if left_out else ())]
    return [back(found) for found in maps]


def speech_errors(regressor: SpeechRegressor, takes: Iterable[SpeechTake]) -> SpeechErrors:
    """Errors of a regressor on takes that it has not seen (table 2); frames with NaN are skipped and counted.

    Raises `InputError` where no frame is left.
    """
    found, of_mean, skipped = [], [], 0
    for take in takes:
        truth = _columns(take.coefficients, regressor.larynx is not None)
        predicted = _columns(regressor.coefficients(take.features, regressor.model_version), regressor.larynx is not None)
        means = [regressor.speech.mean] + ([regressor.larynx.mean] if regressor.larynx else [])
        good = np.isfinite(truth).all(axis=1)
        skipped += len(good) - int(good.sum())
        found.append((predicted - truth)[good])
        of_mean.append((np.concatenate(means) - truth)[good])
    differences, mean_differences = (np.concatenate(part) if part else np.zeros((0, 0)) for part in (found, of_mean))
    if len(differences) == 0:
        raise InputError(f"{skipped} frames, none with all coefficients", expected="fitted frames", remedy="Look at the fit")
    ours, means = (_table_2(part, len(regressor.speech.bias)) for part in (differences, mean_differences))
    return SpeechErrors(len(differences), skipped, **ours, **{f"{name}_of_mean": value for name, value in means.items()})


def _columns(coefficients: SpeechCoefficients, larynx: bool) -> NDArray[np.float64]:
    if not larynx:
        return coefficients.phi
    return np.column_stack([coefficients.phi, coefficients.tau, coefficients.alpha])


def _table_2(differences: NDArray, phi: int) -> dict[str, float]:
    found = {"phi": float(np.linalg.norm(differences[:, :phi], axis=1).mean())}
    squares = (differences[:, phi:] ** 2).mean(axis=0)
    return found | {name: float(value) for name, value in zip(("tau", "alpha"), squares, strict=False)}


def takes_or_stretches(takes: Iterable[SpeechTake], parts: int) -> Iterator[SpeechTake]:
    """The takes, or `parts` stretches of the only one with equally many fitted frames.

    Raises `InputError` for no take, or one of fewer fitted frames than parts.
    """
    takes = iter(takes)
    begin = list(islice(takes, 2))
    if not begin:
        raise InputError("no take with speech", expected="at least one", remedy="Give takes with sound and fitted coefficients")
    if len(begin) == 2:
        return chain(begin, takes)
    only = begin[0]
    fitted = np.flatnonzero(np.isfinite(only.coefficients.phi).all(axis=1))
    if len(fitted) < parts:
        raise InputError(
            f"{only.name}: {len(fitted)} fitted frames and no other take",
            expected=f"at least {parts}, to cut it for cross-validation",
            remedy="Record more speech",
        )
    inner = fitted[np.linspace(0, len(fitted), parts + 1).round().astype(int)[1:-1]]
    return (only.part(start, end) for start, end in pairwise([0, *inner.tolist(), len(only.features)]))


def _moments(take: SpeechTake, outputs: NDArray, windows, feature_set: FeatureSet, settings: RidgeSettings) -> Moments:
    first = take.features.first
    blocks = (
        (windows(block, feature_set), outputs[block.first - first : block.first - first + len(block)])
        for block in take.features.blocks(settings.block_frames)
    )
    try:
        return moments_of(blocks)
    except InputError as error:
        raise InputError(f"{take.name}: {error.found}", expected=error.expected, remedy=error.remedy) from error


def _check_alike(parts: Sequence[TakeMoments]) -> None:
    """Raises `InputError` where a take differs from the first in what it holds."""
    first = parts[0]
    for part in parts:
        same = part.speech.outputs == first.speech.outputs and part.features == first.features
        if not same or (part.larynx is None) != (first.larynx is None):
            raise InputError(
                f"{part.name} has other coefficients or feature settings than the takes before it",
                expected="one neck model's phi in all takes, tau and alpha in all or in none",
                remedy="Fit all takes with one model and make their features with one setting",
            )
