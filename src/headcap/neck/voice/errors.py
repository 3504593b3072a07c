"""How well a voice's regressors do on sound that they did not hear: the rows of the paper's table 2."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from headcap.artifacts import load_json, save_json
from headcap.speech import FeatureSet, SpeechErrors

KIND, SCHEMA = "voice_errors", 1

VoiceKind = Literal["user", "generic"]
LeftOut = Literal["takes", "stretches", "people"]
_SCALES = {"phi_mm": ("phi", 1e3), "tau_mm2": ("tau", 1e6), "alpha": ("alpha", 1.0)}


@dataclass(frozen=True)
class VoiceErrorRow:
    """One way of training a voice."""

    feature_set: FeatureSet
    """The paper's windows, or ours."""
    silence_removed: bool
    """True where each person's coefficients in silence were subtracted before training and testing, which no voice can tell;
    False where coefficients are as they were fitted."""
    training_frames: int
    """That the regressor of all was trained on."""
    errors: SpeechErrors
    """Metres; of frames left out, each predicted once by a regressor that did not hear its person, take or stretch."""


@dataclass(frozen=True)
class VoiceErrors:
    """Table 2 of one voice."""

    voice: str
    """A user's or a group's name."""
    kind: VoiceKind
    model_version: str
    trained: tuple[str, ...]
    """People that the voice was trained on."""
    tested: tuple[str, ...]
    """People whose frames were predicted."""
    left_out: LeftOut
    """What the regressor that predicts a frame has not heard."""
    shared_sound: float
    """Share of the frames left out whose window of 520 ms overlaps that of a frame trained on: 0 where takes are left out, and
    up to 1 where a single short take is cut into stretches. Errors of such frames are too small for what a new take will show."""
    rows: tuple[VoiceErrorRow, ...]
    """That of the regressor that is kept, then those that it is to be compared with."""
    remarks: tuple[str, ...] = ()
    """What these errors cannot tell, and what was not learnt."""

    @property
    def kept(self) -> VoiceErrorRow:
        """Of the regressor that is kept."""
        return self.rows[0]

    def row(self, feature_set: FeatureSet, *, silence_removed: bool) -> VoiceErrorRow | None:
        """The row trained in this way, or None."""
        found = (row for row in self.rows if (row.feature_set, row.silence_removed) == (feature_set, silence_removed))
        return next(found, None)

    def save(self, path: Path | str) -> None:
        """Write as JSON artifact `headcap.voice_errors/1`: phi in millimetres, tau in square millimetres."""
        content = vars(self) | {"rows": [_record(row) for row in self.rows]}
        save_json(
            path, KIND, SCHEMA, {name: list(value) if isinstance(value, tuple) else value for name, value in content.items()}
        )

    @classmethod
    def load(cls, path: Path | str) -> VoiceErrors:
        """Read what `save` wrote; raises `ArtifactError`."""
        content = load_json(path, KIND, SCHEMA)
        content["rows"] = [_row(record) for record in content["rows"]]
        return cls(**{name: tuple(value) if isinstance(value, list) else value for name, value in content.items()})


def in_millimetres(errors: SpeechErrors) -> dict[str, float]:
    """phi_mm, tau_mm2, alpha and each `_of_mean`; without tau and alpha for a voice that drives phi alone."""
    values = {}
    for name, (own, scale) in _SCALES.items():
        for ending in ("", "_of_mean"):
            value = getattr(errors, own + ending)
            if value is not None:
                values[name + ending] = scale * value
    return values


def _record(row: VoiceErrorRow) -> dict[str, Any]:
    counted = {"training_frames": row.training_frames, "test_frames": row.errors.frames, "skipped_frames": row.errors.skipped}
    return {"feature_set": row.feature_set.value, "silence_removed": row.silence_removed} | counted | in_millimetres(row.errors)


def _row(record: dict[str, Any]) -> VoiceErrorRow:
    values = {}
    for name, (own, scale) in _SCALES.items():
        for ending in ("", "_of_mean"):
            if name + ending in record:
                values[own + ending] = record[name + ending] / scale
    errors = SpeechErrors(record["test_frames"], record["skipped_frames"], **values)
    return VoiceErrorRow(FeatureSet(record["feature_set"]), record["silence_removed"], record["training_frames"], errors)
