"""From a session or study document to checked sessions; everything wrong with it is told at once, before any job."""

from __future__ import annotations

import copy
import difflib
import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError

from headcap.calibration.board import BoardSettings, read_board
from headcap.errors import InputError, InputErrors
from headcap.settings import Session, Study, disagreements, session_files
from headcap.synthetic.settings import RehearsalSettings

REHEARSALS = "results/{session}/rehearse"


@dataclass(frozen=True)
class Plan:
    """What one run of the workflow works on."""

    name: str
    sessions: dict[str, Session]


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
        return Plan(session.session, {session.session: session})
    study, errors = _validate(Study, document)
    _refuse(errors)
    checked = [check_session(entry if isinstance(entry, dict) else read_document(entry)) for entry in study.sessions]
    errors = [error for _, found in checked for error in found]
    names = [session.session for session, _ in checked if session]
    errors += [_named_twice(name) for name in sorted({name for name in names if names.count(name) > 1})]
    _refuse(errors)
    return Plan(study.study, {session.session: session for session, _ in checked})


def load_rehearsal(document: dict[str, Any]) -> RehearsalSettings:
    """Rehearsal settings, given as such or under a session's `rehearse`; raises `InputErrors`."""
    settings, errors = _validate(RehearsalSettings, document.get("rehearse", document))
    _refuse(errors)
    return settings


def check_session(document: dict[str, Any]) -> tuple[Session | None, list[InputError]]:
    """A session's content as `Session` (None where it cannot be read as one) and all that is wrong with it."""
    document, errors = _with_rehearsal(document)
    session, found = _validate(Session, document)
    errors += found
    # files are checked even where keys are wrong, as far as the rest makes a session
    readable = session or _validate(Session, _repaired(document, found))[0]
    if readable:
        errors += [_disagreement(told) for told in disagreements(readable)] + _missing_files(readable) + _wrong_board(readable)
    return (None if errors else session), errors


def _validate(model: type[BaseModel], document: dict) -> tuple[Any, list[InputError]]:
    try:
        # as JSON: strict about types, yet a list may stand for a tuple and 60 for 60.0
        return model.model_validate_json(json.dumps(document, default=str), strict=True), []
    except ValidationError as error:
        items = [item for item in map(partial(_chosen, document), error.errors(include_url=False)) if item]
        deeper = {item["loc"][:count] for item in items for count in range(len(item["loc"]))}
        # a list with a wrong item is also told to be too short: that follows, and would only distract
        return None, [_told(model, item) for item in items if item["loc"] not in deeper or not item["loc"]]


class _KeyError(InputError):
    """An `InputError` that remembers where in the document it is."""

    def __init__(self, location: tuple, found: str, *, expected: str, remedy: str) -> None:
        self.location = location
        super().__init__(found, expected=expected, remedy=remedy)


# pydantic names the members of a union on the way to an error: `board.str`, `board.function-after[..., BoardSettings].squares`
def _union_member(part: str | int) -> type | None:
    if part == "str":
        return str
    return dict if isinstance(part, str) and (part.startswith(("dict[", "function-")) or part.endswith("Settings")) else None


def _chosen(document: dict, item: dict) -> dict | None:
    """The error without union members on its way; None where it is of a member that was not meant."""
    holder, location = document, []
    for part in item["loc"]:
        member = None if _has(holder, part) else _union_member(part)
        if member and not isinstance(holder, member):
            # where no member was meant, the error is told once, without the member's name
            return None if isinstance(holder, str | dict) or member is not str else item | {"loc": tuple(location)}
        if member:
            continue
        location.append(part)
        holder = holder[part] if _has(holder, part) else None
    return item | {"loc": tuple(location)}


def _has(holder: Any, part: str | int) -> bool:
    return part in holder if isinstance(holder, dict) else isinstance(holder, list) and part < len(holder)


def _told(model: type[BaseModel], item: dict) -> InputError:
    location, where = item["loc"], ".".join(map(str, item["loc"])) or "the file"
    if item["type"] == "extra_forbidden":
        known = _known_keys(model, location[:-1])
        near = difflib.get_close_matches(str(location[-1]), known, n=1)
        hint = f"Did you mean {near[0]}?" if near else "Remove it."
        return _KeyError(location, f"{where}: unknown key", expected=f"one of {', '.join(sorted(known))}", remedy=hint)
    if item["type"] == "missing":
        return _KeyError(location, f"{where}: missing", expected="a value", remedy="Add it; config/schema describes every key.")
    found = f"{where}: {item['input']!r:.80}"
    return _KeyError(location, found, expected=_expectation(item["msg"]), remedy="Mend the value.")


def _expectation(message: str) -> str:
    message = message.removeprefix("Value error, ").removeprefix("Input should be ")
    return message[:1].lower() + message[1:]


def _known_keys(model: type[BaseModel], location: tuple) -> list[str]:
    for part in location:
        if isinstance(part, int):
            continue
        found = _models_of(model.model_fields[part].annotation) if part in model.model_fields else []
        if not found:
            return []
        model = found[0]
    return list(model.model_fields)


def _models_of(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in getattr(annotation, "__args__", ()) for model in _models_of(part)]


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
    return InputError(f"two sessions are called {name}", expected="a name of its own for each", remedy="Rename one.")


def _refuse(errors: list[InputError]) -> None:
    if errors:
        raise InputErrors(errors)


def _with_rehearsal(document: dict) -> tuple[dict, list[InputError]]:
    """Fill in what a rehearsed session does not say from its rehearsal."""
    if not isinstance(document.get("rehearse"), dict):
        return document, []
    rehearsal, errors = _validate(RehearsalSettings, document["rehearse"])
    if errors:
        nested = [
            _KeyError(("rehearse", *e.location), f"rehearse.{e.found}", expected=e.expected, remedy=e.remedy) for e in errors
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
        "evaluate": {"truth": "truth"},
    }


def _rehearsed_board(board: BaseModel) -> dict[str, Any]:
    return {key: value for key, value in board.model_dump(mode="json").items() if key in BoardSettings.model_fields}
