"""Weights of named shapes over time, w_i(t) of eq. 1 of the quasi-eigen paper, as tables that other programs read."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import atomic_path, save_json
from headcap.errors import InputError

KIND, SCHEMA = "expression_weights", 1
TIME = "time_s"


@dataclass(frozen=True, eq=False)
class WeightCurves:
    """Weights (l, k) of k shapes at l moments."""

    names: tuple[str, ...]
    time_s: NDArray[np.float64]
    """(l,), rising."""
    weights: NDArray[np.float64]
    """(l, k)"""

    def __post_init__(self) -> None:
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "time_s", np.asarray(self.time_s, np.float64))
        object.__setattr__(self, "weights", np.asarray(self.weights, np.float64))
        if self.weights.shape != (len(self.time_s), len(self.names)):
            raise ValueError(f"weights {self.weights.shape} of {len(self.names)} shapes at {len(self.time_s)} moments")

    def __len__(self) -> int:
        return len(self.time_s)

    def of(self, names: Sequence[str]) -> WeightCurves:
        """The curves of some shapes in the order asked for; raises `InputError` where there is none for a name."""
        missing = [name for name in names if name not in self.names]
        if missing:
            raise InputError(
                f"no weights of {', '.join(missing)}",
                expected=f"all of the basis' {len(names)} shapes",
                remedy="Give the weights that were solved with this basis.",
            )
        return WeightCurves(names, self.time_s, self.weights[:, [self.names.index(name) for name in names]])


def write_weights(path: Path | str, curves: WeightCurves) -> None:
    """Write weights as CSV (a header `time_s` and the shapes' names, a row per frame) or JSON (`names`, `time_s`, `weights`).

    Numbers are told to their last bit. Raises `InputError` for another ending of the file's name, and where a number is none.
    """
    path = Path(path)
    suffix = _suffix(path)
    if not (np.isfinite(curves.weights).all() and np.isfinite(curves.time_s).all()):
        frame = int(np.argmin(np.isfinite(curves.weights).all(axis=1) & np.isfinite(curves.time_s)))
        raise InputError(f"frame {frame} has a weight that is no number", expected="none", remedy="Solve for the weights anew.")
    if suffix == ".json":
        content = {"names": list(curves.names), TIME: curves.time_s.tolist(), "weights": curves.weights.tolist()}
        return save_json(path, KIND, SCHEMA, content)
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as handle:
        writer = csv.writer(handle, lineterminator="\n")
        writer.writerow([TIME, *curves.names])
        writer.writerows([time, *row] for time, row in zip(curves.time_s.tolist(), curves.weights.tolist(), strict=True))


def read_weights(path: Path | str) -> WeightCurves:
    """Read what `write_weights` wrote, or a table of another program's in either form.

    Raises `InputError` for a file that is absent or neither, a header without `time_s` or with a name twice, a row of another
    length or with a cell that is no number (which line), and times that do not rise.
    """
    path = Path(path)
    reader = _read_json if _suffix(path) == ".json" else _read_csv
    try:
        names, rows, labels = reader(path)
    except InputError:
        raise
    except (OSError, ValueError, KeyError, TypeError, AttributeError, csv.Error) as error:
        raise _refused(path, str(error), "weights with names and times") from error
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise _refused(path, f"{', '.join(twice)} twice", "each name once")
    table = _numbers(path, rows, labels, 1 + len(names))
    falling = np.flatnonzero(np.diff(table[:, 0]) <= 0)
    if len(falling):
        raise _refused(path, f"{labels[falling[0] + 1]} is no later than the one before", "times that rise")
    return WeightCurves(tuple(names), table[:, 0], table[:, 1:])


def _read_csv(path: Path) -> tuple[list[str], list[list], list[str]]:
    """Names, rows of time and weights, and what messages call the rows."""
    with path.open(newline="", encoding="utf-8-sig") as handle:
        reader = csv.reader(handle, skipinitialspace=True)
        header = [cell.strip() for cell in next(reader, [])]
        told = [(row, f"line {reader.line_num}") for row in reader if row]
    if not header or header[0] != TIME or len(header) < 2:
        raise _refused(path, f"a header {','.join(header)[:60]!r}", f"{TIME} and the names of shapes")
    return header[1:], [row for row, _ in told], [label for _, label in told]


def _read_json(path: Path) -> tuple[list[str], list[list], list[str]]:
    told = json.loads(path.read_text(encoding="utf-8"))
    names, times, weights = [str(name) for name in told["names"]], told[TIME], told["weights"]
    if len(times) != len(weights):
        raise _refused(path, f"{len(times)} times for {len(weights)} rows of weights", "as many")
    rows = [[time, *row] for time, row in zip(times, weights, strict=True)]
    return names, rows, [f"frame {i}" for i in range(len(rows))]


def _numbers(path: Path, rows: list[list], labels: list[str], width: int) -> NDArray[np.float64]:
    out = np.empty((len(rows), width))
    for row, label, into in zip(rows, labels, out, strict=True):
        if len(row) != width:
            raise _refused(path, f"{label} of {len(row)} numbers", f"{width}: the time and a weight per name")
        try:
            into[:] = [float(cell) for cell in row]
        except (TypeError, ValueError) as error:
            raise _refused(path, f"{label}: {error}", "numbers") from error
        if not np.isfinite(into).all():
            raise _refused(path, f"{label} has a number that is not finite", "finite numbers")
    return out


def _suffix(path: Path) -> str:
    suffix = path.suffix.lower()
    if suffix not in (".csv", ".json"):
        raise InputError(f"{path.name} of weights", expected="a file that ends in .csv or .json", remedy="Name it so.")
    return suffix


def _refused(path: Path, found: str, expected: str) -> InputError:
    return InputError(f"{path.name}: {found}", expected=expected, remedy="Correct the file, or export it again.")
