"""Regressors from a voice to the coefficients of a trained neck, and how they do on takes left out (sections 6.2 and 7.3)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from headcap.errors import InputError
from headcap.neck.fits import NeckFits, TakeFit
from headcap.neck.model import NeckModel
from headcap.speech import (
    RATE_HZ,
    FeatureSet,
    FeatureSettings,
    RidgeSettings,
    SpeechCoefficients,
    SpeechErrors,
    SpeechRegressor,
    SpeechTake,
    speech_errors,
    train_speech_regressor,
)
from headcap.speech.framing import CONTEXT_SAMPLES
from headcap.speech.take_sound import TakeSound
from headcap.speech.training import takes_or_stretches

LEAST_PARTS = 3
"""Takes or stretches: one is left out for the errors, one of the others in turn for the penalties."""
TELLING_SHARE = 0.2
"""Share of frames left out that share sound with the training up to which their errors tell of other sound."""
WINDOW_S = CONTEXT_SAMPLES / RATE_HZ
"""Sound that one visual frame hears."""


class VoiceTrainingSettings(BaseModel):
    """Regressors from sound to the neck's coefficients."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    feature_set: FeatureSet = Field(
        FeatureSet.POOLED, description="paper: windows as in the paper; pooled: fewer inputs and penalties of their own"
    )
    features: FeatureSettings = Field(default_factory=FeatureSettings)
    ridge: RidgeSettings = Field(default_factory=RidgeSettings)


@dataclass(frozen=True, eq=False)
class TakePrediction:
    """Coefficients of a take as they were fitted, and as regressors say that heard all but the frame's own take or stretch."""

    take: str
    camera: str
    """Whose sound."""
    time_s: NDArray[np.float64]
    """(f,) on the take's common clock."""
    fitted: SpeechCoefficients
    predicted: SpeechCoefficients


@dataclass(frozen=True, eq=False)
class VoiceTraining:
    """A person's regressor and its errors by cross-validation."""

    regressor: SpeechRegressor
    """Trained on all frames."""
    errors: SpeechErrors
    """Table 2 on frames left out, beside predicting the mean of the frames trained on."""
    shared_sound: float
    """Share of the frames left out whose window of 520 ms overlaps that of a frame trained on: 0 where takes are left out, and
    up to 1 where a single short take is cut into stretches. Errors of such frames are too small for what a new take will show."""
    predictions: tuple[TakePrediction, ...]

    def remarks(self) -> list[str]:
        """What these errors cannot tell, and what was not learnt; empty where there is nothing to say."""
        told, errors = [], self.errors
        if self.shared_sound > TELLING_SHARE:
            told.append(
                f"{100 * self.shared_sound:.0f} % of the frames left out hear sound that was trained on:"
                " how another take would be predicted is not known"
            )
        missed = [name for name in ("phi", "tau", "alpha") if getattr(errors, name) >= getattr(errors, f"{name}_of_mean")]
        if missed:
            told.append(f"{' and '.join(missed)} no better than by the mean: more speech is needed, or sound does not tell")
        return told

    def figures(self) -> dict[str, float]:
        """Table 2's errors (phi in mm, tau in square mm) beside predicting the mean, and what they rest on."""
        errors, counted = self.errors, self.regressor.figures
        return {
            "speech.phi_error": 1e3 * errors.phi,
            "speech.phi_error_of_mean": 1e3 * errors.phi_of_mean,
            "speech.tau_error": 1e6 * errors.tau,
            "speech.tau_error_of_mean": 1e6 * errors.tau_of_mean,
            "speech.alpha_error": errors.alpha,
            "speech.alpha_error_of_mean": errors.alpha_of_mean,
            "speech.shared_sound_share": self.shared_sound,
            "speech.takes": float(len(self.predictions)),
            "speech.frames": counted["frames"],
            "speech.skipped_frames": counted["skipped_frames"],
            "speech.voiced_share": counted["voiced_share"],
        }


