"""How well a basis reproduces a performance (quasi-eigen paper, eq. 6): of the face, of the motion, in millimetres, by place.

Frames are streamed: one block of them is in memory at a time, whatever the performance's length.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.expressions import Eigenfaces, ExpressionBasis, Performance
from headcap.expressions.weights import Bounds, ExpressionSolver

SPAN_TOLERANCE = 1e-5
"""Directions in which a basis is thinner than this, of its widest, are rounding of its float32 shapes and not counted."""

Progress = Callable[[int, int], None]
"""Called with frames done and frames in all."""


@dataclass(frozen=True, eq=False)
class Reproduction:
    """l frames of n points by one basis, each frame with the weights that suit it best (eq. 5)."""

    alpha_pct: float
    """Eq. 6 over all frames: root of summed squared errors over that of positions, origin at the neutral face's centroid."""
    displacement_pct: float
    """The same errors over the displacements from the neutral face, which depends on no origin."""
    rms_mm: float
    """Rms over points and frames of the distance between reproduced and performed point."""
    frame_alpha_pct: NDArray[np.float64]
    """(l,) eq. 6 frame by frame."""
    frame_rms_mm: NDArray[np.float64]
    """(l,)"""
    vertex_rms_mm: NDArray[np.float64]
    """(n,)"""
    region_rms_mm: dict[str, float]
    """By region of the performance."""
    dimensions: int
    """Directions of its own that the basis has; fewer than its shapes where these depend on each other."""
    alpha_by_size_pct: NDArray[np.float64]
    """(j + 1,) eq. 6 with no shape, one, two... in the order `order`; empty where weights are bounded."""
    order: tuple[int, ...]
    """(j,) eigenfaces as they come; of shapes always the one that takes most of the error left (greedy, free weights)."""


def reproduction(performance: Performance, basis: ExpressionBasis | Eigenfaces, *, bounds: Bounds = None) -> Reproduction:
    """Reproduce all frames with a basis, least squares per frame, and judge it (eq. 5, 6).

    Eigenfaces come with their mean, as eq. 2 has them. `bounds` are a least and a largest weight, None for free ones;
    eigenfaces are always free. Raises `InputError` for another number of points or a performance without frames.
    """
    return reproductions(performance, [basis], [bounds])[0]


def reproductions(
    performance: Performance,
    bases: Sequence[ExpressionBasis | Eigenfaces],
    bounds: Sequence[Bounds],
    progress: Progress | None = None,
) -> list[Reproduction]:
    """`reproduction` of several bases in one passage over the frames."""
    judges = [_judge(performance, basis, bound) for basis, bound in zip(bases, bounds, strict=True)]
    done = 0
    for block in performance.blocks():
        displacements = np.asarray(block, np.float64)
        for judge in judges:
            judge.add(displacements)
        done += len(block)
        if progress:
            progress(done, len(performance))
    if not done:
        raise InputError(f"{performance.source}: no frames", expected="a performance", remedy="Give one with frames.")
    return [judge.result() for judge in judges]


def orthonormal_rows(rows: NDArray) -> NDArray[np.float64]:
    """(r, 3 n) directions that span the rows (k, 3 n) up to `SPAN_TOLERANCE`."""
    rows = np.asarray(rows, np.float64)
    # a shape that hardly moves is a direction like any other
    rows = rows / np.maximum(np.linalg.norm(rows, axis=1), np.finfo(np.float64).tiny)[:, None]
    values, vectors = np.linalg.eigh(rows @ rows.T)
    # the Gram matrix squares the tolerance to what float64 still tells apart; the second passage makes the rows straight
    kept = values > max(values.max(initial=0.0), 1e-300) * SPAN_TOLERANCE**2
    spanning = (vectors[:, kept] / np.sqrt(values[kept])).T @ rows
    return np.linalg.qr(spanning.T)[0].T if len(spanning) else spanning


def greedy_order(shapes: NDArray, energy: NDArray) -> tuple[tuple[int, ...], NDArray[np.float64]]:
    """Order of shapes (k, r), and the energy (j,) each takes in turn, of data with second moments `energy` (r, r).

    Forward selection: next comes the shape whose part outside the chosen ones' span takes most. Shapes without such a part
    are left out.
    """
    left = np.array(shapes, np.float64)
    least = SPAN_TOLERANCE * np.linalg.norm(left, axis=1).max(initial=0.0)
    order, taken = [], []
    while True:
        norms = np.linalg.norm(left, axis=1)
        norms[order] = 0
        able = np.flatnonzero(norms > least)
        if not len(able):
            return tuple(order), np.array(taken)
        ways = left[able] / norms[able, None]
        takes = np.einsum("kr,rs,ks->k", ways, energy, ways)
        best = int(takes.argmax())
        order.append(int(able[best]))
        taken.append(float(takes[best]))
        # twice, so that rounding leaves nothing of the way behind
        for _ in range(2):
            left -= np.outer(left @ ways[best], ways[best])


