"""Regressors from a voice to the coefficients of a trained neck: one person's, and a group's for new people (section 7.3)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from headcap.artifacts import Name
from headcap.errors import InputError
from headcap.neck.fits import NeckFits
from headcap.neck.model import NeckModel
from headcap.neck.voice.errors import LeftOut, VoiceErrorRow, VoiceErrors, VoiceKind, in_millimetres
from headcap.neck.voice.people import Speaker, shared_sound_share
from headcap.speech import (
    FeatureSet,
    FeatureSettings,
    RidgeSettings,
    SpeechCoefficients,
    SpeechErrors,
    SpeechRegressor,
    SpeechTake,
    speech_errors,
)
from headcap.speech.take_sound import TakeSound
from headcap.speech.training import regressors_of, take_moments, takes_or_stretches

LEAST_PARTS = 3
"""Takes or stretches: one is left out for the errors, one of the others in turn for the penalties."""
TELLING_SHARE = 0.2
"""Share of frames left out that share sound with the training up to which their errors tell of other sound."""

VoiceCoefficients = Literal["all", "phi"]
"""all: phi, tau and alpha; phi: the larynx rests, as the paper has it for people whose larynx does not show."""


class Voice(BaseModel):
    """A voice that a study trains: a person's own, or a group's for others as well."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Name = Field(description="Name of the regressor; a person's own has theirs.")
    people: tuple[Name, ...] = Field(
        min_length=1, description="Sessions and mesh subjects of the study that speak; those held out only test it."
    )
    coefficients: VoiceCoefficients = Field(
        default="all", description="phi: speech blendshapes alone, for people whose larynx hardly shows."
    )

    @property
    def kind(self) -> VoiceKind:
        """user: of one person, for them, whose name it has; generic: of a group, for anybody."""
        return "user" if self.people == (self.name,) else "generic"


class VoiceTrainingSettings(BaseModel):
    """Regressors from sound to the neck's coefficients; both feature sets are trained, tested and stated."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    feature_set: FeatureSet = Field(
        FeatureSet.POOLED,
        description="of the regressor that is kept; paper: windows as in the paper; pooled: fewer inputs, penalties of their own",
    )
    remove_silence: bool = Field(
        True, description="generic voices tell how far people are from their own silence, not coefficients as they were fitted"
    )
    features: FeatureSettings = Field(default_factory=FeatureSettings)
    ridge: RidgeSettings = Field(default_factory=RidgeSettings)


@dataclass(frozen=True, eq=False)
class TakePrediction:
    """Coefficients of a take as fitted, and as regressors say that have not heard the frame's person, take or stretch."""

    person: str
    take: str
    camera: str
    """Whose sound."""
    time_s: NDArray[np.float64]
    """(f,) on the take's common clock."""
    fitted: SpeechCoefficients
    """NaN where a frame was not fitted or not heard; without the person's silence where the voice is trained so."""
    predicted: SpeechCoefficients


@dataclass(frozen=True, eq=False)
class VoiceTraining:
    """A regressor and its errors on what was left out."""

    regressor: SpeechRegressor
    """Trained on all frames of the people that are not held out."""
    errors: VoiceErrors
    predictions: tuple[TakePrediction, ...]

    def figures(self) -> dict[str, float]:
        """Table 2's errors (phi in mm, tau in square mm) beside predicting the mean, and what they rest on."""
        counted = self.regressor.figures
        told = {f"speech.{_figure(name)}": value for name, value in in_millimetres(self.errors.kept.errors).items()}
        return told | {
            "speech.shared_sound_share": self.errors.shared_sound,
            "speech.takes": counted["takes"],
            "speech.frames": counted["frames"],
            "speech.skipped_frames": counted["skipped_frames"],
            "speech.voiced_share": counted["voiced_share"],
        }


def _figure(name: str) -> str:
    """phi_error, phi_error_of_mean, tau_error ..."""
    coefficient = name.split("_")[0]
    return f"{coefficient}_error_of_mean" if name.endswith("_of_mean") else f"{coefficient}_error"


