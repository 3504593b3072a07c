"""`headcap edit`: operations as they are written on a command line, one after the other, on coefficient curves."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from functools import reduce
from itertools import groupby
from pathlib import Path

import numpy as np

from headcap.artifacts import digest_settings, write_manifest
from headcap.errors import InputError
from headcap.neck.animation.curves import CoefficientCurves
from headcap.neck.animation.editing import added, exaggerated, keyed, scaled, shifted
from headcap.neck.animation.swallowing import find_swallow, swallow
from headcap.neck.fits import NeckFits
from headcap.neck.model import NeckModel

SWALLOW = "swallow"
UNITS = {"tau": 1e-3, "neck": math.pi / 180, "jaw": math.pi / 180}
"""What values on the command line are given in: tau in millimetres, rotations in degrees, all else as it is."""

Operation = tuple[str, str]
"""Name and text, such as ("scale", "tau=1.5")."""


def edit(
    source: str,
    operations: Sequence[Operation],
    target: Path,
    *,
    take: str | None = None,
    model: Path | None = None,
    fps: float = 60.0,
) -> CoefficientCurves:
    """Curves of a source after operations in their order, written to `target` with a manifest, and returned.

    `source` is a file of curves, fits.npz of a trained neck (with `take`, and `model` if it is not beside them), or the word
    swallow, for the ready curve at `fps`. Raises `InputError` for an operation that is not understood or does not fit.
    """
    curves, inputs = _source(source, take, model, fps)
    inputs += [Path(_split(text)[0]) for name, text in operations if name in ("add", "subtract") and _split(text)[0] != SWALLOW]
    if target.absolute() in [path.absolute() for path in inputs]:
        raise InputError(f"{target} to read and to write", expected="another file to write", remedy="Give another --out.")
    for (name, _), group in groupby(operations, key=_together):
        texts = [text for _, text in group]
        curves = _key(curves, texts) if name == "key" else reduce(_OPERATIONS[name], texts, curves)
    curves.save(target)
    digest = digest_settings(operations=[list(operation) for operation in operations], take=take, fps=fps)
    write_manifest(target, kind="coefficient_curves", stage="edit", settings_digest=digest, inputs=inputs, figures={})
    return curves


def _source(source: str, take: str | None, model: Path | None, fps: float) -> tuple[CoefficientCurves, list[Path]]:
    """Curves and the files that they are from."""
    if source == SWALLOW:
        return swallow(fps), []
    path = Path(source)
    if path.suffix != ".npz":
        return CoefficientCurves.load(path), [path]
    fits, model = NeckFits.load(path), model or path.with_name("model.npz")
    names = [fit.take for fit in fits.takes]
    if take is None and len(names) == 1:
        take = names[0]
    if take not in names:
        raise InputError(
            f"take {take}" if take else f"{len(names)} takes",
            expected=f"one of {', '.join(names)}",
            remedy="Name it with --take.",
        )
    fit = fits.takes[names.index(take)]
    return CoefficientCurves.of_take(fit, NeckModel.load(model).version, fits.person), [path, model]


def _together(operation: Operation) -> tuple[str, str]:
    """Keys of one curve in a row are one edit: they bend it together. All else is done one by one."""
    name, text = operation
    return name, text.partition("@")[0] if name == "key" else ""


def _assigned(text: str) -> tuple[str, float]:
    """`curve=number`."""
    name, equals, value = text.partition("=")
    if not (name and equals):
        raise _misread(text, "a curve and a number, such as tau=1.5")
    return name, _number(value, text)


def _scale(curves: CoefficientCurves, text: str) -> CoefficientCurves:
    return scaled(curves, *_assigned(text))


def _exaggerate(curves: CoefficientCurves, text: str) -> CoefficientCurves:
    return exaggerated(curves, *_assigned(text))


def _offset(curves: CoefficientCurves, text: str) -> CoefficientCurves:
    name, amount = _assigned(text)
    return shifted(curves, name, amount * _unit(name))


def _key(curves: CoefficientCurves, texts: Sequence[str]) -> CoefficientCurves:
    keys, name = [], ""
    for text in texts:
        found = re.fullmatch(r"([^@=]+)@([^@=]+)=([^@=]+)", text)
        if found is None:
            raise _misread(text, "a curve, a moment in seconds and a value, such as tau@1.2=20")
        name = found[1]
        keys.append((_number(found[2], text), _number(found[3], text) * _unit(name)))
    return keyed(curves, name, keys)


def _cut(curves: CoefficientCurves, text: str) -> CoefficientCurves:
    if text == SWALLOW:
        return find_swallow(curves)
    start, colon, end = text.partition(":")
    if not colon:
        raise _misread(text, "two moments in seconds, such as 1.0:2.5, or swallow")
    return curves.cut(_number(start, text), _number(end, text))


def _add(curves: CoefficientCurves, text: str, sign: float = 1.0) -> CoefficientCurves:
    source, moment = _split(text)
    rate = 1 / float(np.median(np.diff(curves.time_s))) if len(curves) > 1 else 60.0
    other = swallow(rate) if source == SWALLOW else CoefficientCurves.load(source)
    return added(curves, other, moment, sign=sign)


def _subtract(curves: CoefficientCurves, text: str) -> CoefficientCurves:
    return _add(curves, text, -1.0)


def _split(text: str) -> tuple[str, float]:
    """`file@moment`."""
    source, at, moment = text.rpartition("@")
    if not at:
        raise _misread(text, "a file of curves or swallow, and a moment in seconds, such as swallow@1.2")
    return source, _number(moment, text)


def _unit(name: str) -> float:
    return UNITS.get(name.partition(".")[0], 1.0)


def _number(value: str, text: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise _misread(text, f"a number in place of {value!r}")
    return number


def _misread(text: str, expected: str) -> InputError:
    return InputError(f"edit {text!r}", expected=expected, remedy="Write it so.")


_OPERATIONS: dict[str, Callable[[CoefficientCurves, str], CoefficientCurves]] = {
    "scale": _scale,
    "offset": _offset,
    "exaggerate": _exaggerate,
    "cut": _cut,
    "add": _add,
    "subtract": _subtract,
}
