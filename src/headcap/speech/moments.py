"""Sums from which every ridge regression and its error on other takes follow: one pass over the frames, ever."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError


@dataclass(frozen=True)
class Moments:
    """Count, mean and scatter of the rows (inputs, outputs) of a take or of several."""

    inputs: int
    """Number of input columns p; the q outputs follow them."""
    frames: int
    mean: NDArray[np.float64]
    """(p + q,)"""
    scatter: NDArray[np.float64]
    """(p + q, p + q) sum of products of deviations from the mean."""
    skipped: int = 0
    """Frames left out because an input or output was no number."""
    dimensions: int | None = None
    """Of the space in which inputs are coordinates of a part; None: p."""

    @property
    def outputs(self) -> int:
        """Number of output columns q."""
        return len(self.mean) - self.inputs

    def gram(self, *, centred: bool) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """X^T X (p, p) and X^T Y (p, q), about the mean or about zero."""
        products = self.scatter[: self.inputs]
        if not centred:
            products = products + self.frames * np.outer(self.mean[: self.inputs], self.mean)
        return products[:, : self.inputs], products[:, self.inputs :]

    def within(self, directions: NDArray) -> Moments:
        """Of inputs as coordinates along orthonormal columns (p, r) that span them."""
        p = self.inputs
        carried = directions.T @ self.scatter[:p]
        inside, across = carried[:, :p] @ directions, carried[:, p:]
        scatter = np.block([[inside, across], [across.T, self.scatter[p:, p:]]])
        mean = np.concatenate([directions.T @ self.mean[:p], self.mean[p:]])
        return Moments(directions.shape[1], self.frames, mean, scatter, self.skipped, self.dimensions or p)

    def squared_error(self, weights: NDArray, bias: NDArray) -> NDArray[np.float64]:
        """Sum over these frames of (y - x weights - bias)^2 for each output (q,); weights (p, q), bias (q,)."""
        p, scatter = self.inputs, self.scatter
        spread = np.diag(scatter)[p:] + (weights * (scatter[:p, :p] @ weights - 2 * scatter[:p, p:])).sum(axis=0)
        offset = self.mean[p:] - self.mean[:p] @ weights - bias
        return np.maximum(spread, 0) + self.frames * offset**2


def moments_of(blocks: Iterable[tuple[NDArray, NDArray]]) -> Moments:
    """Moments of a take from blocks of frames, inputs (n, p) with outputs (n, q), that are held one at a time.

    Frames that hold a value that is no number are skipped and counted. Raises `InputError` where no frame is left.
    """
    total, skipped = None, 0
    for inputs, outputs in blocks:
        rows = np.hstack([inputs, np.reshape(outputs, (len(inputs), -1))], dtype=np.float64)
        good = np.isfinite(rows).all(axis=1)
        skipped += len(rows) - np.count_nonzero(good)
        rows = rows[good]
        if len(rows):
            mean = rows.mean(axis=0)
            rows -= mean
            found = Moments(inputs.shape[1], len(rows), mean, rows.T @ rows)
            total = found if total is None else pooled([total, found])
    if total is None:
        raise InputError(
            f"{skipped} frames without a whole set of numbers, and no other", expected="frames to learn from",
            remedy="Look at the take's features and coefficients",
        )  # fmt: skip
    return Moments(total.inputs, total.frames, total.mean, total.scatter, skipped)


def pooled(parts: Sequence[Moments]) -> Moments:
    """Moments of several takes together (Chan, Golub and LeVeque 1979: no difference of large sums is formed)."""
    first = parts[0]
    if len(parts) == 1:
        return first
    counts = np.array([part.frames for part in parts])
    mean = np.average([part.mean for part in parts], axis=0, weights=counts)
    away = np.sqrt(counts)[:, None] * (np.array([part.mean for part in parts]) - mean)
    scatter = away.T @ away
    for part in parts:
        scatter += part.scatter
    skipped = sum(part.skipped for part in parts)
    return Moments(first.inputs, int(counts.sum()), mean, scatter, skipped, first.dimensions)