def train_voice(
    model: NeckModel, fits: NeckFits, sounds: Mapping[str, TakeSound], settings: VoiceTrainingSettings | None = None
) -> VoiceTraining:
    """R_b, R_tau and R_alpha of one person (eq. 21 to 25) from the fits and sounds of their speech takes, by take.

    Errors are of takes left out one at a time, the penalties chosen without them; a single take is cut into stretches. Two things
    no such error can tell: all coefficients may have been fitted with a neck model trained on these very frames, and one short
    take holds few sounds of the language. Takes of other kinds are left aside, frames that were not fitted, or at which no sound
    was recorded, are skipped and counted. Raises `InputError` for a take without sound, coefficients of another model, or too few
    frames.
    """
    settings = settings or VoiceTrainingSettings()
    # whom the neck model has not seen may have a voice of their own
    speaker = replace(Speaker.of(model, fits, sounds, settings.features), held_out=False)
    return _train(model, fits.person, "user", [speaker], settings)


def train_group(
    model: NeckModel,
    fits: Sequence[NeckFits],
    sounds: Mapping[str, Mapping[str, TakeSound]],
    settings: VoiceTrainingSettings | None = None,
    *,
    group: str,
    coefficients: VoiceCoefficients = "all",
) -> VoiceTraining:
    """The generic regressor of a group for people whom it has not heard (section 7.3); sounds by person and take.

    People whom the model holds out are never trained on: they are predicted by the regressor of all others. Those trained on
    are left out one at a time, the penalties chosen by leaving out people among the rest (takes, where only one is left). With
    one person to train on and nobody held out, takes are left out instead, which a remark says.

    What the paper leaves open: people's coefficients have means of their own. The neutral scan and the takes are of different
    moments, which above all phi's constant shows, and no voice can tell it. With `remove_silence` each person's median over
    frames that hear a pause is subtracted, so that the voice tells how far a person is from their own silence and the neutral
    head (phi = 0, tau = 0, alpha = 1) stands for it; where fewer than five such frames are heard, nothing is subtracted, which a
    remark says. Our features are trained and stated both ways. On five rehearsed people, whose silence is the neutral head but
    for 0.2 mm of tau and 1 mm of phi, they err alike; with constants of 20 mm added to phi, by as much as its leading weights
    vary within a take, the share of the motion that is explained falls from 0.68 to 0.51 where they are left in, and stays where
    they are removed. The mean of all frames in place of silence's median does as well for the motion, but puts a silent
    person into the pose of mid-speech.

    Raises `InputError` for nobody to train on, a take without sound, coefficients of another model, or too few frames.
    """
    settings = settings or VoiceTrainingSettings()
    missing = [one.person for one in fits if one.person not in sounds]
    if missing:
        raise InputError(
            f"no sound of {', '.join(missing)}", expected="sounds of everybody in the group", remedy="Hear their takes"
        )
    speakers = [Speaker.of(model, one, sounds[one.person], settings.features) for one in fits]
    if coefficients == "phi":
        speakers = [speaker.without_larynx() for speaker in speakers]
    if all(speaker.held_out for speaker in speakers):
        raise InputError(
            f"group {group}: nobody of {len(speakers)} to train on",
            expected="people that the study does not hold out",
            remedy="Let one of the group train",
        )
    return _train(model, group, "generic", speakers, settings)


def train_voice_of(
    model: NeckModel,
    voice: Voice,
    fits: Iterable[NeckFits],
    sounds: Iterable[TakeSound],
    settings: VoiceTrainingSettings | None = None,
) -> VoiceTraining:
    """A voice that a study names, from fits and sounds of its people in any order; those of others are left aside.

    Raises `InputError` for a person without fits, and as `train_voice` and `train_group`.
    """
    fitted = {one.person: one for one in fits}
    missing = [person for person in voice.people if person not in fitted]
    if missing:
        raise InputError(
            f"voice {voice.name}: no fits of {', '.join(missing)}",
            expected=f"one of {', '.join(fitted) or 'nobody: there are no fits'}",
            remedy="Name people of the study whose takes are fitted",
        )
    heard: dict[str, dict[str, TakeSound]] = {person: {} for person in voice.people}
    for sound in sounds:
        heard.get(sound.person, {})[sound.take] = sound
    if voice.kind == "user":
        (person,) = voice.people
        return train_voice(model, fitted[person], heard[person], settings)
    people = [fitted[person] for person in voice.people]
    return train_group(model, people, heard, settings, group=voice.name, coefficients=voice.coefficients)


