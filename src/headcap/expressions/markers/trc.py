"""TRC files, the tab-separated trajectories of Motion Analysis and OpenSim."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from headcap.errors import InputError
from headcap.expressions.markers.labels import metres_per, plain_labels
from headcap.expressions.markers.table import numbers, triples
from headcap.expressions.markers.take import MarkerTake


def read_trc(path: Path, unit: str | None = None, rate_hz: float | None = None) -> MarkerTake:
    """Markers of a TRC file: the third line's Units and the Time column hold unless they are given; blank cells are gaps.

    Raises `InputError` where header and table do not agree.
    """
    lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    if len(lines) < 6 or not lines[0].startswith("PathFileType"):
        raise InputError(f"{path.name} has no TRC header", expected="PathFileType in its first line", remedy="Export it again.")
    header = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=False))
    labels = [label.strip() for label in lines[3].split("\t")[2:] if label.strip()]
    if header.get("NumMarkers", "").strip() != str(len(labels)):
        raise InputError(
            f"{path.name} names {len(labels)} markers and says NumMarkers {header.get('NumMarkers', 'nowhere')}",
            expected="as many names as markers",
            remedy="Export it again.",
        )
    table = numbers([line.split("\t") for line in lines[5:] if line.strip()], 2 + 3 * len(labels), path, 6)
    if header.get("NumFrames", "").strip() not in ("", str(len(table))):
        raise InputError(
            f"{path.name} has {len(table)} frames and says NumFrames {header['NumFrames']}",
            expected="a whole file",
            remedy="Export it again.",
        )
    times = np.arange(len(table)) / rate_hz if rate_hz else table[:, 1]
    positions = triples(table[:, 2:]) * metres_per(unit or header.get("Units"), path)
    return MarkerTake(tuple(plain_labels(labels)), positions, times, path.name)
