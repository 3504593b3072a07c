"""Weights of one expression basis as weights of another over one topology: ours, FLAME's, ARKit's names, any rig's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lstsq
from scipy.optimize import lsq_linear

from headcap.errors import InputError
from headcap.expressions.basis import ExpressionBasis
from headcap.meshes.topology import same_triangles

_BLOCK = 64
"""Frames whose displacements are in memory at once."""
_LEAST_DIRECTION = 1e-6
"""Directions of the target that are shorter than this share of its longest are rounding, and no way to go."""


@dataclass(frozen=True, eq=False)
class Conversion:
    """Weights of the target's shapes, and what they do not reach."""

    weights: NDArray[np.float64]
    """(l, j)"""
    rms_mm: NDArray[np.float64]
    """(l,) root mean square over vertices of what is left of each frame's displacements."""
    worst_mm: NDArray[np.float64]
    """(l,) at the vertex where most is left."""
    share: NDArray[np.float64]
    """(l,) length of what is left over that of the displacements; zero in frames at rest."""
    total_share: float
    """The same of all frames together."""


@dataclass(frozen=True, eq=False)
class ConversionMatrix:
    """The linear map between two bases: target weights = source weights @ matrix."""

    matrix: NDArray[np.float64]
    """(k, j)"""
    rms_mm: NDArray[np.float64]
    """(k,) of each source shape at weight one, what the target does not reach."""
    share: NDArray[np.float64]
    """(k,) the same as a share of the shape's length."""


def conversion_matrix(source: ExpressionBasis, target: ExpressionBasis) -> ConversionMatrix:
    """What each of the source's shapes is in terms of the target's: eq. 5 solved for every shape as if it were a frame.

    Since eq. 1 is linear, so is the map: it serves every frame whose weights are free. Where the target's shapes depend on each
    other the shortest weights are taken; where they span the source's, and the source's are independent, the matrix of the way
    back is the inverse. Raises `InputError` for bases of different topologies.
    """
    _check(source, target)
    rows, shapes = target.rows.astype(np.float64), source.rows.astype(np.float64)
    matrix = lstsq(rows.T, shapes.T, cond=_LEAST_DIRECTION)[0].T
    left = np.linalg.norm(shapes - matrix @ rows, axis=1)
    length = np.linalg.norm(shapes, axis=1)
    return ConversionMatrix(matrix, 1e3 * left / np.sqrt(len(source.neutral)), left / np.where(length > 0, length, 1.0))


def convert_weights(
    source: ExpressionBasis, target: ExpressionBasis, weights: NDArray, bounds: tuple[float, float] | None = None
) -> Conversion:
    """Weights (l, k) of the source as weights of the target that move every vertex as nearly alike as can be (eq. 5).

    Each basis moves its own neutral face: displacements are compared, not positions. With `bounds` on the target's weights,
    (0, 1) for ARKit's, the least squares of each frame are solved within them, exactly, in the target's j dimensions (QR);
    without, by `conversion_matrix`. Raises `InputError` for bases of different topologies or weights of another number of shapes.
    """
    _check(source, target)
    weights = np.asarray(weights, np.float64)
    if weights.ndim != 2 or weights.shape[1] != len(source):
        raise InputError(f"weights {weights.shape}", expected=f"(l, {len(source)})", remedy="Give a weight for every shape.")
    if bounds is None:
        converted = weights @ conversion_matrix(source, target).matrix
    else:
        converted = _bounded(source, target, weights, bounds)
    return _with_residual(source, target, weights, converted)


def _bounded(source: ExpressionBasis, target: ExpressionBasis, weights: NDArray, bounds: tuple[float, float]) -> NDArray:
    # what stands upright on the target's span cannot be reached by any weights: the problem is one of j equations
    axes, small = np.linalg.qr(target.rows.astype(np.float64).T)
    wanted = weights @ (source.rows.astype(np.float64) @ axes)
    solved = np.array([lsq_linear(small, frame, bounds, method="bvls").x for frame in wanted])
    # what lies at a bound is beside it by rounding
    return np.clip(solved.reshape(len(weights), len(target)), *bounds)


def _with_residual(source: ExpressionBasis, target: ExpressionBasis, weights: NDArray, converted: NDArray) -> Conversion:
    frames, vertices = len(weights), len(source.neutral)
    left, length, worst = np.zeros(frames), np.zeros(frames), np.zeros(frames)
    for first in range(0, frames, _BLOCK):
        some = slice(first, first + _BLOCK)
        wanted = weights[some] @ source.rows.astype(np.float64)
        apart = (wanted - converted[some] @ target.rows.astype(np.float64)).reshape(-1, vertices, 3)
        squares = np.einsum("fvi,fvi->fv", apart, apart)
        left[some], worst[some] = squares.sum(axis=1), squares.max(axis=1)
        length[some] = np.einsum("fc,fc->f", wanted, wanted)
    return Conversion(
        weights=converted,
        rms_mm=1e3 * np.sqrt(left / vertices),
        worst_mm=1e3 * np.sqrt(worst),
        share=np.sqrt(left / np.where(length > 0, length, 1.0)),
        total_share=float(np.sqrt(left.sum() / length.sum())) if length.any() else 0.0,
    )


def _check(source: ExpressionBasis, target: ExpressionBasis) -> None:
    if source.neutral.shape != target.neutral.shape or not same_triangles(source.triangles, target.triangles):
        raise InputError(
            f"bases of {len(source.neutral)} vertices, {len(source.triangles)} triangles "
            f"and {len(target.neutral)} vertices, {len(target.triangles)} triangles",
            expected="one topology",
            remedy="Register one onto the other's neutral face first.",
        )
