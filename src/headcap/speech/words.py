"""When words were said, and when saying them shuts the lips: b, p and m of a transcript with times."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

from headcap.errors import InputError

SILENCE = frozenset({"sil", "sp", ""})
"""Labels of pauses in the GRID corpus (Cooke et al. 2006)."""
_TICKS_HZ = 25_000
"""Of whole-numbered times, as GRID has them: samples of its sound."""
HOLD_S = 0.065
"""How long lips stay shut: closures of English p and b last 0.069 and 0.064 s on average (Byrd 1993), m about as long."""
_CLOSED = "bpm"
_LETTER_NAMES = {"b": "b", "p": "p", "m": "em", "w": "doubleu"}
"""How letters are called that shut the lips."""
_SILENT = (re.compile("(?<=m)b$"), re.compile("p(?=h)"), re.compile("^p(?=[snt])"))
"""Thumb, phone, psalm."""


@dataclass(frozen=True)
class Word:
    """One word of a transcript."""

    text: str
    start_s: float
    end_s: float


@dataclass(frozen=True)
class Closure:
    """Lips that a word shuts."""

    word: str
    sound: str
    """b, p or m."""
    time_s: float
    """The middle of the closure."""


def read_words(path: Path | str) -> tuple[Word, ...]:
    """Words in the order they were said, of a file with a line `start end word` each; pauses (sil, sp) are left out.

    Times are seconds where any has a decimal point, as in a label track of Audacity, else 1/25000 s, as in the GRID corpus. Both
    count from the video's first frame. Raises `InputError` for other lines and for words that end before they begin or overlap.
    """
    path = Path(path)
    try:
        lines = [line.split(maxsplit=2) for line in path.read_text(encoding="utf-8").splitlines() if line.strip()]
    except UnicodeDecodeError:
        raise _refused(f"{path.name} is no text", "lines in UTF-8") from None
    for number, parts in enumerate(lines, 1):
        if len(parts) < 2 or not all(_is_number(part) for part in parts[:2]):
            raise _refused(f"{path.name}, line {number}: {' '.join(parts)}", "start, end and a word")
    rate_hz = 1.0 if any("." in part for parts in lines for part in parts[:2]) else _TICKS_HZ
    words = [Word(" ".join(parts[2:]).lower(), float(parts[0]) / rate_hz, float(parts[1]) / rate_hz) for parts in lines]
    words = [word for word in words if word.text not in SILENCE]
    for before, word in zip([None, *words], words, strict=False):
        if word.end_s <= word.start_s or (before and word.start_s < before.end_s):
            raise _refused(f"{path.name}: {word.text} from {word.start_s:g} to {word.end_s:g} s", "words one after the other")
    if not words:
        raise _refused(f"{path.name} without a word", "one at least")
    return tuple(words)


def lip_closures(words: tuple[Word, ...]) -> tuple[Closure, ...]:
    """When b, p and m shut the lips, in order.

    A closure that begins its word lies `HOLD_S` / 2 after the word's start, where aligners let a stop begin; one that ends its
    word, as in the letter m, as long before its end; others lie where their letter does in the word. Spelling tells the
    sounds: silent letters (thumb, phone, psalm) are left out, neighbours (mp, bb) are one closure, a last mute e is passed over.
    It is right for every word of the GRID corpus's grammar.
    """
    found = []
    for word in words:
        for sound, share in closed_letters(word.text):
            time_s = word.start_s + share * (word.end_s - word.start_s)
            half = min(HOLD_S, word.end_s - word.start_s) / 2
            found.append(Closure(word.text, sound, min(max(time_s, word.start_s + half), word.end_s - half)))
    return tuple(found)


def closed_letters(word: str) -> list[tuple[str, float]]:
    """Letters of a word that shut the lips, and where in it: 0 its start, 1 its end."""
    spoken = _LETTER_NAMES.get(word, word if len(word) > 1 else "")
    silent = {match.start() for pattern in _SILENT for match in pattern.finditer(spoken)}
    sounding = [place for place in range(len(spoken)) if place not in silent]
    if len(sounding) > 2 and spoken[sounding[-1]] == "e":
        sounding.pop()
    found: list[list[int]] = []
    for place, letter in enumerate(sounding):
        if spoken[letter] in _CLOSED:
            if found and found[-1][-1] == place - 1:
                found[-1].append(place)
            else:
                found.append([place])
    last = len(sounding) - 1
    return [(spoken[sounding[run[0]]], _share(run, last)) for run in found]


def _share(run: list[int], last: int) -> float:
    """Of a run of places among 0 to `last`."""
    if run[0] == 0:
        return 0.0
    return 1.0 if run[-1] == last else (run[0] + run[-1] + 1) / (2 * (last + 1))


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text)) and float(text) >= 0
    except ValueError:
        return False


def _refused(found: str, expected: str) -> InputError:
    return InputError(found, expected=expected, remedy="Give lines `start end word`, in seconds or in 1/25000 s.")
