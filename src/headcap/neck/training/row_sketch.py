"""Leading directions of a tall matrix whose rows come once, in blocks, and are not kept."""

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr

_BLOCK = 256


class RowSketch:
    """Principal directions of rows seen one time only: the leading part of all rows so far, merged with each new block.

    Incremental singular value decomposition (Brand 2002; Ross et al. 2008) through the Gram matrix of the rows: memory holds
    `rank` rows and one block. What is cut off at each merge is smaller than the `rank`-th direction; with a rank of twice the
    directions wanted these are those of the whole matrix to a small part of a per cent of its energy.
    """

    def __init__(self, columns: int, rank: int) -> None:
        self._rank, self._rows = rank, np.zeros((0, columns), np.float32)
        self._pending: list[NDArray] = []
        self.energy = 0.0
        """Sum of squares of all rows."""

    def add(self, rows: NDArray) -> None:
        """Take in rows (f, c)."""
        rows = np.ascontiguousarray(rows, np.float32)
        self.energy += float(np.einsum("fc,fc->", rows, rows, dtype=np.float64))
        self._pending.append(rows)
        if sum(len(part) for part in self._pending) >= _BLOCK:
            self._merge(self._rank)

    def directions(self, count: int, *, least: float = 1e-4) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Orthonormal rows (k, c) and singular values (k,), falling, k <= count: those above a share of the largest."""
        self._merge(self._rank)
        length = np.linalg.norm(self._rows.astype(np.float64), axis=1)
        order = np.argsort(-length, kind="stable")
        order = order[length[order] > least * length.max(initial=0.0)][:count]
        # single precision left them orthogonal to a few parts in a million
        unit, upper = qr(self._rows[order].T.astype(np.float64), mode="economic")
        return np.ascontiguousarray((unit * np.sign(np.diagonal(upper))).T), length[order]

    def _merge(self, rank: int) -> None:
        if not self._pending:
            return
        rows = np.concatenate([self._rows, *self._pending])
        self._pending = []
        values, turn = np.linalg.eigh((rows @ rows.T).astype(np.float64))
        kept = np.flatnonzero(values > 0)[::-1][:rank]
        self._rows = turn[:, kept].T.astype(np.float32) @ rows
