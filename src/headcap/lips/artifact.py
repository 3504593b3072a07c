"""A trained lip regressor as a file: what it predicts, whose topology it belongs to, and what it was trained on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_arrays, save_arrays
from headcap.errors import InputError
from headcap.heads import HeadModel
from headcap.lips.correction import Identity
from headcap.lips.features import FeatureSpace, LipFeatures
from headcap.lips.mouth import Mouth, MouthSettings, find_mouth
from headcap.lips.regression import FeatureScaling, Network, RegressionSettings, TrainedRegression
from headcap.lips.triangle_parameters import PARAMETERS

KIND, SCHEMA = "lip_regressor", 1
_SPACE = ("vertices", "basis", "border", "share", "eyes")


@dataclass(frozen=True, eq=False)
class LipRegressor:
    """Features of a base tracker's frames in, corrections of one head model's mouth out."""

    model_version: str
    """Digest of the head model whose topology and blendshapes it was trained in."""
    topology: str
    """Digest of that model's triangles."""
    persons: tuple[str, ...]
    """Whom it was trained on."""
    settings: RegressionSettings
    mouth_settings: MouthSettings
    layer: NDArray[np.int64]
    """(T,) triangles that it corrects."""
    identity: Identity
    """D_0 of eq. 1 in its training, see `CorrectionLayer`."""
    anchored: bool
    """Whether distances are differences from the person's own at rest (`LipFeatures.anchored`)."""
    compensate_rotation: bool
    """How distances were taken, see `lip_features`."""
    space: FeatureSpace
    regression: TrainedRegression
    identity_part: NDArray[np.float32] | None = None
    """(T, 9) that every correction begins with, whatever the features: `training.common_identity`; None for none."""

    def relation(self, person: str) -> Literal["PS", "MS", "GR"]:
        """What it is for a person (section 6): specific to them, trained on several of whom they are one, or never seen them."""
        if person not in self.persons:
            return "GR"
        return "PS" if len(self.persons) == 1 else "MS"

    def mouth(self, model: HeadModel) -> Mouth:
        """The mouth of a head model as in training.

        Raises `InputError` for a model of another topology or version, or one whose mouth is cut out differently.
        """
        self.check_model(model)
        mouth = find_mouth(np.asarray(model.vertices, float), model.triangles, model.regions, self.mouth_settings)
        if not np.array_equal(mouth.layer, self.layer):
            raise _refused(
                f"a mouth of {len(mouth.layer)} triangles", f"the {len(self.layer)} triangles that the regressor corrects"
            )
        return mouth

    def check_model(self, model: HeadModel) -> None:
        """Raises `InputError` for a head model of another topology or version than it was trained in."""
        if model.topology_digest != self.topology:
            raise _refused(f"a head model of topology {model.topology_digest[:12]}", f"topology {self.topology[:12]}")
        if model.digest != self.model_version:
            raise _refused(f"head model version {model.digest[:12]}", f"version {self.model_version[:12]}")

    def parameters(self, features: LipFeatures) -> NDArray[np.float32]:
        """l (f, T, 9) of frames' features (eq. 3); NaN for frames that tell none, which are not made up."""
        return self.regression(features) + self.constant

    @property
    def constant(self) -> NDArray[np.float32]:
        """(T, 9) `identity_part`, zeros for none: what in a correction is no difference of expression."""
        return np.zeros((len(self.layer), PARAMETERS), np.float32) if self.identity_part is None else self.identity_part

    def to_arrays(self) -> tuple[dict[str, NDArray], dict]:
        """Arrays and plain record that tell the regressor; `from_arrays` is the inverse."""
        found = self.regression
        arrays = {f"space/{name}": getattr(self.space, name) for name in _SPACE}
        arrays |= {"layer": self.layer, "feature_mean": found.scaling.mean, "feature_scale": found.scaling.scale}
        arrays |= {"prototypes": found.network.prototypes, "weights": found.network.weights, "bias": found.network.bias}
        optional = {"components": found.components, "identity_part": self.identity_part}
        arrays |= {"mean": found.mean} | {name: array for name, array in optional.items() if array is not None}
        meta = {
            name: getattr(self, name) for name in ("model_version", "topology", "identity", "anchored", "compensate_rotation")
        }
        meta |= {
            "persons": list(self.persons),
            "beta": found.network.beta,
            "alpha": found.network.alpha,
            "figures": found.figures,
        }
        meta |= {"settings": self.settings.model_dump(mode="json"), "mouth": self.mouth_settings.model_dump(mode="json")}
        return arrays, meta

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray], meta: dict) -> LipRegressor:
        """The regressor that `to_arrays` told."""
        meta = dict(meta)
        settings = RegressionSettings.model_validate(meta.pop("settings"))
        network = Network(
            arrays["prototypes"], meta.pop("beta"), meta.pop("alpha"), weights=arrays["weights"], bias=arrays["bias"]
        )
        scaling = FeatureScaling(settings.inputs, arrays["feature_mean"], arrays["feature_scale"])
        regression = TrainedRegression(scaling, network, arrays.get("components"), arrays["mean"], meta.pop("figures"))
        return cls(
            persons=tuple(meta.pop("persons")),
            settings=settings,
            mouth_settings=MouthSettings.model_validate(meta.pop("mouth")),
            layer=arrays["layer"],
            space=FeatureSpace(*(arrays[f"space/{name}"] for name in _SPACE)),
            regression=regression,
            identity_part=arrays.get("identity_part"),
            **meta,
        )

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.lip_regressor/1`."""
        save_arrays(path, KIND, SCHEMA, *self.to_arrays())

    @classmethod
    def load(cls, path: Path | str, model: HeadModel | None = None) -> LipRegressor:
        """Read what `save` wrote; with a head model, refuse a regressor of any other.

        Raises `ArtifactError` for another kind of file or schema, `InputError` for another topology or version.
        """
        regressor = cls.from_arrays(*load_arrays(path, KIND, SCHEMA))
        if model is not None:
            regressor.check_model(model)
        return regressor


def _refused(found: str, expected: str) -> InputError:
    return InputError(
        f"{found} beside a lip regressor", expected=expected, remedy="Load the head model it was trained with, or train it again."
    )