@dataclass(frozen=True, eq=False)
class _Plan:
    """Who is trained on, and what is left out for the errors."""

    units: tuple[tuple[SpeechTake, ...], ...]
    """What is left out together, in the parts by which penalties may be chosen."""
    tests: tuple[SpeechTake, ...]
    """Of people held out, predicted by the regressor of all units."""
    left_out: LeftOut
    units_are_tested: bool

    @classmethod
    def of(cls, speakers: Sequence[Speaker], settings: RidgeSettings) -> _Plan:
        """People are left out where there are several, or some that are held out; else takes, or stretches of the only one."""
        trained, stretches = [s for s in speakers if not s.held_out], max(settings.parts_of_one_take, LEAST_PARTS)
        tests = tuple(take for speaker in speakers if speaker.held_out for take in speaker.spoken)
        if tests or len(trained) > 1:
            whole = len(trained) > 2  # of fewer, penalties are chosen within one person
            units = [speaker.spoken if whole else tuple(takes_or_stretches(speaker.spoken, stretches)) for speaker in trained]
            return cls(tuple(units), tests, "people", len(trained) > 1)
        takes = trained[0].spoken
        if len(takes) == 2:  # either is trained on alone in its turn
            return cls(tuple(tuple(takes_or_stretches([take], stretches)) for take in takes), (), "takes", True)
        units = [(part,) for part in takes_or_stretches(takes, stretches)]
        return cls(tuple(units), (), "takes" if len(takes) > 1 else "stretches", True)


_Predicted = list[tuple[SpeechRegressor, SpeechTake]]
"""Frames, and the regressor that has not heard them; those of `_Plan.tests` first."""


def _train(
    model: NeckModel, voice: str, kind: VoiceKind, speakers: Sequence[Speaker], settings: VoiceTrainingSettings
) -> VoiceTraining:
    ways = _ways(kind, settings)
    rows, found = [], {}
    for feature_set, removed in ways:
        own = [speaker.without_silence() if removed else speaker for speaker in speakers]
        plan = _Plan.of(own, settings.ridge)
        regressor, predicted = _regressors(plan, model.version, feature_set, settings.ridge)
        rows.append(VoiceErrorRow(feature_set, removed, int(regressor.figures["frames"]), _errors(predicted)))
        if not found:
            regressor = replace(regressor, group=voice, from_silence=removed)
            found = {"regressor": regressor, "predictions": _predictions(own, plan, predicted, model.version)}
    errors = VoiceErrors(
        voice=voice,
        kind=kind,
        model_version=model.version,
        trained=tuple(speaker.name for speaker in speakers if not speaker.held_out),
        tested=tuple(dict.fromkeys(take.person for take in found["predictions"])),
        left_out=plan.left_out,
        shared_sound=_shared_sound(speakers, plan),
        rows=tuple(rows),
    )
    errors = replace(errors, remarks=tuple(_remarks(errors, speakers)))
    return VoiceTraining(_counted(found["regressor"], speakers), errors, found["predictions"])


def _ways(kind: VoiceKind, settings: VoiceTrainingSettings) -> list[tuple[FeatureSet, bool]]:
    """Feature sets to train, and whether without people's silence: the one that is kept, and those that it is compared with."""
    removed = kind == "generic" and settings.remove_silence
    ways = [(settings.feature_set, removed), *((other, removed) for other in FeatureSet if other is not settings.feature_set)]
    # only of people together does it matter, and only ours is quick enough to train once more
    return ways if kind == "user" else [*ways, (FeatureSet.POOLED, not removed)]


