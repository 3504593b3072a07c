"""Marker files by their kind, labels and sizes checked."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from headcap.errors import InputError
from headcap.expressions.markers.c3d import read_c3d
from headcap.expressions.markers.csv_files import read_csv
from headcap.expressions.markers.take import MarkerTake
from headcap.expressions.markers.trc import read_trc

_SPREAD_M = (0.04, 3.0)
"""Extent of markers on half a face, and on a whole body that the face's are chosen from."""


def read_markers(path: Path | str, *, unit: str | None = None, rate_hz: float | None = None) -> MarkerTake:
    """Labelled markers of a .c3d, .trc or .csv file, metres.

    `unit` (m, cm, mm) overrides what the file says and is needed where a CSV says none; `rate_hz` likewise times a CSV without
    times. Raises `InputError` for files that cannot be read, labels given twice, and sizes that are no face's.
    """
    path = Path(path)
    readers = {".c3d": read_c3d, ".trc": read_trc, ".csv": read_csv}
    if path.suffix.lower() not in readers or not path.is_file():
        raise InputError(f"no marker file {path}", expected="a .c3d, .trc or .csv file", remedy="Check the path and its kind.")
    take = readers[path.suffix.lower()](path, unit, rate_hz)
    _check(take)
    return take


def _check(take: MarkerTake) -> None:
    twice = sorted({name for name in take.names if take.names.count(name) > 1})
    if twice:
        raise InputError(
            f"{take.source} has the label {', '.join(twice)} more than once",
            expected="one trajectory per label",
            remedy="Join or rename them where they were labelled.",
        )
    if len(take.time_s) < 2 or len(take.names) < 3 or not (np.diff(take.time_s) > 0).all():
        raise InputError(
            f"{take.source} has {len(take.time_s)} frames of {len(take.names)} labelled markers",
            expected="two frames at least of three markers, times that rise",
            remedy="Export the labelled trajectories of the whole take.",
        )
    if not take.seen.any():
        raise InputError(f"{take.source} shows no marker", expected="positions", remedy="Export the trajectories again.")
    frame = take.positions_m[take.seen.sum(axis=1).argmax()]
    spread = float(np.nanmax(np.nanmax(frame, axis=0) - np.nanmin(frame, axis=0)))
    if not _SPREAD_M[0] <= spread <= _SPREAD_M[1]:
        raise InputError(
            f"the markers of {take.source} spread over {spread:.4g} m",
            expected=f"{_SPREAD_M[0]:g} to {_SPREAD_M[1]:g} m",
            remedy="Name the unit of the file's numbers (m, cm, mm).",
        )
