"""The 52 blend shapes of Apple's ARKit, under the names that studios write them by."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.expressions.basis import ExpressionBasis

_BOTH_SIDES = (
    "eyeBlink", "eyeLookDown", "eyeLookIn", "eyeLookOut", "eyeLookUp", "eyeSquint", "eyeWide",
    "mouthSmile", "mouthFrown", "mouthDimple", "mouthStretch", "mouthPress", "mouthLowerDown", "mouthUpperUp",
    "browDown", "browOuterUp", "cheekSquint", "noseSneer", "jaw", "mouth",
)  # fmt: skip
_WHOLE = (
    "jawForward", "jawOpen", "mouthClose", "mouthFunnel", "mouthPucker", "mouthRollLower", "mouthRollUpper",
    "mouthShrugLower", "mouthShrugUpper", "browInnerUp", "cheekPuff", "tongueOut",
)  # fmt: skip
ARKIT_NAMES: tuple[str, ...] = tuple(sorted([*(f"{stem}{side}" for stem in _BOTH_SIDES for side in ("Left", "Right")), *_WHOLE]))
"""All 52, of ARFaceAnchor.BlendShapeLocation; left is the subject's."""
_SIDES = {"l": "Left", "lf": "Left", "lft": "Left", "left": "Left", "r": "Right", "rt": "Right", "rgt": "Right", "right": "Right"}
_DECORATION = {
    "ar", "arkit", "blend", "blendshape", "blendshapes", "bs", "c", "ctr", "center", "centre", "expr", "expression", "face",
    "geo", "head", "key", "m", "mesh", "mid", "middle", "morph", "msh", "shape", "shapes", "target", "targets",
}  # fmt: skip
"""Words about a shape that say nothing of it, before or behind its name."""
_SPELLINGS = {"brows": "brow", "cheeks": "cheek", "eyes": "eye", "fwd": "forward", "lid": "eye", "lips": "mouth", "lwr": "lower",
              "upr": "upper", "dn": "down", "opn": "open"}  # fmt: skip


@dataclass(frozen=True)
class Recognised:
    """Which shapes of a basis are ARKit's."""

    names: dict[str, str]
    """ARKit's name by the basis'. Two may share one: halves of what ARKit has whole, as ICT-FaceKit's browInnerUp_L, _R."""
    absent: tuple[str, ...]
    """Of the 52 those that no shape stands for."""
    foreign: tuple[str, ...]
    """Shapes that are none of the 52."""


def recognise(names: Iterable[str], aliases: Mapping[str, str] | None = None) -> Recognised:
    """ARKit's name of each shape that has one, whatever case, separators, sides (`_L`, `Left`, `.l`, `L_`) or prefixes it has.

    `aliases` give ARKit names by names of the user's own. Raises `InputError` for an alias to a name that ARKit has not.
    """
    aliases = dict(aliases or {})
    wrong = sorted(set(aliases.values()) - set(ARKIT_NAMES))
    if wrong:
        raise InputError(f"{', '.join(wrong)} as ARKit's", expected="any of its 52 names", remedy="Correct the aliases.")
    names = tuple(names)
    told = {name: aliases.get(name) or _arkit_name(name) for name in names}
    found = {name: arkit for name, arkit in told.items() if arkit is not None}
    present = set(found.values())
    return Recognised(
        found,
        tuple(name for name in ARKIT_NAMES if name not in present),
        tuple(name for name in names if name not in found),
    )


def as_arkit(basis: ExpressionBasis, aliases: Mapping[str, str] | None = None) -> tuple[ExpressionBasis, NDArray[np.float64]]:
    """The shapes of a basis that ARKit has, by its names and in its order (j), and the matrix (k, j) that brings weights over.

    Halves of one ARKit shape are added up: both at weight w are the whole at w; a whole's weight is the mean of its halves'
    weights, weighted by their squared lengths (for halves that share no vertex this is the least squares of eq. 5). Shapes that
    ARKit has not have a row of zeros. Raises `InputError` where none is ARKit's, where two have one name and are no halves, and
    for a half without the other.
    """
    found = recognise(basis.names, aliases)
    if not found.names:
        raise InputError(
            f"none of the {len(basis)} shapes has a name of ARKit's", expected="jawOpen, eyeBlinkLeft...", remedy="Give aliases."
        )
    _refuse_doubles(found.names)
    present = [name for name in ARKIT_NAMES if name in set(found.names.values())]
    column = np.array([present.index(found.names[name]) if name in found.names else -1 for name in basis.names])
    shapes = np.zeros((len(present), *basis.neutral.shape), np.float32)
    known = np.flatnonzero(column >= 0)
    np.add.at(shapes, column[known], basis.displacements[known])
    energy = np.square(basis.rows[known], dtype=np.float64).sum(axis=1)
    matrix = np.zeros((len(basis), len(present)))
    matrix[known, column[known]] = energy / np.bincount(column[known], energy, len(present))[column[known]]
    return ExpressionBasis(tuple(present), basis.neutral, shapes, basis.triangles), matrix


def _refuse_doubles(found: dict[str, str]) -> None:
    """Shapes of one ARKit name are a left and a right half of a whole, or there is but one, which is no half."""
    by_arkit: dict[str, list[str]] = {}
    for name, arkit in found.items():
        by_arkit.setdefault(arkit, []).append(name)
    for arkit, names in by_arkit.items():
        sides = sorted(_side(name) for name in names)
        if sides != ["Left", "Right"] and sides != [_side(arkit)]:
            raise InputError(
                f"{' and '.join(names)} as ARKit's {arkit}",
                expected="one shape, or its left and right half",
                remedy="Rename one.",
            )


def _side(name: str) -> str:
    sides = [_SIDES[word] for word in _words(name) if word in _SIDES]
    return sides[-1] if sides else ""


def _words(name: str) -> list[str]:
    """Words of a name, small: `head|bs:eyeBlink_L` is eye, blink, l."""
    name = re.split(r"[:|/]", name)[-1]
    words = [word.casefold() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", name)]
    return [_SPELLINGS.get(word, word) for word in words]


def _key(words: Iterable[str]) -> str:
    return "".join(sorted(words))


def _table() -> dict[tuple[str, str], str]:
    """ARKit's name by the words of its stem, sorted, and its side."""
    table = {}
    for name in ARKIT_NAMES:
        words = _words(name)
        side = next((_SIDES[word] for word in words if word in _SIDES), "")
        table[_key(word for word in words if word not in _SIDES), side] = name
    return table


_BY_WORDS = _table()
_BY_LETTERS = {name.casefold(): name for name in ARKIT_NAMES} | {
    re.sub("Left$", "l", re.sub("Right$", "r", name)).casefold(): name for name in ARKIT_NAMES
}


def _arkit_name(name: str) -> str | None:
    words = _words(name)
    while words and words[0] in _DECORATION:
        words = words[1:]
    while words and words[-1] in _DECORATION:
        words = words[:-1]
    # names without capitals or separators
    if "".join(words) in _BY_LETTERS:
        return _BY_LETTERS["".join(words)]
    sides = Counter(_SIDES[word] for word in words if word in _SIDES)
    if sides.total() > 1:
        return None
    stem, side = _key(word for word in words if word not in _SIDES), next(iter(sides), "")
    return _BY_WORDS.get((stem, side)) or _BY_WORDS.get((stem, ""))