def train_voice(
    model: NeckModel, fits: NeckFits, sounds: Mapping[str, TakeSound], settings: VoiceTrainingSettings | None = None
) -> VoiceTraining:
    """R_b, R_tau and R_alpha of one person (eq. 21 to 25) from fitted takes and their sounds, by take.

    Errors are of takes left out one at a time, the penalties chosen without them; a single take is cut into stretches. Two things
    no such error can tell: all coefficients were fitted with a neck model trained on these very frames, and one short take holds
    few sounds of the language. Raises `InputError` for a take without sound, or too few fitted frames.
    """
    settings = settings or VoiceTrainingSettings()
    missing = [take.take for take in fits.takes if take.take not in sounds]
    if missing:
        raise InputError(
            f"no sound of {', '.join(missing)}",
            expected="one for each fitted take",
            remedy="Give the takes the model was fitted to",
        )
    takes = [_speech_take(take, sounds[take.take], settings.features) for take in fits.takes]
    whole = train_speech_regressor(takes, model.version, settings.feature_set, group=fits.person, settings=settings.ridge)
    parts = list(takes_or_stretches(takes, max(settings.ridge.parts_of_one_take, LEAST_PARTS)))
    left_out = [_without(parts, k, model.version, settings) for k in range(len(parts))]
    predicted = _joined([regressor.coefficients(part.features, model.version) for regressor, part in left_out])
    errors = _pooled([speech_errors(regressor, [part]) for regressor, part in left_out if _fitted(part)])
    figures = whole.figures | {"takes": float(len(takes))}
    shared = shared_sound_share(fits.takes[0].time_s, [len(part.features) for part in parts]) if len(takes) == 1 else 0.0
    return VoiceTraining(replace(whole, figures=figures), errors, shared, _predictions(fits, sounds, takes, predicted))


def _speech_take(take: TakeFit, sound: TakeSound, settings: FeatureSettings) -> SpeechTake:
    fitted = SpeechCoefficients(take.speech.phi, take.speech.tau_m, take.speech.alpha)
    return SpeechTake(take.take, sound.features(take.time_s, settings), fitted)


def _without(
    parts: Sequence[SpeechTake], k: int, model_version: str, settings: VoiceTrainingSettings
) -> tuple[SpeechRegressor, SpeechTake]:
    """The regressor of all parts but one, and that one."""
    others = [part for i, part in enumerate(parts) if i != k]
    return train_speech_regressor(others, model_version, settings.feature_set, settings=settings.ridge), parts[k]


def _fitted(take: SpeechTake) -> bool:
    return bool(np.isfinite(take.coefficients.phi).all(axis=1).any())


def _pooled(errors: Sequence[SpeechErrors]) -> SpeechErrors:
    """Errors over all frames of several."""
    frames = np.array([one.frames for one in errors])
    means = {
        name: float(np.average([getattr(one, name) for one in errors], weights=frames))
        for name in ("phi", "phi_of_mean", "tau", "tau_of_mean", "alpha", "alpha_of_mean")
    }
    return SpeechErrors(int(frames.sum()), sum(one.skipped for one in errors), **means)


def shared_sound_share(time_s: NDArray, lengths: Sequence[int]) -> float:
    """Share of a take's frames, at moments (f,), whose window overlaps that of a frame of another stretch.

    `lengths` are the numbers of frames of the stretches that the take was cut into, in order.
    """
    shared, ends = 0, np.cumsum(lengths)
    for start, end in zip(ends - lengths, ends, strict=True):
        own = time_s[start:end]
        near = np.zeros(len(own), bool)
        if start > 0:
            near |= own - time_s[start - 1] < WINDOW_S
        if end < len(time_s):
            near |= time_s[end] - own < WINDOW_S
        shared += int(near.sum())
    return shared / len(time_s)


def _joined(parts: Sequence[SpeechCoefficients]) -> SpeechCoefficients:
    return SpeechCoefficients(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("phi", "tau", "alpha")))


def _predictions(
    fits: NeckFits, sounds: Mapping[str, TakeSound], takes: Sequence[SpeechTake], predicted: SpeechCoefficients
) -> tuple[TakePrediction, ...]:
    """Predicted frames of all takes in a row, dealt out to the takes."""
    out, first = [], 0
    for fit, take in zip(fits.takes, takes, strict=True):
        chosen = slice(first, first + len(fit.time_s))
        first = chosen.stop
        own = SpeechCoefficients(predicted.phi[chosen], predicted.tau[chosen], predicted.alpha[chosen])
        out.append(TakePrediction(fit.take, sounds[fit.take].camera, fit.time_s, take.coefficients, own))
    return tuple(out)
