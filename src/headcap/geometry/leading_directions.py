"""Leading directions of tall matrices whose rows do not fit in memory: singular vectors, principal components.

Rows that can be read again are read pass after pass, from files or made anew, in blocks of any size; nothing but the directions
is kept. `principal_components` takes a set number of passes in single precision, which serves the many columns of meshes;
`leading_directions` goes on until nothing is gained and may start near the answer, which serves what is found again and again,
and `covering_directions`, which takes as many as hold a share of the energy. Where rows or columns are few, `exact_directions`
decomposes their products, which is exact.
Rows that are dear to make are taken in once, as they come (`RowSketch`): twice the directions are kept, and what these cut off
is lost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

Blocks = Callable[[], Iterable[NDArray]]
"""Gives the rows of a tall matrix anew at each call, in blocks (f, c)."""

OVERSAMPLING = 10
SETTLED, MOST_PASSES = 1e-3, 12
LEAST = 1e-4
"""Directions whose singular value is below this share of the largest are single precision's rounding."""
_FIRST = 48
"""Directions that a search for a share of the energy begins with."""
_MERGED = 256
"""Rows that are merged at once."""
_BLOCK = 4096
_SPARE, _ROUNDS = 12, 2
"""Directions beyond those wanted, and passes that sharpen them: the spectrum of what moves on a face falls fast."""


@dataclass(frozen=True, eq=False)
class Directions:
    """k leading directions of rows with c numbers each."""

    vectors: NDArray[np.float64]
    """(k, c) orthonormal rows."""
    values: NDArray[np.float64]
    """(k,) singular values, falling."""
    energy: float
    """Sum of squares of all rows."""

    def first(self, count: int) -> Directions:
        """The leading ones, at most `count`."""
        return Directions(self.vectors[:count], self.values[:count], self.energy)

    def told(self) -> Directions:
        """Those that single precision tells from nothing."""
        return self.first(int((self.values > LEAST * self.values.max(initial=0.0)).sum()))


@dataclass(frozen=True, eq=False)
class PrincipalComponents:
    """k leading directions of rows with c numbers each about their mean, in single precision."""

    mean: NDArray[np.float32]
    """(c,)"""
    vectors: NDArray[np.float32]
    """(k, c) orthonormal rows, of falling variance."""
    energy: float
    """Sum of squares about the mean."""

    def coordinates(self, rows: NDArray) -> NDArray:
        """(f, k) of rows (f, c)."""
        return _about(rows, self.mean, self.vectors.T)


def leading_directions(blocks: Blocks, columns: int, count: int, *, start: NDArray | None = None, seed: int = 0) -> Directions:
    """Leading right singular vectors and singular values of a tall matrix, `count` of them.

    Randomised subspace iteration with Rayleigh-Ritz (Halko et al. 2011): every pass reads the matrix once. `start` (any, c) are
    directions near the wanted ones. Stops when a pass changes the captured energy by less than a thousandth of what is left.
    Products are taken in the precision of the rows, energies in double.
    """
    width = min(count + OVERSAMPLING, columns)
    rows, captured = _filled(start, width, columns, seed), -np.inf
    for _ in range(MOST_PASSES):
        subspace = _orthonormal(rows)
        image, energy = _power(blocks, subspace)
        values, turn = np.linalg.eigh(subspace @ image.T)
        values, turn = values[::-1], turn[:, ::-1]
        before, captured = captured, float(values[:count].sum())
        if captured - before <= SETTLED * max(energy - captured, 0.0) + 1e-12 * energy:
            break
        rows = turn.T @ image
    return Directions((turn.T @ subspace)[:count], np.sqrt(np.maximum(values[:count], 0.0)), energy)


def covering_directions(blocks: Blocks, columns: int, share: float, *, most: int, seed: int = 0) -> Directions:
    """The fewest leading directions that hold a share of the energy; `most` of them where these do not reach it.

    How many these are is not known before: the search doubles its directions and begins where the last one ended.
    """
    count, start = min(_FIRST, most), None
    while True:
        found = leading_directions(blocks, columns, count, start=start, seed=seed)
        reached = covering(found, share)
        if reached <= count or count == most:
            return found.first(reached)
        count, start = min(2 * count, most), found.vectors


