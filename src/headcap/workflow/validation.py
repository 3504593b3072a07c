"""Documents against the typed models of settings: every wrong key is told at once, by name, with what was expected."""

from __future__ import annotations

import difflib
import json
from functools import partial
from typing import Any

from pydantic import BaseModel, ValidationError

from headcap.errors import InputError


def validate(model: type[BaseModel], document: dict) -> tuple[Any, list[InputError]]:
    """The document as a model (None where it cannot be) and all that is wrong with it, as `KeyedInputError`."""
    try:
        # as JSON: strict about types, yet a list may stand for a tuple and 60 for 60.0
        return model.model_validate_json(json.dumps(document, default=str), strict=True), []
    except ValidationError as error:
        items = [item for item in map(partial(_chosen, document), error.errors(include_url=False)) if item]
        deeper = {item["loc"][:count] for item in items for count in range(len(item["loc"]))}
        # a list with a wrong item is also told to be too short: that follows, and would only distract
        return None, [_told(model, item) for item in items if item["loc"] not in deeper or not item["loc"]]


class KeyedInputError(InputError):
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
        return KeyedInputError(location, f"{where}: unknown key", expected=f"one of {', '.join(sorted(known))}", remedy=hint)
    if item["type"] == "missing":
        return KeyedInputError(
            location, f"{where}: missing", expected="a value", remedy="Add it; config/schema describes every key."
        )
    found = f"{where}: {item['input']!r:.80}"
    return KeyedInputError(location, found, expected=_expectation(item["msg"]), remedy="Mend the value.")


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
