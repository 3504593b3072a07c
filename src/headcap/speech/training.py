"""Training the regressors of one person or of a group, and their errors on other takes (paper sections 6.2, 7.3)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain, islice, pairwise

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.speech.features import FeatureSet, SpeechFeatures
from headcap.speech.moments import Moments, moments_of
from headcap.speech.regressor import SpeechCoefficients, SpeechRegressor
from headcap.speech.ridge import IMPROVED, PAPER_LARYNX, PAPER_SPEECH, cross_validated
from headcap.speech.settings import RidgeSettings


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
    speech, larynx, voiced, settings_seen = [], [], [], []
    for take in takes_or_stretches(takes, settings.parts_of_one_take):
        settings_seen.append(take.features.settings)
        voiced.append((take.features.voiced_share, len(take.features)))
        speech.append(_moments(take, take.coefficients.phi, SpeechFeatures.filter_windows, feature_set, settings))
        if take.larynx is not None:
            larynx.append(_moments(take, take.larynx, SpeechFeatures.source_windows, feature_set, settings))
        _check_alike(take, speech, larynx, settings_seen)
    paper = feature_set is FeatureSet.PAPER
    share, weight = np.array(voiced).T
    figures = {
        "takes": float(len(speech)),
        "frames": float(sum(part.frames for part in speech)),
        "skipped_frames": float(sum(part.skipped for part in speech)),
        "voiced_share": float(np.average(share, weights=weight)),
    }
    return SpeechRegressor(
        model_version,
        feature_set,
        settings_seen[0],
        cross_validated(speech, PAPER_SPEECH if paper else IMPROVED, settings),
        cross_validated(larynx, PAPER_LARYNX if paper else IMPROVED, settings) if larynx else None,
        group,
        figures,
    )


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


def _check_alike(take: SpeechTake, speech: list[Moments], larynx: list[Moments], settings: list) -> None:
    """Raises `InputError` where a take differs from the first in what it holds."""
    if speech[-1].outputs != speech[0].outputs or len(larynx) not in (0, len(speech)) or settings[-1] != settings[0]:
        raise InputError(
            f"{take.name} has other coefficients or feature settings than the takes before it",
            expected="one neck model's phi in all takes, tau and alpha in all or in none",
            remedy="Fit all takes with one model and make their features with one setting",
        )
