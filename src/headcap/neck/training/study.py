"""The neck model of a study from its people's speech takes: pose and expression off (eq. 7), then Algorithm 1 (section 5.2)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from headcap.errors import InputError
from headcap.heads import HeadModel
from headcap.neck.fitting.compensation import FitSettings, compensate
from headcap.neck.fitting.person import PersonFittingSettings, fit_person
from headcap.neck.larynx.chart import build_chart
from headcap.neck.larynx.larynx_map import LarynxMap, LarynxSettings, larynx_map
from headcap.neck.model import NeckModel, NeckPerson
from headcap.neck.subjects import NeckSubject
from headcap.neck.training.speech import LEAST_FRAMES, SpeechSubject, SpeechTraining, SpeechTrainingSettings, train_speech


class NeckTrainingSettings(BaseModel):
    """A neck model from speech takes."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    fit: FitSettings = Field(default_factory=FitSettings)
    larynx: LarynxSettings = Field(default_factory=LarynxSettings)
    speech: SpeechTrainingSettings = Field(default_factory=SpeechTrainingSettings)
    person: PersonFittingSettings = Field(default_factory=PersonFittingSettings)


def train_neck(
    head: HeadModel,
    subjects: Sequence[NeckSubject],
    settings: NeckTrainingSettings | None = None,
    *,
    scratch: Path | None = None,
    progress: Callable[[str, float], None] | None = None,
) -> SpeechTraining:
    """Speech blendshapes that all subjects share, and each one's base shape and larynx, from the subjects' speech takes.

    `head` has the pose correctives and expressions of section 5.1. Meshes without pose and expression are kept in files under
    `scratch` (the system's own folder by default), so that memory does not grow with the frames. A subject without speech takes
    is left out; fewer frames than Algorithm 1 needs for all its blendshapes train fewer. Raises `InputError` where nobody speaks,
    or someone too little.
    """
    settings = settings or NeckTrainingSettings()
    speaking = [subject for subject in subjects if len(subject.meshes("speech"))]
    if not speaking:
        raise InputError(
            "no speech take", expected="one at least", remedy="Record speech; its kind in the session file is speech."
        )
    empty = common_larynx_map(head, speaking, settings.larynx)
    with TemporaryDirectory(dir=scratch, prefix=".speech_") as folder:
        people = [_at_rest(head, subject, settings.fit, Path(folder)) for subject in speaking]
        return train_speech(head, empty, people, _affordable(settings.speech, people), progress=progress)


def person_of(model: NeckModel, subject: NeckSubject, settings: NeckTrainingSettings, scratch: Path | None = None) -> NeckPerson:
    """The model's own person of the subject's name; anybody else is fitted, from the neutral head and speech takes, if any.

    Raises `InputError` for another topology.
    """
    known = next((person for person in model.people if person.name == subject.name), None)
    if known is not None:
        return known
    with TemporaryDirectory(dir=scratch, prefix=".speech_") as folder:
        rests = None
        if len(subject.meshes("speech")):
            rests = speech_at_rest(model.head, subject, settings.fit, Path(folder) / "speech.npy")
        return fit_person(model, subject, rests, settings.person)


def common_larynx_map(head: HeadModel, subjects: Sequence[NeckSubject], settings: LarynxSettings) -> LarynxMap:
    """An empty larynx map whose chart is isometric on the mean of the subjects' throats, for they share one chart."""
    mean = np.mean([subject.neutral for subject in subjects], axis=0)
    model = head.personal(mean.astype(head.vertices.dtype))
    return larynx_map(model, build_chart(model), settings=settings)


def speech_at_rest(head: HeadModel, subject: NeckSubject, settings: FitSettings, out: Path) -> NDArray:
    """M_j of eq. 7 of a subject's speech takes (f, n, 3), metres, as a memory map of a new file."""
    frames = subject.meshes("speech")
    meshes = np.lib.format.open_memmap(out, "w+", np.float32, frames.shape)
    first = 0
    for take in subject.of_kind("speech"):
        part = meshes[first : first + len(take.meshes)]
        compensate(subject.personal(head), take.meshes, settings, seen=subject.seen, out=part)
        first += len(part)
    return meshes


def _at_rest(head: HeadModel, subject: NeckSubject, settings: FitSettings, folder: Path) -> SpeechSubject:
    meshes = speech_at_rest(head, subject, settings, folder / f"{subject.name}.npy")
    return SpeechSubject(subject.name, subject.neutral, meshes, subject.seen)


def _affordable(settings: SpeechTrainingSettings, people: Sequence[SpeechSubject]) -> SpeechTrainingSettings:
    """As many iterations as twice the frames for each blendshape allow."""
    frames = sum(len(person.meshes) for person in people)
    for person in people:
        if len(person.meshes) < LEAST_FRAMES:
            raise InputError(
                f"{person.name}: {len(person.meshes)} frames of speech",
                expected=f"at least {LEAST_FRAMES}",
                remedy="Record a longer speech take, or hold this person out of the study.",
            )
    return settings.model_copy(update={"iterations": max(1, min(settings.iterations, frames // (2 * settings.growth)))})
