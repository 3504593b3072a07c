"""C3D files, through ezc3d."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from headcap.errors import InputError
from headcap.expressions.markers.labels import metres_per, plain_labels
from headcap.expressions.markers.take import MarkerTake


def read_c3d(path: Path, unit: str | None = None, rate_hz: float | None = None) -> MarkerTake:
    """Labelled points of a C3D file; a residual below zero, or no number, is a gap. Analog channels are not read.

    Points without a label or called *1, *2 ... are what the system saw and nobody named: left out, with a note. The unit is the
    file's POINT:UNITS unless one is given. Raises `InputError`.
    """
    import ezc3d

    try:
        content = ezc3d.c3d(str(path))
        points, parameters = content["data"]["points"], content["parameters"]["POINT"]
        residuals = content["data"]["meta_points"]["residuals"][0]
    except (OSError, RuntimeError, ValueError, LookupError) as error:
        raise InputError(f"{path} cannot be read ({error})", expected="a C3D file", remedy="Export it again.") from error
    labels = _labels(parameters, points.shape[1])
    named = np.array([bool(label) and not label.startswith("*") for label in labels], bool)
    units = parameters.get("UNITS", {}).get("value", [])
    positions = points[:3].transpose(2, 1, 0) * metres_per(unit or next(iter(units), None), path)
    positions[(residuals < 0).T] = np.nan
    positions[~np.isfinite(positions).all(axis=2)] = np.nan
    rate = rate_hz or float(parameters["RATE"]["value"][0])
    if not rate > 0:
        raise InputError(f"{path.name} has a rate of {rate:g} Hz", expected="a rate above zero", remedy="Name the rate.")
    notes = () if named.all() else (f"{int((~named).sum())} points without a label left out",)
    kept = plain_labels([label for label, keep in zip(labels, named, strict=True) if keep])
    return MarkerTake(tuple(kept), positions[:, named], np.arange(points.shape[2]) / rate, path.name, notes)


def _labels(parameters: dict, count: int) -> list[str]:
    """All labels; past 255 they go on in LABELS2, LABELS3 ..."""
    labels = list(parameters["LABELS"]["value"])
    further = sorted((key for key in parameters if key.startswith("LABELS") and key[6:].isdigit()), key=lambda key: int(key[6:]))
    for key in further:
        labels += list(parameters[key]["value"])
    return [label.strip() for label in labels[:count]] + [""] * (count - len(labels))