def covering(found: Directions, share: float) -> int:
    """How many of the directions hold a share of the energy; one more than there are where they do not."""
    # to rounding: a share of 1 is reached by all directions of an exact decomposition
    return int(np.searchsorted(np.cumsum(found.values**2), share * found.energy * (1 - 1e-9))) + 1


def exact_directions(blocks: Blocks, columns: int) -> Directions:
    """All directions that single precision tells from nothing, by the products of columns, or of rows where these are fewer.

    Products are summed in double. Memory is that of the rows where these are fewer, else that of columns x columns.
    """
    rows = sum(len(block) for block in blocks())
    if columns <= rows:
        squares = np.zeros((columns, columns))
        for block in blocks():
            squares += block.T.astype(np.float64) @ block
        values, turn = np.linalg.eigh(squares)
        return _told(values, lambda kept: np.ascontiguousarray(turn[:, kept].T), float(np.trace(squares)))
    matrix = np.concatenate(list(blocks()))
    parts = [slice(first, first + _BLOCK) for first in range(0, columns, _BLOCK)]
    squares = sum(part @ part.T for part in (matrix[:, cut].astype(np.float64) for cut in parts))
    values, turn = np.linalg.eigh(squares)

    def vectors(kept: NDArray) -> NDArray[np.float64]:
        back = (turn[:, kept] / np.sqrt(values[kept])).T
        return np.concatenate([back @ matrix[:, cut] for cut in parts], axis=1)

    return _told(values, vectors, float(np.trace(squares)))


def principal_components(blocks: Blocks, columns: int, count: int, *, seed: int = 0) -> PrincipalComponents:
    """Mean and leading directions about it, at most `count`: those that single precision tells from nothing.

    Randomised range finder with power iterations (Halko, Martinsson & Tropp 2011, algorithms 4.4 and 5.1), sums in double: rows
    are read eight times and never copied; memory is that of (rows + columns) x count.
    """
    total, rows = np.zeros(columns), 0
    for block in blocks():
        total += block.sum(axis=0, dtype=np.float64)
        rows += len(block)
    mean = (total / rows).astype(np.float32)
    energy = sum(float(np.square(row - mean, dtype=np.float64).sum()) for block in blocks() for row in block)
    wanted = min(count + _SPARE, rows, columns)
    directions = np.random.default_rng(seed).normal(size=(columns, wanted)).astype(np.float32)
    for _ in range(_ROUNDS + 1):
        seen = np.linalg.qr(np.concatenate([_about(block, mean, directions) for block in blocks()]))[0]
        directions = _back(blocks, mean, seen)
    return PrincipalComponents(mean, _principal_axes(directions, count), energy)


def reduce_rows(blocks: Blocks, columns: int, count: int, *, seed: int = 0) -> tuple[NDArray, NDArray, float]:
    """Rows of a tall matrix in their leading coordinates (f, count), the directions (count, c), and the energy left out."""
    found = leading_directions(blocks, columns, count, seed=seed)
    directions = found.vectors.astype(np.float32)
    reduced = np.concatenate([block @ directions.T for block in blocks()])
    return reduced, directions, max(found.energy - float((reduced.astype(float) ** 2).sum()), 0.0)


