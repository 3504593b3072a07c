"""What makes shapes useless as a basis, told by name: flat ones, doubles, shapes or a neutral face that lie elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from headcap.errors import InputError, InputErrors
from headcap.expressions.basis import ExpressionBasis
from headcap.geometry.transforms import fit_rigid, rotation_angle, transform

Label = Callable[[str], str]
_LEAST_SHAPES = 3
"""Fewer shapes than these have no majority that could tell what they have in common."""
_LISTED = 12
"""Names that a message tells before it counts the rest."""
_SAMPLE = 3000
"""Vertices that a placement is fitted to."""
_ROUNDS, _LAST_ROUNDS = 30, 6
_ROUNDING_M = 1e-6


class BasisChecks(BaseModel):
    """When a shape counts as none; lengths well below what a sculptor makes and well above what text files round to."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    flat_mm: float = Field(0.01, ge=0, description="A shape that moves no vertex farther is flat")
    double_share: float = Field(
        1e-3, ge=0, description="Shapes that differ by less, as a share of the larger, are one shape twice"
    )
    at_rest_mm: float = Field(0.05, gt=0, description="A vertex that is nearer to its place on the neutral face has not moved")
    at_rest_share: float = Field(
        0.1, ge=0, le=1, description="A shape that holds this share of the vertices still is where the neutral face is"
    )
    placed_share: float = Field(
        0.3, gt=0, le=1, description="A shape is the neutral face moved as a whole if a rigid motion brings this share to rest"
    )
    common_share: float = Field(
        0.01,
        gt=0,
        lt=1,
        description="Share of the vertices at which most shapes may move alike before the neutral face is doubted",
    )


@dataclass(frozen=True)
class Offset:
    """How a mesh lies against another one that it should lie on."""

    neutral_from_shape: NDArray[np.float64]
    """(4, 4) rigid."""
    distance_mm: float
    """Of the mesh's middle."""
    turn_deg: float

    def __str__(self) -> str:
        return f"{self.distance_mm:.2f} mm and {self.turn_deg:.2f} degrees"


def checked(
    basis: ExpressionBasis, *, label: Label = str, align: bool = False, checks: BasisChecks | None = None
) -> ExpressionBasis:
    """The basis, once nothing is wrong with it; `label` turns a shape's name into what messages call it, a file's say.

    Shapes that were exported elsewhere than the neutral face (section 3: e_i = shape - v^0 presumes that they were not) are
    brought back with `align`, else refused with the distance. Raises `InputError`, or `InputErrors` for several faults: no shape;
    numbers that are not finite; names twice; flat shapes; one shape twice; a rigid offset; most shapes moving alike from the
    neutral face, which therefore is none.
    """
    checks = checks or BasisChecks()
    _raise(_unusable(basis, label))
    basis = _placed(basis, label, align, checks)
    _raise([*flat_shapes(basis, label, checks), *doubled_shapes(basis, label, checks)])
    return basis


def flat_shapes(basis: ExpressionBasis, label: Label = str, checks: BasisChecks | None = None) -> list[InputError]:
    """One error for all shapes that are the neutral face again."""
    checks = checks or BasisChecks()
    farthest = 1e3 * np.sqrt(np.square(basis.displacements).sum(axis=2).max(axis=1))
    flat = [label(name) for name, far in zip(basis.names, farthest, strict=True) if far <= checks.flat_mm]
    if not flat:
        return []
    return [
        InputError(
            f"flat shapes: {', '.join(flat[:_LISTED])}{f' and {len(flat) - _LISTED} more' if len(flat) > _LISTED else ''}",
            expected=f"each to move some vertex by more than {checks.flat_mm:g} mm",
            remedy="Leave them out, or export them with their weight at one.",
        )
    ]


def doubled_shapes(basis: ExpressionBasis, label: Label = str, checks: BasisChecks | None = None) -> list[InputError]:
    """An error for each pair of shapes that are one."""
    checks = checks or BasisChecks()
    rows = basis.rows.astype(np.float64)
    gram = rows @ rows.T
    norms = np.diag(gram)
    apart = np.maximum(norms[:, None] + norms[None] - 2 * gram, 0.0)
    largest = np.maximum(norms[:, None], norms[None])
    pairs = np.argwhere(np.triu(apart <= checks.double_share**2 * largest, 1) & (largest > 0))
    return [
        InputError(
            f"{label(basis.names[a])} and {label(basis.names[b])} are one shape",
            expected="shapes that differ",
            remedy="Leave one of them out.",
        )
        for a, b in pairs
    ]


