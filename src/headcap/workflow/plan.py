"""From a session or study document to checked sessions; everything wrong with it is told at once, before any job."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel

from headcap.calibration.board import BoardSettings, read_board
from headcap.errors import InputError, InputErrors
from headcap.lips.training import RegressorPlan, planned_regressors
from headcap.neck.voice.training import Voice
from headcap.settings import MeshSubject, Session, Study, disagreements, known_figures, session_files
from headcap.synthetic.hand_made import HAND_MADE
from headcap.synthetic.settings import MeshRehearsalSettings, RehearsalSettings, TakeSettings
from headcap.workflow.validation import KeyedInputError, validate

REHEARSALS = "results/{session}/rehearse"
MESH_REHEARSALS = "results/{subject}/rehearse_meshes"
NECK_KINDS = ("pose", "expression", "speech")
"""Kinds of takes that a neck model learns from and is judged by."""
LIP_KINDS = ("lips", "speech", "expression", "free")
"""Kinds of takes that a lip regressor learns from, where somebody performs lips at all."""
_TRAINING = ("train_expressions", "train_neck", "train_speech", "track_monocular", "train_lips", "quasi_eigen")
_TAKE_FILES = ("sequence", "sound", "larynx", "video")
EXPRESSION_KINDS = ("expression", "lips", "speech", "free")
"""Kinds of takes that tell what a face does, for a basis of expressions to cover."""
SPOKEN_KINDS = ("speech", "free")
"""Kinds of rehearsed takes in which something is said."""


@dataclass(frozen=True)
class Plan:
    """What one run of the workflow works on; a session by itself is a study of its own name."""

    study: Study
    sessions: dict[str, Session]

    @property
    def name(self) -> str:
        """The study's name, under which results of all people together lie."""
        return self.study.study

    @property
    def meshes(self) -> dict[str, MeshSubject]:
        """People who come without recordings."""
        return {subject.subject: subject for subject in self.study.mesh_subjects}

    @property
    def people(self) -> tuple[str, ...]:
        """Everybody: sessions, then mesh subjects."""
        return (*self.sessions, *self.meshes)

    @property
    def training(self) -> tuple[str, ...]:
        """People that are trained on."""
        return tuple(name for name in self.people if name not in self.study.held_out)

    @property
    def neck_people(self) -> tuple[str, ...]:
        """Everybody with takes that tell of a neck, where they train one: somebody who is not held out speaks; else nobody."""
        if not any(self.takes(name, "speech") for name in self.training):
            return ()
        return tuple(name for name in self.people if self.takes(name, *NECK_KINDS))

    @property
    def is_session(self) -> bool:
        """Whether the study is one session and no more: what both would write is written once."""
        return self.people == (self.name,)

    def takes(self, person: str, *kinds: str) -> dict[str, str]:
        """Kind of each take of a person by name; of some kinds or of all."""
        takes = (self.sessions.get(person) or self.meshes[person]).takes
        return {take.name: take.kind for take in takes if not kinds or take.kind in kinds}

    def heard(self, person: str) -> tuple[str, ...]:
        """Speech takes of a person that have a sound."""
        if person in self.sessions:
            return () if self.sessions[person].train_speech is None else tuple(self.takes(person, "speech"))
        return tuple(take.name for take in self.meshes[person].takes if take.kind == "speech" and take.sound)

    @property
    def voices(self) -> dict[str, Voice]:
        """Regressors to train by name: each speaking person's own, and the groups'."""
        own = {name: Voice(name=name, people=(name,)) for name in self.training if self.heard(name)}
        return (own | {group.name: group for group in self.study.groups}) if self.neck_people else {}

    def filmed(self, person: str, *kinds: str) -> tuple[str, ...]:
        """Takes of a person that one camera can be asked about: those of sessions, and those of mesh subjects with a video."""
        names = self.takes(person, *(kinds or LIP_KINDS))
        if person in self.sessions:
            return tuple(names)
        return tuple(name for name in names if self.meshes[person].take(name).video)

    @property
    def lip_people(self) -> tuple[str, ...]:
        """Everybody who is filmed, where somebody who trains performs lips; nobody else."""
        if not any(self.filmed(name, "lips") for name in self.training):
            return ()
        return tuple(name for name in self.people if self.filmed(name))

    def turning_take(self, person: str) -> str | None:
        """A filmed take in which somebody turns the head, which tells a single camera who that is (see `lips.monocular`)."""
        return next(iter((*self.filmed(person, "turn"), *self.filmed(person, "pose"))), None)

    @property
    def inpainted(self) -> tuple[tuple[str, str], ...]:
        """Person and take of filmed takes of sessions in which tattooed lips are painted over."""
        return tuple(
            (name, take)
            for name in self.lip_people
            if name in self.sessions
            for take in self.sessions[name].tattooed_takes
            if take in self.filmed(name)
        )

    @property
    def lip_tested(self) -> tuple[str, ...]:
        """People whose takes test regressors of lips."""
        return tuple(name for name in self.lip_people if self.lip_tests(name))

    @property
    def lip_regressors(self) -> tuple[RegressorPlan, ...]:
        """Regressors of lips to train."""
        return planned_regressors([name for name in self.lip_people if name in self.training])

    def lip_tests(self, person: str) -> tuple[str, ...]:
        """Filmed takes of a person that test regressors: all of somebody held out, else those that the study keeps for it."""
        names = self.filmed(person)
        kept = self.study.train_lips.test_takes
        return names if person in self.study.held_out else tuple(name for name in names if name in kept)

    @property
    def expression_people(self) -> tuple[str, ...]:
        """People with hand-made expressions and takes to make quasi-eigen faces by."""
        return tuple(name for name in self.people if self.expression_basis(name) and self.takes(name, *EXPRESSION_KINDS))

    def expression_basis(self, person: str) -> str | None:
        """Where a person's hand-made expressions lie."""
        if person in self.meshes:
            return self.meshes[person].expression_basis
        session = self.sessions[person]
        return session.expression_basis and session.path(session.expression_basis)

    def limits(self, person: str) -> dict[str, float]:
        """Limits of a person's figures."""
        return (self.sessions.get(person) or self.meshes[person]).limits


