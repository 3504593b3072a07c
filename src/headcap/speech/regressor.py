"""From audio features to the coefficients of one neck model (eq. 21 to 24)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_arrays, save_arrays
from headcap.errors import InputError
from headcap.speech.features import FeatureSet, SpeechFeatures
from headcap.speech.ridge import LinearMap
from headcap.speech.settings import FeatureSettings

KIND, SCHEMA = "speech_regressor", 2
_PARTS = ("weights", "bias", "penalties", "mean")


@dataclass(frozen=True)
class SpeechCoefficients:
    """Coefficients of n visual frames, in the units of the neck model that they belong to."""

    phi: NDArray[np.float64]
    """(n, k) weights of the speech blendshapes."""
    tau: NDArray[np.float64] | None = None
    """(n,) slide of the larynx; None where the regressor drives none."""
    alpha: NDArray[np.float64] | None = None
    """(n,) scale of the larynx."""


@dataclass(frozen=True)
class SpeechRegressor:
    """R_b, R_tau and R_alpha of one neck model: audio features in, its coefficients out."""

    model_version: str
    """Digest of the neck model whose coefficients these are; those of any other mean something else."""
    feature_set: FeatureSet
    features: FeatureSettings
    """How its features were made; others are refused."""
    speech: LinearMap
    """R_b of eq. 21: filter windows -> phi (k outputs)."""
    larynx: LinearMap | None = None
    """R_tau and R_alpha of eq. 22 and 23: source windows -> (tau, alpha). None where a group trains phi alone, as the paper's
    female group, whose larynx does not show."""
    group: str = ""
    """Whose voices it was trained on."""
    from_silence: bool = False
    """True where it tells how far a person is from their own silence, for which the neutral head stands (phi = 0, tau = 0,
    alpha = 1); False where it tells coefficients as they were fitted to the people it was trained on."""
    figures: dict[str, float] = field(default_factory=dict)
    """What training counted and measured."""

    def __post_init__(self) -> None:
        if not self.model_version:
            raise ValueError("a regressor belongs to a model version")
        if self.larynx is not None and len(self.larynx.bias) != 2:
            raise ValueError(f"the larynx has tau and alpha, not {len(self.larynx.bias)} coefficients")

    @property
    def drives(self) -> tuple[str, ...]:
        """What it predicts; the larynx rests where that is phi alone."""
        return ("phi",) if self.larynx is None else ("phi", "tau", "alpha")

    def check_model(self, model_version: str) -> None:
        """Raises `InputError` where the neck model is not the one that this regressor was trained for."""
        if model_version != self.model_version:
            raise InputError(
                f"a speech regressor of neck model {self.model_version} beside neck model {model_version}",
                expected="the neck model that it was trained for",
                remedy="Train the regressor again with this model, or load the model that it belongs to",
            )

    def coefficients(self, features: SpeechFeatures, model_version: str) -> SpeechCoefficients:
        """Coefficients of every visual frame, for the neck model of this version (eq. 24).

        Features may be a whole recording's or what a `FeatureStream` has just given. Silent and unvoiced sound is no
        error: the larynx then follows loudness alone. Raises `InputError` for another model version or features made
        with other settings.
        """
        self.check_model(model_version)
        if features.settings != self.features:
            raise InputError(
                f"features made with {features.settings}",
                expected=f"the settings of the regressor's training, {self.features}",
                remedy="Make features with `regressor.features`",
            )
        parts = [self._of(block) for block in features.blocks()] or [self._of(features)]
        phi, larynx = (np.concatenate(found) for found in zip(*parts, strict=True))
        if self.larynx is None:
            return SpeechCoefficients(phi)
        return SpeechCoefficients(phi, larynx[:, 0], larynx[:, 1])

    def _of(self, features: SpeechFeatures) -> tuple[NDArray, NDArray]:
        phi = self.speech(features.filter_windows(self.feature_set))
        if self.larynx is None:
            return phi, np.zeros((len(phi), 0))
        return phi, self.larynx(features.source_windows(self.feature_set))

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.speech_regressor/2`."""
        maps = {"speech": self.speech} | ({"larynx": self.larynx} if self.larynx else {})
        arrays = {f"{name}/{part}": getattr(found, part) for name, found in maps.items() for part in _PARTS}
        meta = {
            "model_version": self.model_version,
            "feature_set": self.feature_set.value,
            "features": self.features.model_dump(mode="json"),
            "group": self.group,
            "from_silence": self.from_silence,
            "figures": self.figures,
        }
        save_arrays(path, KIND, SCHEMA, arrays, meta)

    @classmethod
    def load(cls, path: Path | str, model_version: str | None = None) -> SpeechRegressor:
        """Read what `save` wrote; with a model version, refuse a regressor of any other.

        Raises `ArtifactError` for another kind of file, `InputError` for another model version.
        """
        arrays, meta = load_arrays(path, KIND, SCHEMA)
        maps = {
            name: LinearMap(**{part: arrays[f"{name}/{part}"] for part in _PARTS})
            for name in ("speech", "larynx")
            if f"{name}/weights" in arrays
        }
        meta["feature_set"] = FeatureSet(meta["feature_set"])
        meta["features"] = FeatureSettings.model_validate(meta["features"])
        regressor = cls(**meta, **maps)
        if model_version is not None:
            regressor.check_model(model_version)
        return regressor