def _regressors(
    plan: _Plan, model_version: str, feature_set: FeatureSet, settings: RidgeSettings
) -> tuple[SpeechRegressor, _Predicted]:
    """The regressor of all units, and those that predict what they have not heard."""
    units = [[take_moments(part, feature_set, settings) for part in unit] for unit in plan.units]
    regressor, others = regressors_of(units, model_version, feature_set, settings=settings, left_out=plan.units_are_tested)
    predicted = [(regressor, take) for take in plan.tests]
    # nobody's others where units are not tested
    predicted += [(other, part) for other, unit in zip(others, plan.units, strict=False) for part in unit]
    return regressor, predicted


def _errors(predicted: _Predicted) -> SpeechErrors:
    """Over all frames of several."""
    found = [speech_errors(regressor, [take]) for regressor, take in predicted if take.known.any()]
    frames = np.array([one.frames for one in found])
    names = [name for name, value in vars(found[0]).items() if name not in ("frames", "skipped") and value is not None]
    means = {name: float(np.average([getattr(one, name) for one in found], weights=frames)) for name in names}
    skipped = sum(int((~take.known).sum()) for _, take in predicted)
    return SpeechErrors(int(frames.sum()), skipped, **means)


def _predictions(
    speakers: Sequence[Speaker], plan: _Plan, predicted: _Predicted, model_version: str
) -> tuple[TakePrediction, ...]:
    """Predicted frames in a row, dealt out to the takes."""
    whole = _joined([regressor.coefficients(part.features, model_version) for regressor, part in predicted])
    tested = [speaker for speaker in speakers if speaker.held_out]
    tested += [speaker for speaker in speakers if not speaker.held_out and plan.units_are_tested]
    out, first = [], 0
    for name, take in ((speaker.name, take) for speaker in tested for take in speaker.takes):
        chosen = slice(first, first + len(take.time_s))
        first = chosen.stop
        own = SpeechCoefficients(*(None if part is None else part[chosen] for part in vars(whole).values()))
        out.append(TakePrediction(name, take.name, take.camera, take.time_s, take.spoken.coefficients, own))
    return tuple(out)


def _joined(parts: Sequence[SpeechCoefficients]) -> SpeechCoefficients:
    names = [name for name, value in vars(parts[0]).items() if value is not None]
    return SpeechCoefficients(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


def _shared_sound(speakers: Sequence[Speaker], plan: _Plan) -> float:
    if plan.left_out != "stretches":
        return 0.0
    (take,) = next(speaker for speaker in speakers if not speaker.held_out).takes
    return shared_sound_share(take.time_s, [len(part.features) for (part,) in plan.units])


def _counted(regressor: SpeechRegressor, speakers: Sequence[Speaker]) -> SpeechRegressor:
    """With takes as they were given, whole, and frames of those that could not be used among the skipped."""
    trained = [speaker for speaker in speakers if not speaker.held_out]
    skipped = regressor.figures["skipped_frames"] + sum(sum(speaker.unusable.values()) for speaker in trained)
    takes = sum(len(speaker.takes) for speaker in trained)
    return replace(regressor, figures=regressor.figures | {"takes": float(takes), "skipped_frames": float(skipped)})


def _remarks(errors: VoiceErrors, speakers: Sequence[Speaker]) -> list[str]:
    """What errors cannot tell, and what was not learnt; empty where there is nothing to say."""
    told, kept = [], errors.kept
    if errors.shared_sound > TELLING_SHARE:
        told.append(
            f"{100 * errors.shared_sound:.0f} % of the frames left out hear sound that was trained on:"
            " how another take would be predicted is not known"
        )
    if errors.kind == "generic" and errors.left_out != "people":
        told.append(f"only {errors.trained[0]} speaks: {errors.left_out} are left out, how another person would be is not known")
    values = in_millimetres(kept.errors)
    missed = [name.split("_")[0] for name in values if name + "_of_mean" in values and values[name] >= values[name + "_of_mean"]]
    if missed:
        told.append(f"{' and '.join(missed)} no better than by the mean: more speech is needed, or sound does not tell")
    loud = [speaker.name for speaker in speakers if kept.silence_removed and speaker.silence() is None]
    if loud:
        told.append(f"no pause is heard of {', '.join(loud)}: the neutral head stands for their silence as it is")
    told += [f"{speaker.name} {take}: no frame was fitted and heard" for speaker in speakers for take in speaker.unusable]
    return told