def offset_as_a_whole(neutral: NDArray, shape: NDArray, checks: BasisChecks | None = None) -> Offset | None:
    """How a shape (n, 3) lies against the neutral face (n, 3), metres; None where it lies on it, or no rigid motion explains it.

    Least sum of distances, not of squares, so that what an expression moves hardly counts, then of a law under which it counts
    nothing (Geman and McClure's, about a micrometre); reweighted least squares.
    """
    checks = checks or BasisChecks()
    neutral, shape = np.asarray(neutral, np.float64), np.asarray(shape, np.float64)
    near = 1e-3 * checks.at_rest_mm
    if np.mean(np.linalg.norm(shape - neutral, axis=1) <= near) >= checks.at_rest_share:
        return None
    step = max(1, len(neutral) // _SAMPLE)
    source, target = shape[::step], neutral[::step]
    weights = np.ones(len(source))
    for left in reversed(range(_ROUNDS)):
        placement = fit_rigid(source, target, weights)
        distance = np.linalg.norm(transform(placement, source) - target, axis=1)
        weights = 1.0 / np.maximum(distance, 0.1 * near)
        if left <= _LAST_ROUNDS:
            weights = 1.0 / np.square(1.0 + np.square(distance / _ROUNDING_M))
    if np.mean(np.linalg.norm(transform(placement, shape) - neutral, axis=1) <= near) < checks.placed_share:
        return None
    middle = shape.mean(axis=0)
    away = 1e3 * float(np.linalg.norm(transform(placement, middle) - middle))
    return Offset(placement, away, float(np.rad2deg(rotation_angle(placement[:3, :3]))))


def _raise(errors: list[InputError]) -> None:
    if errors:
        raise errors[0] if len(errors) == 1 else InputErrors(errors)


def _unusable(basis: ExpressionBasis, label: Label) -> list[InputError]:
    if not len(basis):
        return [InputError("a basis without shapes", expected="one at least beside the neutral face", remedy="Add shapes.")]
    errors = []
    seen: dict[str, str] = {}
    for name in basis.names:
        if name.casefold() in seen:
            found = f"the names {seen[name.casefold()]} and {name}"
            errors.append(InputError(found, expected="each shape to have a name of its own", remedy="Rename one."))
        seen[name.casefold()] = name
    finite = np.isfinite(basis.displacements).all(axis=2)
    broken = [f"{label(basis.names[i])} ({np.sum(~finite[i])})" for i in np.flatnonzero(~finite.all(axis=1))]
    if not np.isfinite(basis.neutral).all():
        broken = [f"the neutral face ({np.sum(~np.isfinite(basis.neutral).all(axis=1))})"]
    if broken:
        found = f"vertices that are not numbers: {', '.join(broken)}"
        errors.append(InputError(found, expected="none", remedy="Export these shapes again."))
    return errors


def _placed(basis: ExpressionBasis, label: Label, align: bool, checks: BasisChecks) -> ExpressionBasis:
    """Every shape where the neutral face is, moved there or refused."""
    neutral = np.asarray(basis.neutral, np.float64)
    common = _common_offset(basis, neutral, align, checks)
    displacements, found = basis.displacements.astype(np.float64), {}
    if common is not None:
        # those too in which so much moves that their own offset could not be told
        displacements = transform(common.neutral_from_shape, neutral + displacements) - neutral
    for i, name in enumerate(basis.names):
        offset = offset_as_a_whole(neutral, neutral + displacements[i], checks)
        if offset is not None:
            found[name] = offset
            displacements[i] = transform(offset.neutral_from_shape, neutral + displacements[i]) - neutral
    if not found and common is None:
        return basis
    if found and not align:
        told = ", ".join(f"{label(name)} by {offset}" for name, offset in found.items())
        raise InputError(
            f"shapes moved as a whole against the neutral face: {told}",
            expected="shapes of one placement",
            remedy="Export them without the head's motion, or have them aligned.",
        )
    return ExpressionBasis(basis.names, basis.neutral, displacements, basis.triangles)


def _common_offset(basis: ExpressionBasis, neutral: NDArray, align: bool, checks: BasisChecks) -> Offset | None:
    """How most shapes lie against the neutral face, if elsewhere; what they leave alike in another way is no neutral face."""
    if len(basis) < _LEAST_SHAPES:
        return None
    common = np.median(basis.displacements, axis=0)
    size = np.linalg.norm(common, axis=1)
    moved = size > 1e-3 * checks.at_rest_mm
    spread = np.median(np.linalg.norm(basis.displacements[:, moved] - common[moved], axis=2), axis=0)
    alike = np.flatnonzero(moved)[spread <= 0.1 * size[moved]]
    if len(alike) <= checks.common_share * len(neutral):
        return None
    offset = offset_as_a_whole(neutral, neutral + common, checks)
    if offset is None:
        worst = alike[size[alike].argmax()]
        raise InputError(
            f"most shapes leave the neutral face alike at {100 * len(alike) / len(neutral):.0f} % of its vertices, "
            f"by up to {1e3 * size[worst]:.2f} mm at vertex {worst}",
            expected="a neutral face: where a shape does not act, it is the neutral face",
            remedy="Give the face that the shapes were sculpted from.",
        )
    if not align:
        raise InputError(
            f"the neutral face lies {offset} from the other shapes",
            expected="one placement for all",
            remedy="Export it with the shapes, or have them aligned.",
        )
    return offset
