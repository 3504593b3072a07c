"""Hand-made shapes, eigenfaces and quasi-eigen faces against one performance (quasi-eigen paper, section 5.5).

Bases are compared at the same number of elements. k quasi-eigen faces span k directions through the neutral face at most, which
is what the mean and k - 1 eigenfaces span: these are their match (`qe_over_pca`). k eigenfaces that have the mean for nothing are
the stricter one (`qe_over_pca_beside_mean`). Where shapes were projected onto fewer axes than that, the mean and those axes are
the match, and of the faces also the best as many (`qe_chosen_over_pca`).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.evaluation.metrics import Figure, make_figure
from headcap.evaluation.reproduction import Progress, Reproduction, reproduction, reproductions
from headcap.evaluation.settings import EvaluateSettings
from headcap.expressions import Performance, QuasiEigenFaces
from headcap.expressions.shape_changes import cosines
from headcap.expressions.weights import Bounds

__all__ = ["EXERCISED", "ExpressionFigures", "Mistaken", "Reproduction", "compare_bases", "reproduction"]

KIND, SCHEMA = "expression_errors", 1
EXERCISED = 1 / 3
"""A shape that keeps less of its norm on the principal axes than this is not exercised by the performance."""
ROUNDING_PCT = 1e-5
"""Alpha of positions that single precision rounds to some 6e-8 of their length."""
_DEPENDENT = 1e-4
"""Of a shape's norm: less than ten times this of its own, and it has no part of its own; float32 rounding is far below."""


@dataclass(frozen=True)
class Mistaken:
    """A quasi-eigen face that looks more like another hand-made shape than like its own."""

    name: str
    closest: str
    correlation: float
    """Cosine with its own."""
    closest_correlation: float
    own_part: float
    """As in `ExpressionFigures`: little where not the shape was performed, but others that it resembles."""


