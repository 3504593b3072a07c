"""From a performance and hand-made shapes to quasi-eigen faces, in one call (quasi-eigen paper, section 4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from headcap.errors import InputError, InputErrors
from headcap.expressions.basis import Eigenfaces, ExpressionBasis, QuasiEigenFaces
from headcap.expressions.hyperplane import spanning_axes
from headcap.expressions.performance import Performance
from headcap.expressions.principal import eigenfaces
from headcap.expressions.projection import quasi_eigen_faces
from headcap.expressions.rest import offset_of_rest
from headcap.expressions.shape_changes import OVERLAP, cosines
from headcap.expressions.weights import ExpressionSolver

FLAT_M = 1e-6
"""Largest displacement of a shape that is flat: a thousandth of a millimetre is no sculptor's work."""
ALIKE = 1e-5
"""Of one minus a cosine: shapes nearer than that are one shape, whatever their amplitude."""

Progress = Callable[[str, float], None]


class QuasiEigenSettings(BaseModel):
    """Conversion of a hand-made basis, and weights in the converted one."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    components: Literal["shapes", "coverage"] | Annotated[int, Field(ge=1)] = Field(
        "shapes",
        description="Principal axes that shapes are projected onto: as many, fewer than shapes, as let them reproduce most; as "
        "many as `coverage` asks for; or a number",
    )
    coverage: float = Field(
        0.995, gt=0, le=1, description="Share of the performance's variance that its eigenfaces cover (paper), where asked for"
    )
    through_neutral: bool = Field(
        True,
        description="Whether the hyperplane also holds the direction from the neutral face to it. Without, eq. 4 adds that "
        "offset to every shape, and errors were 1.9 to 13 times the eigenfaces' on four people, with it 1.05 to 1.13",
    )
    missing_share: float = Field(
        0.05,
        ge=0,
        description="Threshold epsilon of the missing axes: sum of |w_ij| over the shapes, as a share of the performance's "
        "standard deviation along the axis",
    )
    augment: bool = Field(True, description="Whether missing axes join the basis as eigenfaces; else they are only listed")
    locality: float = Field(
        0.0,
        ge=0,
        le=1,
        description="How far each shape is kept to the region it was sculpted in: 0 is the paper's projection, 1 moves nothing "
        "outside and leaves the hyperplane",
    )
    overlap: float = Field(OVERLAP, gt=0, le=1, description="Cosine between two shapes from which they are reported to overlap")
    rest_ratio: float | None = Field(
        2.0,
        gt=0,
        description="Distance of the nearest frame from the neutral face over the spread of all frames beyond which the neutral "
        "face is refused; none to take any",
    )
    neutral_mm: float | None = Field(
        1.0,
        gt=0,
        description="Root mean square distance between the neutral faces of basis and performance beyond which they are refused; "
        "none to take displacements as they are",
    )
    bounds: tuple[float, float] | None = Field(
        None,
        description="Least and largest weight; none as the paper has it, which advises weights of both "
        "signs: without negative ones the projections of eq. 4 can reproduce less than the shapes they were made of",
    )
    smoothing: float = Field(0.0, ge=0, description="Of weights over time, beside a unit error of them")
    sparsity: float = Field(0.0, ge=0, description="Weight below which a shape that stands alone is left out")
    seed: int = Field(0, ge=0, description="Of the range finder for the eigenfaces")

    @model_validator(mode="after")
    def _room(self) -> QuasiEigenSettings:
        if self.bounds is not None and not self.bounds[0] < self.bounds[1]:
            raise ValueError(f"bounds {self.bounds} leave no room")
        return self

    def solver(self, basis: ExpressionBasis) -> ExpressionSolver:
        """Weights of frames in a basis as these settings have them (eq. 5)."""
        return ExpressionSolver(basis, bounds=self.bounds, smoothing=self.smoothing, sparsity=self.sparsity)


def convert_basis(
    performance: Performance, hand: ExpressionBasis, settings: QuasiEigenSettings | None = None, progress: Progress | None = None
) -> QuasiEigenFaces:
    """Quasi-eigen faces of hand-made shapes for a performance: eq. 2, 3 and 4 with the post-treatments of section 4.

    `progress` is told what is being done and which share of all is done. Raises `InputErrors`, all found at once: basis and
    performance of different topology or neutral face, flat shapes, shapes that are one, fewer frames than shapes; and
    `InputError` for frames that are not finite, a neutral face that is none (`rest.offset_of_rest`), a coverage out of reach.
    """
    settings, tell = settings or QuasiEigenSettings(), progress or _silent
    require_fit(performance, hand, settings.neutral_mm)
    tell("principal axes", 0.0)
    eigen, hyperplane = _axes(performance, hand, settings)
    tell("neutral face", 0.85)
    if settings.rest_ratio is not None:
        offset_of_rest(performance).require(settings.rest_ratio)
    tell("projection", 0.95)
    faces = quasi_eigen_faces(
        hand, hyperplane, missing_share=settings.missing_share, augment=settings.augment, locality=settings.locality
    )
    tell("done", 1.0)
    return replace(faces, eigen=eigen, hyperplane=hyperplane)


def _axes(performance: Performance, hand: ExpressionBasis, settings: QuasiEigenSettings) -> tuple[Eigenfaces, Eigenfaces]:
    """E^PCA with as many axes as there are shapes, or more where they were asked for, and what shapes are projected onto."""
    least = min(len(hand), len(performance) - 1)
    if settings.components == "coverage":
        hyperplane = eigenfaces(performance, coverage=settings.coverage, seed=settings.seed)
        eigen = hyperplane if len(hyperplane) >= least else eigenfaces(performance, count=least, seed=settings.seed)
    else:
        count = len(hand) if settings.components == "shapes" else settings.components
        eigen = eigenfaces(performance, count=max(min(count, len(performance) - 1), least), seed=settings.seed)
        hyperplane = eigen.first(count)
    if not settings.through_neutral:
        return eigen, hyperplane
    return eigen, spanning_axes(hand, eigen) if settings.components == "shapes" else eigen.through_neutral(len(hyperplane))


def require_fit(performance: Performance, hand: ExpressionBasis, neutral_mm: float | None = 1.0) -> None:
    """Raises `InputErrors` with all that keeps a basis from being converted for a performance."""
    found = _other_topology(performance, hand) or _other_neutral(performance, hand, neutral_mm)
    found += _repeated_names(hand) + (_broken(hand) or _flat(hand) + _one_shape(hand))
    if len(performance) < len(hand):
        found.append(
            InputError(
                f"{performance.source} has {len(performance)} frames",
                expected=f"at least as many as the basis has shapes, {len(hand)}",
                remedy="Give a longer performance.",
            )
        )
    if found:
        raise InputErrors(found)


def _other_topology(performance: Performance, hand: ExpressionBasis) -> list[InputError]:
    remedy = "Register one to the other's topology first."
    ours, theirs = len(performance.neutral), len(hand.neutral)
    if ours != theirs:
        return [InputError(f"the basis has {theirs} points", expected=f"{ours} as {performance.source} has", remedy=remedy)]
    ours, theirs = len(performance.triangles), len(hand.triangles)
    if not ours or not theirs or np.array_equal(_turned(performance.triangles), _turned(hand.triangles)):
        return []
    if ours != theirs:
        return [InputError(f"the basis has {theirs} triangles", expected=f"{ours} as {performance.source} has", remedy=remedy)]
    return [
        InputError(
            f"the basis joins the {len(hand.neutral)} points to other triangles",
            expected=f"those of {performance.source}",
            remedy=remedy,
        )
    ]


def _turned(triangles: NDArray) -> NDArray:
    """Triangles in an order of their own, each begun at its smallest corner."""
    first = triangles.argmin(axis=1)[:, None]
    begun = np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)
    return begun[np.lexsort(begun.T)]


def _other_neutral(performance: Performance, hand: ExpressionBasis, most_mm: float | None) -> list[InputError]:
    away = np.linalg.norm(hand.neutral.astype(np.float64) - performance.neutral, axis=1)
    rms_mm = 1e3 * float(np.sqrt((away**2).mean()))
    if most_mm is None or rms_mm <= most_mm:
        return []
    return [
        InputError(
            f"the neutral face of the basis lies {rms_mm:.3g} mm from that of {performance.source}, at most "
            f"{1e3 * away.max():.3g} mm at vertex {int(away.argmax())}",
            expected=f"at most {most_mm:g} mm",
            remedy="Give both in one place, in the same units and of one person, or allow the difference with neutral_mm.",
        )
    ]


def _repeated_names(hand: ExpressionBasis) -> list[InputError]:
    twice = sorted({name for name in hand.names if hand.names.count(name) > 1})
    if not twice:
        return []
    return [InputError(f"several shapes are called {', '.join(twice)}", expected="one shape of each name", remedy="Rename them.")]


def _broken(hand: ExpressionBasis) -> list[InputError]:
    broken = [name for name, rows in zip(hand.names, hand.rows, strict=True) if not np.isfinite(rows).all()]
    if not broken:
        return []
    return [InputError(f"shapes {', '.join(broken)} are not finite", expected="finite coordinates", remedy="Export them again.")]


def _flat(hand: ExpressionBasis) -> list[InputError]:
    largest = np.linalg.norm(hand.displacements, axis=2).max(axis=1)
    flat = [name for name, most in zip(hand.names, largest, strict=True) if most < FLAT_M]
    if not flat:
        return []
    return [
        InputError(
            f"shapes that do not differ from the neutral face: {', '.join(flat)}",
            expected=f"displacements of at least {1e3 * FLAT_M:g} mm",
            remedy="Sculpt them or leave them out.",
        )
    ]


def _one_shape(hand: ExpressionBasis) -> list[InputError]:
    first, second = np.nonzero(np.triu(cosines(hand) > 1 - ALIKE, 1))
    return [
        InputError(
            f"{hand.names[i]} and {hand.names[j]} are one shape"
            + ("" if np.allclose(hand.rows[i], hand.rows[j], atol=FLAT_M) else " of two amplitudes"),
            expected="shapes that differ",
            remedy="Leave one of them out.",
        )
        for i, j in zip(first, second, strict=True)
    ]


def _silent(step: str, share: float) -> None:
    pass