class _Sums:
    """Squared errors by frame and point, summed block by block, beside squared positions and displacements."""

    def __init__(self, performance: Performance) -> None:
        self.performance = performance
        neutral = performance.neutral.astype(np.float64)
        self.centred = neutral - neutral.mean(axis=0)
        self.points = np.zeros(len(neutral))
        self.error, self.position = [], []
        self.displacement = 0.0

    def add(self, displacements: NDArray, residual: NDArray) -> None:
        """Take in a block (l, n, 3) of displacements and what a basis leaves of it, metres."""
        squares = np.einsum("lnk,lnk->ln", residual, residual)
        self.points += squares.sum(axis=0)
        self.error.append(squares.sum(axis=1))
        positions = displacements + self.centred
        self.position.append(np.einsum("lnk,lnk->l", positions, positions))
        self.displacement += float(np.vdot(displacements, displacements))

    def result(self, dimensions: int, by_size: tuple[tuple[int, ...], NDArray]) -> Reproduction:
        """Errors of all blocks, with the number of directions and the order of shapes and squared error left by basis size."""
        error, position = np.concatenate(self.error), np.concatenate(self.position)
        frames, points = len(error), len(self.points)
        vertex = 1e3 * np.sqrt(self.points / frames)
        order, energies = by_size
        return Reproduction(
            alpha_pct=_share_pct(error.sum(), position.sum()),
            displacement_pct=_share_pct(error.sum(), self.displacement),
            rms_mm=float(1e3 * np.sqrt(error.sum() / (frames * points))),
            frame_alpha_pct=100 * np.sqrt(error / position),
            frame_rms_mm=1e3 * np.sqrt(error / points),
            vertex_rms_mm=vertex,
            region_rms_mm={
                name: float(np.sqrt((vertex[mask] ** 2).mean())) for name, mask in self.performance.regions.items() if mask.any()
            },
            dimensions=dimensions,
            alpha_by_size_pct=100 * np.sqrt(np.maximum(energies, 0) / position.sum()),
            order=order,
        )


class _FreeJudge:
    """Free weights: what is left is what lies outside the span, whichever of its bases the weights are told in."""

    def __init__(self, performance: Performance, basis: ExpressionBasis | Eigenfaces) -> None:
        self.sums = _Sums(performance)
        self.mean = np.zeros(performance.columns)
        if isinstance(basis, Eigenfaces):
            self.mean, self.shapes = basis.mean.ravel().astype(np.float64), None
            # straight already but for rounding; QR keeps the spans of the first one, two...
            self.span = np.linalg.qr(basis.rows.astype(np.float64).T)[0].T
        else:
            self.span = orthonormal_rows(basis.rows)
            self.shapes = basis.rows.astype(np.float64) @ self.span.T
        self.energy = np.zeros((len(self.span), len(self.span)))
        self.total = 0.0

    def add(self, displacements: NDArray) -> None:
        """Take in a block (l, n, 3) of displacements, metres."""
        rows = displacements.reshape(len(displacements), -1) - self.mean
        coordinates = rows @ self.span.T
        self.energy += coordinates.T @ coordinates
        self.total += float(np.vdot(rows, rows))
        self.sums.add(displacements, (rows - coordinates @ self.span).reshape(displacements.shape))

    def result(self) -> Reproduction:
        """Errors of all blocks."""
        if self.shapes is None:
            order, taken = tuple(range(len(self.span))), np.diag(self.energy)
        else:
            order, taken = greedy_order(self.shapes, self.energy)
        return self.sums.result(len(self.span), (order, self.total - np.concatenate([[0.0], np.cumsum(taken)])))


class _BoundedJudge:
    """Weights within bounds, by the solver that animators' weights come from."""

    def __init__(self, performance: Performance, basis: ExpressionBasis, bounds: tuple[float, float]) -> None:
        self.sums, self.rows = _Sums(performance), basis.rows.astype(np.float64)
        self.solver = ExpressionSolver(basis, bounds=bounds)

    def add(self, displacements: NDArray) -> None:
        """Take in a block (l, n, 3) of displacements, metres."""
        weights = np.asarray(self.solver.solve(displacements), np.float64)
        self.sums.add(displacements, displacements - (weights @ self.rows).reshape(displacements.shape))

    def result(self) -> Reproduction:
        """Errors of all blocks."""
        return self.sums.result(len(orthonormal_rows(self.rows)), ((), np.zeros(0)))


def _judge(performance: Performance, basis: ExpressionBasis | Eigenfaces, bounds: Bounds) -> _FreeJudge | _BoundedJudge:
    points = basis.rows.shape[1] // 3
    if points != len(performance.neutral):
        raise InputError(
            f"{performance.source} has {len(performance.neutral)} points, the basis {points}",
            expected="the same topology",
            remedy="Register the basis to the performance's neutral face first.",
        )
    if bounds is None or isinstance(basis, Eigenfaces):
        return _FreeJudge(performance, basis)
    return _BoundedJudge(performance, basis, bounds)


def _share_pct(error: float, whole: float) -> float:
    return float(100 * np.sqrt(error / whole)) if whole > 0 else float("nan")