class RowSketch:
    """Leading directions of rows seen one time only: the leading part of all rows so far, merged with each new block.

    Incremental singular value decomposition (Brand 2002; Ross et al. 2008) through the Gram matrix of the rows: memory holds
    `rank` rows and one block. What is cut off at each merge is smaller than the `rank`-th direction; with a rank of twice the
    directions wanted these are those of the whole matrix to a small part of a per cent of its energy.
    """

    def __init__(self, columns: int, rank: int) -> None:
        self._rank, self._rows = rank, np.zeros((0, columns), np.float32)
        self._pending: list[NDArray] = []
        self._energy = 0.0

    def add(self, rows: NDArray) -> None:
        """Take in rows (f, c)."""
        rows = np.ascontiguousarray(rows, np.float32)
        self._energy += _energy(rows)
        self._pending.append(rows)
        if sum(len(part) for part in self._pending) >= _MERGED:
            self._merge(self._rank)

    def directions(self, count: int) -> Directions:
        """Of all rows so far, at most `count`: those that single precision tells from nothing."""
        self._merge(self._rank)
        length = np.linalg.norm(self._rows.astype(np.float64), axis=1)
        order = np.argsort(-length, kind="stable")
        order = order[length[order] > LEAST * length.max(initial=0.0)][:count]
        # single precision left them orthogonal to a few parts in a million
        unit, upper = qr(self._rows[order].T.astype(np.float64), mode="economic")
        return Directions(np.ascontiguousarray((unit * np.sign(np.diagonal(upper))).T), length[order], self._energy)

    def _merge(self, rank: int) -> None:
        if not self._pending:
            return
        rows = np.concatenate([self._rows, *self._pending])
        self._pending = []
        values, turn = np.linalg.eigh((rows @ rows.T).astype(np.float64))
        kept = np.flatnonzero(values > 0)[::-1][:rank]
        self._rows = turn[:, kept].T.astype(np.float32) @ rows


def _power(blocks: Blocks, subspace: NDArray) -> tuple[NDArray, float]:
    """S^T S applied to the rows of a subspace (w, c), and the energy of S."""
    image, energy = np.zeros_like(subspace), 0.0
    for block in blocks():
        basis = subspace.astype(block.dtype)
        image += (block @ basis.T).T.astype(block.dtype) @ block
        energy += _energy(block)
    return image, energy


def _energy(rows: NDArray) -> float:
    return float(np.einsum("fc,fc->", rows, rows, dtype=np.float64))


def _told(squares: NDArray, vectors: Callable[[NDArray], NDArray], energy: float) -> Directions:
    """Directions of rising squared singular values, without those of rounding."""
    kept = np.argsort(squares)[::-1]
    kept = kept[squares[kept] > LEAST**2 * max(squares.max(initial=0.0), 0.0)]
    return Directions(vectors(kept), np.sqrt(squares[kept]), energy)


def _filled(start: NDArray | None, width: int, columns: int, seed: int) -> NDArray:
    random = np.random.default_rng(seed).standard_normal((width, columns))
    if start is not None and len(start):
        random[: min(len(start), width)] = start[:width] * np.sqrt(columns)
    return random


def _orthonormal(rows: NDArray) -> NDArray[np.float64]:
    return np.ascontiguousarray(qr(rows.T, mode="economic")[0].T)


def _principal_axes(directions: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    """(k, c) principal axes of directions (c, j) by their Gram matrix in double: a tenth of the time of a decomposition of all.

    What single precision does not tell from nothing is left out.
    """
    gram = np.zeros((directions.shape[1],) * 2)
    for start in range(0, len(directions), _BLOCK):
        block = directions[start : start + _BLOCK].astype(np.float64)
        gram += block.T @ block
    values, turn = np.linalg.eigh(gram)
    kept = np.argsort(values)[::-1][:count]
    kept = kept[values[kept] > (LEAST**2) * values.max(initial=0.0)]
    return np.ascontiguousarray((directions @ (turn[:, kept] / np.sqrt(values[kept])).astype(np.float32)).T)


def _about(rows: NDArray, mean: NDArray, directions: NDArray) -> NDArray:
    """Products (f, j) of rows about the mean with directions (c, j)."""
    return rows @ directions - mean @ directions


def _back(blocks: Blocks, mean: NDArray, seen: NDArray) -> NDArray[np.float32]:
    """The rows' own combinations (c, j) by what was seen of each (f, j)."""
    out, first = -np.outer(mean, seen.sum(axis=0)), 0
    for block in blocks():
        out += block.T @ seen[first : first + len(block)]
        first += len(block)
    return out