def read_document(path: Path | str) -> dict[str, Any]:
    """Content of a YAML file; raises `InputError` where it is unreadable or no mapping."""
    try:
        document = yaml.safe_load(Path(path).read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputError(f"{path} cannot be read ({error})", expected="a YAML file", remedy="Mend the file.") from error
    if not isinstance(document, dict):
        raise InputError(f"{path} holds no keys", expected="a session or study", remedy="See config/sessions/template.yaml.")
    return document


def load_plan(document: dict[str, Any]) -> Plan:
    """Check a session's or a study's content; raises `InputErrors` with all that is wrong."""
    if "study" not in document and "sessions" not in document:
        session, errors = check_session(document)
        _refuse(errors)
        trains = {key: getattr(session, key) for key in _TRAINING}
        trains = {key: value for key, value in trains.items() if value is not None}
        alone = Plan(Study(study=session.session, sessions=(session.session,), **trains), {session.session: session})
        _refuse(_always_tattooed(alone))
        return alone
    document, nested = _with_mesh_rehearsals(document)
    study, errors = validate(Study, document)
    _refuse(nested + errors)
    checked = [check_session(entry if isinstance(entry, dict) else read_document(entry)) for entry in study.sessions]
    errors = [error for _, found in checked for error in found]
    names = [session.session for session, _ in checked if session]
    names += [subject.subject for subject in study.mesh_subjects]
    errors += [_named_twice(name) for name in sorted({name for name in names if names.count(name) > 1})]
    _refuse(errors)
    plan = Plan(study, {session.session: session for session, _ in checked})
    _refuse([_disagreement(told) for told in study_disagreements(plan)] + _missing_study_files(study) + _always_tattooed(plan))
    return plan


def study_disagreements(plan: Plan) -> Iterator[str]:
    """Names in a study that nobody has, people who would both train and test, and names that stand for two things."""
    people, study = set(plan.people), plan.study
    yield from (f"held_out: nobody is called {name}" for name in study.held_out if name not in people)
    if not people:
        yield "sessions, mesh_subjects: the study has neither, and so nobody to work on"
    elif not plan.training:
        yield "held_out: everybody is held out, so that nothing can be trained"
    if plan.name in people and not plan.is_session:
        yield f"study: {plan.name} is also a person's name, and results of both would lie in one folder"
    for group in study.groups:
        where = f"groups.{group.name}"
        yield from (f"{where}: nobody is called {name}" for name in group.people if name not in people)
        if not set(group.people) & set(plan.training):
            yield f"{where}: everybody in it is held out, so that nobody trains it"
        silent = [name for name in group.people if name in people and not plan.heard(name)]
        yield from (f"{where}: {name} has no speech take with a sound" for name in silent)
        if group.name in people:
            yield f"{where}: a person has that name, and a regressor of their own"
    for person, takes in study.train_lips.labels.items():
        filmed = plan.filmed(person) if person in plan.training else ()
        yield from (
            f"train_lips.labels: {take} is no filmed take of a {person} who trains" for take in takes if take not in filmed
        )
    groups = [group.name for group in study.groups]
    yield from (f"groups: {name} is named twice" for name in sorted({name for name in groups if groups.count(name) > 1}))
    for subject in study.mesh_subjects:
        takes = [take.name for take in subject.takes]
        yield from (f"{subject.subject}: take {name} is named twice" for name in sorted({n for n in takes if takes.count(n) > 1}))
        unknown = sorted(set(subject.limits) - known_figures())
        if subject.camera is None and any(take.video for take in subject.takes):
            yield f"{subject.subject}: takes have videos, but camera names none that took them"
        yield from (f"{subject.subject}, limits: no figure is called {name}" for name in unknown)


def _always_tattooed(plan: Plan) -> list[InputError]:
    tattooed: dict[str, list[str]] = {}
    for person, take in plan.inpainted:
        tattooed.setdefault(person, []).append(take)
    return [
        InputError(
            f"{person}: the lips are tattooed in {', '.join(takes)}, and no take shows them without",
            expected="one take without lip tattoo, from which bare lips are painted over the tattoos",
            remedy="Record one, of any kind, or say lip_tattoo: false of takes whose lips bear none.",
        )
        for person, takes in tattooed.items()
        if plan.sessions[person].bare_take is None
    ]


def _missing_study_files(study: Study) -> list[InputError]:
    given = [
        (f"{subject.subject}.{key}", path)
        for subject in study.mesh_subjects
        if subject.rehearse_meshes is None
        for key, path in (
            ("template", subject.template),
            ("camera", subject.camera),
            *((f"{take.name}.{key}", getattr(take, key)) for take in subject.takes for key in _TAKE_FILES),
        )
    ]
    drawn = [
        (f"train_lips.labels.{person}.{take}", path)
        for person, takes in study.train_lips.labels.items()
        for take, path in takes.items()
    ]
    drawn += [
        (f"{subject.subject}.expression_basis", subject.expression_basis)
        for subject in study.mesh_subjects
        if subject.rehearse_meshes is None and subject.expression_basis
    ]
    missing = [(key, path) for key, path in given if path and not Path(path).is_file()]
    return [
        InputError(f"{key}: {path} is not there", expected="a file", remedy="Correct the path.")
        for key, path in missing + [(key, path) for key, path in drawn if not Path(path).exists()]
    ]


def _with_mesh_rehearsals(document: dict) -> tuple[dict, list[InputError]]:
    """Fill in what rehearsed mesh subjects do not say from their rehearsals."""
    if not isinstance(document.get("mesh_subjects"), list):
        return document, []
    filled, errors = [], []
    for number, entry in enumerate(document["mesh_subjects"]):
        if isinstance(entry, dict) and isinstance(entry.get("rehearse_meshes"), dict):
            rehearsal, found = validate(MeshRehearsalSettings, entry["rehearse_meshes"])
            where = ("mesh_subjects", number, "rehearse_meshes")
            errors += [
                KeyedInputError(
                    (*where, *e.location), f"{'.'.join(map(str, where))}.{e.found}", expected=e.expected, remedy=e.remedy
                )
                for e in found
            ]
            # a stand-in that is never used: the errors above end the run
            rehearsal = rehearsal or MeshRehearsalSettings(seed=0, takes=(TakeSettings(name="take", kind="speech"),))
            entry = rehearsed_meshes(rehearsal, entry.get("subject", "rehearsal")) | entry
            entry = {key: value for key, value in entry.items() if not (found and key == "rehearse_meshes")}
        filled.append(entry)
    return document | {"mesh_subjects": filled}, errors


def rehearsed_meshes(rehearsal: MeshRehearsalSettings, name: str) -> dict[str, Any]:
    """The entry of a study that describes a subject rehearsed without pictures."""
    folder = MESH_REHEARSALS.format(subject=name)
    takes = [
        {
            "name": take.name,
            "kind": take.kind,
            "sequence": f"{folder}/{take.name}.json",
            "sound": f"{folder}/{take.name}.wav" if take.kind in SPOKEN_KINDS else None,
            "larynx": f"{folder}/{take.name}.larynx.npz",
            "video": f"{folder}/{take.name}.mp4" if rehearsal.video else None,
        }
        for take in rehearsal.takes
    ]
    camera = f"{folder}/camera.json" if rehearsal.video else None
    basis = f"{folder}/{HAND_MADE}" if rehearsal.sculpt else None
    return {"template": f"{folder}/template.npz", "camera": camera, "takes": takes, "expression_basis": basis}


def load_rehearsal(document: dict[str, Any]) -> RehearsalSettings:
    """Rehearsal settings, given as such or under a session's `rehearse`; raises `InputErrors`."""
    settings, errors = validate(RehearsalSettings, document.get("rehearse", document))
    _refuse(errors)
    return settings


def check_session(document: dict[str, Any]) -> tuple[Session | None, list[InputError]]:
    """A session's content as `Session` (None where it cannot be read as one) and all that is wrong with it."""
    document, errors = _with_rehearsal(document)
    session, found = validate(Session, document)
    errors += found
    # files are checked even where keys are wrong, as far as the rest makes a session
    readable = session or validate(Session, _repaired(document, found))[0]
    if readable:
        errors += [_disagreement(told) for told in disagreements(readable)] + _missing_files(readable) + _wrong_board(readable)
    return (None if errors else session), errors


# what takes the place of a value that is wrong or missing, so that the files of the rest can be checked; the file "" is
# the data root itself
_STAND_INS = {"session": "session", "subject": "", "rate_hz": 1.0, "kind": "free", "unit": "m", "file": "", "files": ""}
_STAND_IN_ENTRIES = {"board": "", "scan": {"file": "", "unit": "m"}, "calibration": {"files": ""}}


def _repaired(document: dict, errors: list[InputError]) -> dict:
    document = copy.deepcopy(document)
    for error in errors:
        location = error.location
        if location[:1] == ("board",):
            document["board"] = _STAND_IN_ENTRIES["board"]
            continue
        holder: Any = document
        try:
            for part in location[:-1]:
                holder = holder[part]
            holder.pop(location[-1], None)
        except (KeyError, IndexError, TypeError, AttributeError):
            continue
        if location[-1] in _STAND_INS:
            holder[location[-1]] = _STAND_INS[location[-1]]
    return _STAND_IN_ENTRIES | document


def board_of(session: Session) -> BoardSettings:
    """The session's board; raises `InputError` where its file is no board."""
    return read_board(session.path(session.board)) if isinstance(session.board, str) else session.board


def _wrong_board(session: Session) -> list[InputError]:
    if not isinstance(session.board, str) or not Path(session.path(session.board)).is_file():
        return []
    try:
        board_of(session)
    except InputError as error:
        return [error]
    return []


def _missing_files(session: Session) -> list[InputError]:
    if session.rehearse is None and not session.root.is_dir():
        found = f"data_root: {session.root.absolute()} is no folder"
        remedy = "Correct data_root, or set the environment variable it names."
        return [InputError(found, expected="the recordings' folder", remedy=remedy)]
    remedy = "Correct the path; a camera that did not record is named under missing."
    return [
        InputError(f"{key}: {path} is not there", expected="a file", remedy=remedy)
        for key, path in session_files(session)
        if not Path(path).exists()
    ]


def _disagreement(told: str) -> InputError:
    return InputError(told, expected="each camera and take named once, and names that exist", remedy="Correct the name.")


def _named_twice(name: str) -> InputError:
    return InputError(f"two sessions or subjects are called {name}", expected="a name of its own for each", remedy="Rename one.")


def _refuse(errors: list[InputError]) -> None:
    if errors:
        raise InputErrors(errors)


def _with_rehearsal(document: dict) -> tuple[dict, list[InputError]]:
    """Fill in what a rehearsed session does not say from its rehearsal."""
    if not isinstance(document.get("rehearse"), dict):
        return document, []
    rehearsal, errors = validate(RehearsalSettings, document["rehearse"])
    if errors:
        nested = [
            KeyedInputError(("rehearse", *e.location), f"rehearse.{e.found}", expected=e.expected, remedy=e.remedy)
            for e in errors
        ]
        document = {key: value for key, value in document.items() if key != "rehearse"}
        return rehearsed_session(RehearsalSettings(), "rehearsal") | {"rehearse": {}} | document, nested
    return rehearsed_session(rehearsal, document.get("session", "rehearsal")) | document, []


def rehearsed_session(rehearsal: RehearsalSettings, name: str) -> dict[str, Any]:
    """The session document that describes a rehearsal's recordings."""
    from headcap.synthetic.rig import build_rig

    target = rehearsal.arc.target_m if rehearsal.cameras is None else rehearsal.cameras[0].look_at_m
    unit = {1.0: "m", 0.01: "cm", 0.001: "mm", 0.0254: "in"}.get(rehearsal.scan.unit_m, "m")
    return {
        "session": name,
        "subject": f"rehearsed subject, seed {rehearsal.seed}",
        "data_root": REHEARSALS.format(session=name),
        "rate_hz": rehearsal.video.rate_hz,
        "cameras": [{"name": camera} for camera in build_rig(rehearsal).names],
        "board": _rehearsed_board(rehearsal.board),
        "calibration": {"files": "calibration/{camera}.mp4"},
        "takes": [
            {"name": take.name, "kind": take.kind, "files": f"takes/{take.name}/{{camera}}.mp4"} for take in rehearsal.takes
        ],
        "scan": {"file": "scan/neutral.ply", "unit": unit},
        # the rig's origin is where the optical axes meet, which is about where they were aimed
        "clapper_m": [round(c - t, 3) for c, t in zip(rehearsal.sound.clap_position_m, target, strict=True)],
        "expression_basis": HAND_MADE if rehearsal.sculpt else None,
        "evaluate": {"truth": "truth"},
    }


def _rehearsed_board(board: BaseModel) -> dict[str, Any]:
    return {key: value for key, value in board.model_dump(mode="json").items() if key in BoardSettings.model_fields}
