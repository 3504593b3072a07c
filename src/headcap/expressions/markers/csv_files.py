"""CSV files: one row per frame under `time_s, <name>_x, <name>_y, <name>_z, ...`, or the trajectories Vicon Nexus exports.

The plain form has the first column `time_s`, `time` (seconds) or `frame`, then three columns per marker whose names end in x, y
and z after _, . or a blank. Nexus writes a line `Trajectories`, the rate, a line of names, one of axes, one of units, then rows
`frame, sub frame, x, y, z, ...` up to a blank line. Blank cells are gaps in both.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np

from headcap.errors import InputError
from headcap.expressions.markers.labels import metres_per, plain_labels
from headcap.expressions.markers.table import numbers, triples
from headcap.expressions.markers.take import MarkerTake

_COLUMN = re.compile(r"(.+?)[_. ]([xyz])", re.IGNORECASE)


def read_csv(path: Path, unit: str | None = None, rate_hz: float | None = None) -> MarkerTake:
    """Markers of a CSV file of either form; the plain one needs `unit`, and `rate_hz` where it counts frames.

    Raises `InputError`.
    """
    with path.open(encoding="utf-8-sig", newline="", errors="replace") as handle:
        rows = list(csv.reader(handle))
    for line, row in enumerate(rows):
        if row and row[0].strip() == "Trajectories":
            return _nexus(path, rows, line, unit, rate_hz)
    return _plain(path, rows, unit, rate_hz)


def _plain(path: Path, rows: list[list[str]], unit: str | None, rate_hz: float | None) -> MarkerTake:
    header = [cell.strip() for cell in rows[0]] if rows else []
    found = [_COLUMN.fullmatch(name) for name in header[1:]]
    names = [match[1] for match in found[::3] if match]
    whole = [(name, axis) for name in names for axis in "xyz"]
    if not header or header[0].lower() not in ("time_s", "time", "frame") or [m and (m[1], m[2].lower()) for m in found] != whole:
        raise InputError(
            f"{path.name} begins with the columns {', '.join(header[:5]) or 'none'}",
            expected="time_s or frame, then <name>_x, <name>_y, <name>_z of each marker, or a Trajectories section of Nexus",
            remedy="Export the trajectories in one of these forms, or as C3D.",
        )
    table = numbers([row for row in rows[1:] if row], len(header), path, 2)
    if header[0].lower() == "frame" and not rate_hz:
        raise InputError(f"{path.name} counts frames", expected="times or a rate", remedy="Name the rate in frames per second.")
    times = table[:, 0] / rate_hz if header[0].lower() == "frame" else table[:, 0]
    return MarkerTake(tuple(plain_labels(names)), triples(table[:, 1:]) * metres_per(unit, path), times, path.name)


def _nexus(path: Path, rows: list[list[str]], start: int, unit: str | None, rate_hz: float | None) -> MarkerTake:
    section = rows[start + 1 :]
    if len(section) < 5 or [cell.strip() for cell in section[2][:2]] != ["Frame", "Sub Frame"]:
        raise InputError(
            f"{path.name}: the Trajectories section from line {start + 1} has no rows of names, axes and units",
            expected="what Vicon Nexus writes",
            remedy="Export it again, as CSV with trajectories or as C3D.",
        )
    names = [cell.strip() for cell in section[1][2::3] if cell.strip()]
    end = next((k for k, row in enumerate(section[4:]) if not any(cell.strip() for cell in row)), len(section) - 4)
    table = numbers(section[4 : 4 + end], 2 + 3 * len(names), path, start + 6)
    units = [cell.strip() for cell in section[3][2:] if cell.strip()]
    try:
        rate = rate_hz or float(section[0][0])
    except ValueError as error:
        raise InputError(f"{path.name} names no rate", expected="frames per second", remedy="Name the rate.") from error
    positions = triples(table[:, 2:]) * metres_per(unit or next(iter(units), None), path)
    times = (table[:, 0] - table[:1, 0]) / rate
    anonymous = np.array([name.startswith("*") for name in names], bool)
    notes = () if not anonymous.any() else (f"{int(anonymous.sum())} points without a label left out",)
    kept = [name for name, drop in zip(names, anonymous, strict=True) if not drop]
    return MarkerTake(tuple(plain_labels(kept)), positions[:, ~anonymous], times, path.name, notes)
