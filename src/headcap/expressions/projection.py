"""Hand-made shapes onto the hyperplane of a performance (quasi-eigen paper, section 4, eq. 3 and 4, post-treatments)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.expressions.basis import Eigenfaces, ExpressionBasis, QuasiEigenFaces
from headcap.expressions.influence import localised

EXCURSION = 2.0
"""Standard deviations of the performance that an eigenface added to a basis moves at weight 1: weights in [-1, 1] serve it."""
_ROUNDING = 1e-6
"""Share of the largest singular value below which rows of single precision are dependent."""


@dataclass(frozen=True)
class MissingAxis:
    """A principal axis that the hand-made shapes leave out, as an animator is told (section 4, post-treatments)."""

    axis: int
    name: str
    """Of the eigenface, as `quasi_eigen_faces` names it where it augments the basis."""
    share: float
    """Sum over the shapes of |w_ij| over the standard deviation of the performance along the axis."""
    nearest: str
    """Hand-made shape that points along the axis most."""
    correlation: float
    """Cosine between the two, signed: the sign of an axis means nothing."""
    variance_share: float
    """lambda_j over the sum of all."""


@dataclass(frozen=True, eq=False)
class SpanReport:
    """How much of a performance's variance about its mean a basis can follow, beside its eigenfaces."""

    rank: int
    """Independent shapes of the basis."""
    coverage: float
    """Share of all variance in the span of the basis."""
    eigen_coverage: float
    """Share in the span of the eigenfaces: the most that quasi-eigen faces can reach."""
    reached: NDArray[np.float64]
    """(m,) squared length of what each axis has in the span: 1 where the basis follows it whole."""


def coordinates(hand: ExpressionBasis, eigen: Eigenfaces) -> NDArray[np.float64]:
    """W^PCA-to-QE (k, m), metres: w_ij = e_j^PCA . (e_i^H - mu), eq. 3."""
    return (hand.rows @ eigen.rows.T - eigen.mean.ravel() @ eigen.rows.T).astype(np.float64)


def projected(weights: NDArray, eigen: Eigenfaces) -> NDArray[np.float32]:
    """e_i^QE = mu + sum_j w_ij e_j^PCA as displacements (k, n, 3) from the neutral face, metres: eq. 4."""
    rows = weights.astype(np.float32) @ eigen.rows
    return rows.reshape(-1, *eigen.mean.shape) + eigen.mean


def quasi_eigen_faces(
    hand: ExpressionBasis, eigen: Eigenfaces, *, missing_share: float = 0.05, augment: bool = True, locality: float = 0.0
) -> QuasiEigenFaces:
    """Convert a hand-made basis: eq. 3, eq. 4 and the post-treatments of section 4.

    With `augment` each missing axis (`missing_axes`) is added as a shape `eigenface_07`, numbered from 1 by falling variance,
    which at weight 1 moves two standard deviations of the performance along its axis; without, they are only listed. `locality`
    above 0 keeps each shape to the region it was sculpted in (`influence.localised`), at the price of leaving the hyperplane.
    """
    weights = coordinates(hand, eigen)
    missing = missing_axes(weights, eigen, missing_share)
    made = projected(weights, eigen) if locality == 0 else localised(hand, eigen, locality)
    names = hand.names
    if augment and missing:
        axes = list(missing)
        scale = EXCURSION * np.sqrt(eigen.variances[axes]).astype(np.float32)
        made = np.concatenate([made, scale[:, None, None] * eigen.vectors[axes]])
        names = names + tuple(eigenface_name(axis) for axis in axes)
    quasi = ExpressionBasis(names, hand.neutral, made, hand.triangles)
    return QuasiEigenFaces(hand, eigen, quasi, weights, missing)


def eigenface_name(axis: int) -> str:
    """Name of an axis that is counted from 0, as animators count: from 1."""
    return f"eigenface_{axis + 1:02d}"


def missing_axes(weights: NDArray, eigen: Eigenfaces, share: float) -> tuple[int, ...]:
    """Axes j with sum_i |w_ij| < epsilon_j, of coordinates (k, m) in metres.

    The paper leaves epsilon open. Here epsilon_j is a share of the performance's own standard deviation along the axis,
    sqrt(lambda_j): all hand-made shapes together, full on, do not reach that share of what the performer does every other frame.

    The coordinates are those about the mean displacement. Shapes without any part along an axis all have w_ij = -e_j . mu, a sum
    that is not small where the performance's mean lies off the neutral face, while eq. 4 leaves nothing of the axis; so the same
    test is made on the parts of e_i^QE itself, w_ij + e_j . mu, and an axis that fails either is missing.
    """
    least = share * np.sqrt(eigen.variances)
    return tuple(int(axis) for axis in np.flatnonzero(_exercise(weights, eigen) < least))


def missing_report(faces: QuasiEigenFaces) -> tuple[MissingAxis, ...]:
    """Each missing axis with the hand-made shape nearest to it, for the animator to mend."""
    along = faces.hand.rows @ faces.hyperplane.rows.T
    cosine = along / np.maximum(np.linalg.norm(faces.hand.rows, axis=1), np.finfo(np.float32).tiny)[:, None]
    exercise = _exercise(faces.coordinates, faces.hyperplane)
    out = []
    for axis in faces.missing:
        nearest = int(np.abs(cosine[:, axis]).argmax())
        out.append(
            MissingAxis(
                axis=axis,
                name=eigenface_name(axis),
                share=float(exercise[axis] / np.sqrt(faces.hyperplane.variances[axis])),
                nearest=faces.hand.names[nearest],
                correlation=float(cosine[nearest, axis]),
                variance_share=float(faces.hyperplane.variances[axis] / faces.hyperplane.total_variance),
            )
        )
    return tuple(out)


def span_report(basis: ExpressionBasis, eigen: Eigenfaces) -> SpanReport:
    """What the span of a basis holds of the eigenfaces, each by its variance.

    Section 4 calls it highly probable that projections of n >= m shapes cover the hyperplane; this is the measure. Shapes that
    exercise every axis but always together, as near copies do, pass the test of `missing_axes` and fail here.
    """
    rows = basis.rows.astype(np.float64)
    # shapes of small amplitude count like large ones
    rows /= np.maximum(np.linalg.norm(rows, axis=1), np.finfo(np.float64).tiny)[:, None]
    squares, turn = np.linalg.eigh(rows @ rows.T)
    kept = squares > _ROUNDING * squares.max()
    inside = ((turn[:, kept] / np.sqrt(squares[kept])).T @ (rows @ eigen.rows.T.astype(np.float64))) ** 2
    reached = np.minimum(inside.sum(axis=0), 1.0)
    coverage = float(reached @ eigen.variances / eigen.total_variance)
    return SpanReport(int(kept.sum()), coverage, float(eigen.coverage[-1]), reached)


def _exercise(weights: NDArray, eigen: Eigenfaces) -> NDArray[np.float64]:
    """(m,) the smaller of the sums of |w_ij| and of |e_j . e_i^QE| over the shapes."""
    mean = eigen.rows @ eigen.mean.ravel()
    return np.minimum(np.abs(weights).sum(axis=0), np.abs(weights + mean).sum(axis=0))