@dataclass(frozen=True, eq=False)
class ExpressionFigures:
    """k hand-made shapes, m axes, l frames of n points."""

    names: tuple[str, ...]
    """Of the hand-made shapes."""
    time_s: NDArray[np.float64]
    """(l,)"""
    elements: int
    """Axes beside the mean at which bases are compared: one fewer than shapes, or all where they are fewer still."""
    hand: Reproduction
    """E^H, all k shapes."""
    pca: Reproduction
    """E^PCA, the mean and the first `elements` axes."""
    pca_beside_mean: Reproduction
    """The mean, and as many axes as there are hand-made shapes."""
    quasi: Reproduction
    """E^QE, all its elements, those it was augmented with among them."""
    kept: NDArray[np.float64]
    """(k,) norm of a hand-made displacement's part along the axes over its own: how far the performance exercises the shape.

    Of the displacement e^H itself, not of e^H - mu as in eq. 3: of a shape at right angles to all that was performed, e^H - mu
    keeps -mu, so that a strong mean would count as exercise of every shape.
    """
    correlation: NDArray[np.float64]
    """(k, k) cosines of quasi-eigen faces (rows) with hand-made shapes, both as displacements from the neutral face: as seen.

    Eq. 4 is the projection of e^H plus the part of the mean outside the axes. That part is nothing where the neutral face is
    among the frames the axes cover, `mean_outside` says how much; it stays in, for an animator sees it.
    """
    own_part: NDArray[np.float64]
    """(k,) norm kept of a shape's own part, that no combination of the other shapes makes; 0 of a shape without one.

    A shape that was never performed keeps much of its norm where others resemble it, but little of what is its own.
    """
    mean_outside: float
    """Norm of the mean's part outside the axes over the mean's."""
    missing: tuple[int, ...]
    """Axes that the hand-made shapes leave out."""

    @property
    def own_correlation(self) -> NDArray[np.float64]:
        """(k,) of each quasi-eigen face with its own hand-made shape."""
        return np.diagonal(self.correlation)

    @property
    def exercised(self) -> NDArray[np.bool_]:
        """(k,) shapes that keep at least `EXERCISED` of their norm."""
        return self.kept >= EXERCISED

    @property
    def not_exercised(self) -> tuple[str, ...]:
        """Names of the others."""
        return tuple(name for name, used in zip(self.names, self.exercised, strict=True) if not used)

    @property
    def not_told_apart(self) -> tuple[str, ...]:
        """Names of exercised shapes of whose own part less than `EXERCISED` is kept: others that resemble them were performed."""
        blurred = self.exercised & (self.own_part < EXERCISED)
        return tuple(name for name, found in zip(self.names, blurred, strict=True) if found)

    @property
    def mistaken(self) -> tuple[Mistaken, ...]:
        """Exercised shapes whose quasi-eigen face is closer to another hand-made shape than to its own.

        Of two causes: not this shape was performed but one like it (`not_told_apart`), or the two only ever together, as a left
        and a right one, whose faces are then one and the same and closer to either by chance.
        """
        closest = self.correlation.argmax(axis=1)
        return tuple(
            Mistaken(
                name=self.names[shape],
                closest=self.names[closest[shape]],
                correlation=float(self.own_correlation[shape]),
                closest_correlation=float(self.correlation[shape, closest[shape]]),
                own_part=float(self.own_part[shape]),
            )
            for shape in np.flatnonzero(self.exercised & (closest != np.arange(len(self.names))))
        )

    @property
    def alpha_qe_chosen_pct(self) -> float:
        """Eq. 6 of the `elements` quasi-eigen faces that reproduce most, chosen one by one. NaN if bounded."""
        by_size = self.quasi.alpha_by_size_pct
        return float(by_size[min(self.elements, len(by_size) - 1)]) if len(by_size) else float("nan")

    def figures(self) -> dict[str, float]:
        """By the catalogue's names."""
        used = self.exercised
        own = self.own_correlation[used]
        figures = {
            "alpha_hand_pct": self.hand.alpha_pct,
            "alpha_pca_pct": self.pca.alpha_pct,
            "alpha_qe_pct": self.quasi.alpha_pct,
            "alpha_qe_chosen_pct": self.alpha_qe_chosen_pct,
            "qe_over_pca": _alpha_ratio(self.quasi.alpha_pct, self.pca.alpha_pct),
            "qe_over_pca_beside_mean": _alpha_ratio(self.quasi.alpha_pct, self.pca_beside_mean.alpha_pct),
            "qe_chosen_over_pca": _alpha_ratio(self.alpha_qe_chosen_pct, self.pca.alpha_pct),
            "hand_over_qe": _alpha_ratio(self.hand.alpha_pct, self.quasi.alpha_pct),
            "displacement_hand_pct": self.hand.displacement_pct,
            "displacement_pca_pct": self.pca.displacement_pct,
            "displacement_qe_pct": self.quasi.displacement_pct,
            "rms_hand_mm": self.hand.rms_mm,
            "rms_pca_mm": self.pca.rms_mm,
            "rms_qe_mm": self.quasi.rms_mm,
            "elements": self.elements,
            "median_correlation": float(np.median(own)) if len(own) else float("nan"),
            "own_closest_share": 1 - len(self.mistaken) / len(own) if len(own) else float("nan"),
            "not_exercised": len(self.not_exercised),
            "not_told_apart": len(self.not_told_apart),
            "missing_axes": len(self.missing),
            "mean_outside": self.mean_outside,
        }
        return {f"quasi_eigen.{name}": float(value) for name, value in figures.items()}

    def to_json(self) -> dict[str, object]:
        """All but the maps of points, as numbers, strings, lists and dicts of them."""
        return {
            "figures": {name: value if np.isfinite(value) else None for name, value in self.figures().items()},
            "names": list(self.names),
            "time_s": self.time_s.tolist(),
            "elements": self.elements,
            "kept": self.kept.tolist(),
            "own_correlation": self.own_correlation.tolist(),
            "own_part": self.own_part.tolist(),
            "not_exercised": list(self.not_exercised),
            "not_told_apart": list(self.not_told_apart),
            "mistaken": [asdict(shape) for shape in self.mistaken],
            "missing": list(self.missing),
            "bases": {name: _told(getattr(self, name)) for name in ("hand", "pca", "pca_beside_mean", "quasi")},
        }


