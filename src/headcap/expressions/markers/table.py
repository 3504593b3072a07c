"""Rows of text as numbers, where blanks are gaps."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError


def numbers(rows: list[list[str]], columns: int, path: Path, first_line: int) -> NDArray[np.float64]:
    """(rows, columns), NaN where a cell is blank or a row ends early; raises `InputError` naming the line that is wrong."""
    table = np.full((len(rows), columns), np.nan)
    for row, cells in enumerate(rows):
        cells = [cell.strip() for cell in cells]
        if any(cells[columns:]):
            raise _refusal(path, first_line + row, f"has more than {columns} cells")
        try:
            table[row, : len(cells)] = [float(cell) if cell else np.nan for cell in cells[:columns]]
        except ValueError as error:
            raise _refusal(path, first_line + row, f"is no row of numbers ({error})") from error
    return table


def triples(table: NDArray) -> NDArray[np.float64]:
    """Columns x, y, z of one marker after the other as (f, k, 3); a marker with one coordinate missing is not seen."""
    positions = table.reshape(len(table), -1, 3).copy()
    positions[~np.isfinite(positions).all(axis=2)] = np.nan
    return positions


def _refusal(path: Path, line: int, what: str) -> InputError:
    return InputError(
        f"{path.name}: line {line} {what}", expected="numbers or blanks under every column", remedy="Mend that line."
    )
