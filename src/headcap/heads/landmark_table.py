"""Tables in which other programs write landmarks: CSV with a header, a row per landmark or per frame."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from headcap.errors import InputError

Cell = TypeVar("Cell")


@dataclass(frozen=True)
class LandmarkTable:
    """A CSV file's rows, as they were written."""

    columns: tuple[str, ...]
    rows: tuple[dict[str, str], ...]
    """Cells by column; empty where a row is short."""
    lines: tuple[int, ...]
    """Of the file, on which each row ends."""

    @classmethod
    def read(cls, path: Path | str) -> LandmarkTable:
        """Read a file, with spaces or a byte order mark or without; raises `InputError` where it is no text."""
        try:
            with Path(path).open(newline="", encoding="utf-8-sig") as handle:
                reader = csv.DictReader(handle, restval="", skipinitialspace=True)
                reader.fieldnames = [name.strip() for name in reader.fieldnames or ()]
                told = [(row, reader.line_num) for row in reader]
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise InputError(f"a table that cannot be read ({error})", expected="CSV", remedy="Export it again.") from error
        return cls(tuple(reader.fieldnames), tuple(row for row, _ in told), tuple(line for _, line in told))

    def has(self, *columns: str) -> bool:
        """Whether it has all of some columns."""
        return set(columns) <= set(self.columns)

    def column(self, name: str, read: Callable[[str], Cell]) -> list[Cell]:
        """Cells of a column, each read as a number or what else it is; raises `InputError` with the line of one that is not."""
        out = []
        for row, line in zip(self.rows, self.lines, strict=True):
            try:
                out.append(read(row[name]))
            except ValueError as error:
                raise InputError(f"line {line}: {error}", expected="numbers", remedy="Correct the line.") from error
        return out


def coordinate(cell: str) -> float:
    """A number, NaN where nothing is written."""
    return float(cell) if cell.strip() else float("nan")


def landmark_file(path: Path | str) -> Path:
    """A path of landmarks; raises `InputError` unless it ends in .json or .csv."""
    path = Path(path)
    if path.suffix not in (".json", ".csv"):
        raise InputError(f"{path} of landmarks", expected="a file that ends in .json or .csv", remedy="Convert it.")
    return path
