"""From a study's files to what its page shows: who animates whom, by which voice."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from headcap.evaluation.metrics import load_metrics
from headcap.evaluation.neck_study import NeckStudy
from headcap.heads import HeadModel
from headcap.neck.animation.curves import CoefficientCurves
from headcap.neck.fits import NeckFits, TakeFit
from headcap.neck.landmarks.fitting import fit_landmarks
from headcap.neck.landmarks.landmarks import LandmarkPoints, Landmarks
from headcap.neck.model import NeckModel
from headcap.neck.subjects import NeckSubject, SubjectFiles
from headcap.registration.sequence import JoinedMeshes
from headcap.report.provenance import manifests_of, versions
from headcap.report.study_inputs import Animation, StudyInputs
from headcap.speech import SpeechRegressor
from headcap.speech.take_sound import TakeSound

SHOWN_VOICES = 2
"""Animations by a person's own voice, and by groups' voices."""


@dataclass(frozen=True)
class StudyFiles:
    """Where everything lies that a study made of necks."""

    tables: Path
    figures: Path
    model: Path
    fits: tuple[Path, ...]
    """Of each person, in the study's order."""
    models: tuple[Path, ...]
    """With each person alone, in the same order."""
    people: tuple[SubjectFiles, ...]
    """In the same order."""
    regressors: Mapping[str, Path]
    """By voice."""
    groups: Mapping[str, tuple[str, ...]]
    """People by the name of their voice group."""
    sounds: tuple[Path, ...]
    """Of speech takes."""

    @property
    def all(self) -> list[Path]:
        """Every file that is read, but for people's meshes."""
        alone = [self.tables, self.figures, self.model]
        return [*alone, *self.fits, *self.models, *self.regressors.values(), *self.sounds]


def collect_study_page(files: StudyFiles, settings: Mapping) -> StudyInputs:
    """Read a study's files; people's meshes stay memory-mapped."""
    model, fits = NeckModel.load(files.model), tuple(map(NeckFits.load, files.fits))
    held = {person: path for person, path in zip((f.person for f in fits), files.models, strict=True)}
    scene = _Scene(files, model, fits, {sound.person: {} for sound in map(TakeSound.load, files.sounds)}, held)
    for sound in map(TakeSound.load, files.sounds):
        scene.sounds[sound.person][sound.take] = sound
    return StudyInputs(
        study=NeckStudy.load(files.tables),
        model=model,
        fits=fits,
        figures=load_metrics(files.figures),
        animations=(*scene.own_voices(), *scene.group_voices(), *scene.faces()),
        groups={person: ", ".join(name for name, group in files.groups.items() if person in group) for person in held},
        manifests=manifests_of({str(path): path for path in files.all}),
        versions=versions(),
        settings=settings,
    )


@dataclass(frozen=True)
class _Scene:
    """Who can be animated by what."""

    files: StudyFiles
    model: NeckModel
    fits: tuple[NeckFits, ...]
    sounds: dict[str, dict[str, TakeSound]]
    models: Mapping[str, Path]

    def own_voices(self) -> list[Animation]:
        """Figure 11: people whose own voice was trained."""
        people = [fits for fits in self.fits if fits.person in self.files.regressors and fits.person in self.sounds]
        return [self._by_voice("user", fits.person, fits) for fits in people[:SHOWN_VOICES]]

    def group_voices(self) -> list[Animation]:
        """Figure 12: a group's voice on somebody it has not heard; on one of the group where everybody was heard."""
        shown = []
        for group, members in self.files.groups.items():
            speaking = [fits for fits in self.fits if fits.person in members and fits.person in self.sounds]
            told = sorted(speaking, key=lambda fits: not fits.held_out)
            shown += [self._by_voice("generic", group, fits) for fits in told[:1]]
        return shown[:SHOWN_VOICES]

    def faces(self) -> list[Animation]:
        """Figure 13: landmarks of a face drive head and neck; of somebody held out where there is one."""
        moving = [fits for fits in self.fits if fits.of_kind("expression", "free")]
        told = sorted(moving, key=lambda fits: not fits.held_out)[:1]
        return [self._by_face(fits, fits.of_kind("expression", "free")[0]) for fits in told]

    def _by_voice(self, drive, voice: str, fits: NeckFits) -> Animation:
        take = next(take for take in fits.of_kind("speech") if take.take in self.sounds[fits.person])
        regressor = SpeechRegressor.load(self.files.regressors[voice], self.model.version)
        features = self.sounds[fits.person][take.take].features(take.time_s, regressor.features)
        title = f"{fits.person}, {take.take}, by the voice of {voice}"
        person = NeckModel.load(self.models[fits.person]).person(fits.person)
        heard = regressor.coefficients(features, self.model.version)
        return Animation.of_voice(title, drive, self.model, person, take, heard, self._meshes(fits.person, take))

    def _by_face(self, fits: NeckFits, take: TakeFit) -> Animation:
        fitted = CoefficientCurves.of_take(take, self.model.version, fits.person)
        person = NeckModel.load(self.models[fits.person]).person(fits.person)
        meshes, head = self._meshes(fits.person, take), self.model.head.personal(person.neutral)
        driven = fit_landmarks(head, face_landmarks(head, meshes, take)).curves(self.model.version, fits.person)
        return Animation(f"{fits.person}, {take.take}", "face", person, driven, meshes, fitted)

    def _meshes(self, person: str, take: TakeFit):
        files = next(files for files in self.files.people if files.name == person)
        subject: NeckSubject = files.load(self.model.head)
        return next(found.meshes for found in subject.takes if found.name == take.take)


def face_landmarks(head: HeadModel, meshes: JoinedMeshes, take: TakeFit) -> Landmarks:
    """The model's landmarks on the face as they lie on meshes (f, n, 3): all that a tracker of faces sees of a person."""
    names = [name for name, vertex in sorted(head.landmarks.items()) if head.regions["face"][vertex]]
    points = LandmarkPoints.named(head, names)
    return Landmarks(points, take.time_s, points.at(meshes[:].astype(float)))