def compare_bases(
    performance: Performance,
    faces: QuasiEigenFaces,
    *,
    bounds: Bounds = None,
    progress: Progress | None = None,
) -> ExpressionFigures:
    """Judge E^H, E^PCA and E^QE on a performance, which may be another than they were made from (section 5.5).

    Weights are free, or within `bounds` (least, largest) for hand-made and quasi-eigen faces; eigenfaces are always free,
    so that ratios to them are the paper's only where all are. One passage over the frames. Raises `InputError` for another
    topology.
    """
    elements = max(min(len(faces.hand) - 1, len(faces.eigen)), 1)
    axes = [faces.eigen.first(count) for count in (elements, len(faces.hand))]
    hand, pca, pca_beside_mean, quasi = reproductions(
        performance, [faces.hand, *axes, faces.quasi], [bounds, None, None, bounds], progress
    )
    shapes, axes = faces.hand.rows.astype(np.float64), faces.hyperplane.rows.astype(np.float64)
    mean = faces.hyperplane.mean.ravel().astype(np.float64)
    kept, own_part = _kept(shapes, axes)
    return ExpressionFigures(
        names=faces.hand.names,
        time_s=performance.time_s,
        elements=elements,
        hand=hand,
        pca=pca,
        pca_beside_mean=pca_beside_mean,
        quasi=quasi,
        kept=kept,
        correlation=cosines(faces.quasi, faces.hand)[: len(shapes)],
        own_part=own_part,
        mean_outside=_ratio(float(np.linalg.norm(mean - mean @ axes.T @ axes)), float(np.linalg.norm(mean))),
        missing=faces.missing,
    )


def expression_metrics(compared: ExpressionFigures, session: str, settings: EvaluateSettings) -> list[Figure]:
    """The figures of one person, held to the limits in force."""
    return [make_figure(name, value, session=session, take=None, settings=settings) for name, value in compared.figures().items()]


def _kept(shapes: NDArray, axes: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(k,) norms kept along the axes of unit shapes, and of their parts outside the span of all others."""
    units = shapes / np.maximum(np.linalg.norm(shapes, axis=1, keepdims=True), 1e-30)
    along = units @ axes.T
    # rows of G^-1 E are at right angles to all shapes but their own; their squares are the diagonal of G^-1
    inverse = np.linalg.inv(units @ units.T + _DEPENDENT**2 * np.eye(len(units)))
    lengths = np.sqrt(np.diagonal(inverse))
    own_part = np.linalg.norm(inverse @ along, axis=1) / lengths
    return np.linalg.norm(along, axis=1), np.where(1 / lengths > 10 * _DEPENDENT, own_part, 0.0)


def _alpha_ratio(value_pct: float, reference_pct: float) -> float:
    """Of two errors; what single precision of positions leaves anyway is no error of either."""
    return max(value_pct, ROUNDING_PCT) / max(reference_pct, ROUNDING_PCT)


def _ratio(value: float, reference: float) -> float:
    return value / reference if reference > 0 else float("nan")


def _told(basis: Reproduction) -> dict[str, object]:
    return {
        "alpha_pct": basis.alpha_pct,
        "displacement_pct": basis.displacement_pct,
        "rms_mm": basis.rms_mm,
        "dimensions": basis.dimensions,
        "frame_alpha_pct": basis.frame_alpha_pct.tolist(),
        "frame_rms_mm": basis.frame_rms_mm.tolist(),
        "region_rms_mm": dict(basis.region_rms_mm),
        "alpha_by_size_pct": basis.alpha_by_size_pct.tolist(),
        "order": list(basis.order),
    }
