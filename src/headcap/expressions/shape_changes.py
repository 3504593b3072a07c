"""What conversion did to hand-made shapes: overlap before and after, and how far each moved (quasi-eigen paper, section 4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.expressions.basis import ExpressionBasis, QuasiEigenFaces

OVERLAP = 0.9
"""Cosine from which two shapes say nearly the same."""


@dataclass(frozen=True)
class Overlap:
    """Two hand-made shapes that say nearly the same, before or after projection (preventive treatments)."""

    first: str
    second: str
    before: float
    """Cosine between the hand-made shapes; -1 are opposites, which span as little as equals do."""
    after: float
    """Cosine between the quasi-eigen faces."""


@dataclass(frozen=True, eq=False)
class ShapeChanges:
    """How far projection moved each of k hand-made shapes, at weight 1."""

    names: tuple[str, ...]
    kept: NDArray[np.float64]
    """(k,) norm of the quasi-eigen face over that of the hand-made shape: near 0 where the performance never exercises it."""
    angle_deg: NDArray[np.float64]
    """(k,) between the two as vectors of 3 n numbers."""
    rms_mm: NDArray[np.float64]
    """(k,) over all points."""
    largest_mm: NDArray[np.float64]
    """(k,) at the point that moved most."""


def cosines(basis: ExpressionBasis, others: ExpressionBasis | None = None) -> NDArray[np.float64]:
    """(k, j) cosines between displacements of two bases' shapes, or of one's; 0 beside shapes that do not move."""
    left, right = _unit_rows(basis), _unit_rows(others or basis)
    return np.clip(left @ right.T, -1.0, 1.0)


def _unit_rows(basis: ExpressionBasis) -> NDArray[np.float64]:
    rows = basis.rows.astype(np.float64)
    length = np.linalg.norm(rows, axis=1)
    return rows / np.where(length > 0, length, 1.0)[:, None]


def overlaps(faces: QuasiEigenFaces, threshold: float = OVERLAP) -> tuple[Overlap, ...]:
    """Pairs of hand-made shapes whose cosine reaches the threshold before or after projection, the nearest first."""
    before, after = cosines(faces.hand), cosines(faces.quasi)[: len(faces.hand), : len(faces.hand)]
    nearest = np.triu(np.maximum(np.abs(before), np.abs(after)), 1)
    first, second = np.nonzero(nearest >= threshold)
    order = np.argsort(-nearest[first, second], kind="stable")
    names = faces.hand.names
    return tuple(
        Overlap(names[i], names[j], float(before[i, j]), float(after[i, j]))
        for i, j in zip(first[order], second[order], strict=True)
    )


def shape_changes(faces: QuasiEigenFaces) -> ShapeChanges:
    """What projection did to every hand-made shape; augmented eigenfaces have none."""
    hand = faces.hand.displacements.astype(np.float64)
    quasi = faces.quasi.displacements[: len(hand)].astype(np.float64)
    before, after = (np.linalg.norm(shapes, axis=(1, 2)) for shapes in (hand, quasi))
    both = before * after
    cosine = np.einsum("knc,knc->k", hand, quasi) / np.where(both > 0, both, 1.0)
    moved = np.linalg.norm(quasi - hand, axis=2)
    return ShapeChanges(
        names=faces.hand.names,
        kept=after / np.where(before > 0, before, 1.0),
        angle_deg=np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))),
        rms_mm=1e3 * np.sqrt((moved**2).mean(axis=1)),
        largest_mm=1e3 * moved.max(axis=1),
    )
