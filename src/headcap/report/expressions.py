"""The page of one performance's quasi-eigen faces: figures 2 to 4 of the paper, alpha of three bases, what a basis lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import Manifest
from headcap.evaluation.expressions import ExpressionFigures
from headcap.evaluation.metrics import Figure
from headcap.expressions import Eigenfaces, ExpressionBasis, Performance, QuasiEigenFaces
from headcap.expressions.projection import MissingAxis, missing_report, span_report
from headcap.expressions.shape_changes import OVERLAP, overlaps, shape_changes
from headcap.expressions.weights import ExpressionSolver
from headcap.report import expressions_figures as diagrams
from headcap.report.expressions_pictures import FacePainter, joined, length_mm, round_top
from headcap.report.overlays import Image, jpeg_uri, png_uri
from headcap.report.page import Shown, drawing, write_page
from headcap.report.provenance import versions

BASES = ("hand", "quasi", "pca")
"""In the order in which pictures stand beside each other."""
PAPER_ALPHA_PCT = {"hand": 5.2, "pca": 0.62, "quasi": 0.72}
"""The paper's figures (5.5): one actress, 18 elements, 35,000 frames."""
PICTURED_SHAPES, PICTURED_AXES, DRAWN_WEIGHTS = 80, 8, 10
DEVIATIONS = 3.0
"""An eigenface is shown at so many standard deviations of the performance along it."""
_TILE, _FACE = 280, 340
_TIMES, _REACH_MM = (1, 2, 3, 5, 10), 15.0
"""Errors of markers are drawn as many times as keeps them this short."""


@dataclass(frozen=True)
class Moment:
    """A frame that is pictured, and why."""

    frame: int
    told: str


@dataclass(frozen=True, eq=False)
class ExpressionsPage:
    """All that the page tells: l frames, k hand-made shapes, f frames that are pictured."""

    performance: Performance
    faces: QuasiEigenFaces
    compared: ExpressionFigures
    moments: tuple[Moment, ...]
    captured: NDArray[np.float32]
    """(f, n, 3) displacements at the moments, metres."""
    reproduced: Mapping[str, NDArray[np.float64]]
    """The same as each of `BASES` reproduces them."""
    weights: Mapping[str, NDArray[np.float64]]
    """(l, k) of hand-made shapes, "hand", and of quasi-eigen faces, "quasi", those it was augmented with left out."""
    bounds: tuple[float, float] | None
    """Least and largest weight that was allowed; None: any."""
    overlap: float
    """Cosine from which shapes are listed as overlapping."""
    figures: tuple[Figure, ...]
    manifests: tuple[tuple[str, Manifest], ...]
    versions: Mapping[str, str]
    settings: Mapping


@dataclass(frozen=True)
class _Shape:
    """One hand-made shape's row of the table."""

    index: int
    name: str
    use_mm: float
    """Rms over frames of the weight of its quasi-eigen face, times that face's rms displacement over points."""
    kept: float
    correlation: float
    nearest: str
    nearest_correlation: float
    moved_rms_mm: float
    moved_max_mm: float
    exercised: bool


@dataclass(frozen=True)
class _Card:
    """One shape's pictures with its row of the table."""

    uri: str
    shape: _Shape


@dataclass(frozen=True)
class _Axis:
    """Pictures of a principal axis that no shape covers."""

    uri: str
    reach_mm: float
    """How far the face goes in them."""
    told: MissingAxis


def collect_expressions_page(
    performance: Performance,
    faces: QuasiEigenFaces,
    compared: ExpressionFigures,
    *,
    bounds: tuple[float, float] | None = None,
    weights: Mapping[str, NDArray] | None = None,
    overlap: float = OVERLAP,
    figures: Sequence[Figure] = (),
    manifests: Sequence[tuple[str, Manifest]] = (),
    settings: Mapping | None = None,
) -> ExpressionsPage:
    """Gather what the page tells; of the frames a block is in memory at a time.

    `bounds` are those of `compare_bases`: faces are pictured as they were judged. `weights` (l, elements) by "hand" or "quasi"
    are drawn over time instead of those of eq. 5 within the bounds, where a studio is given others: smooth or sparse ones. Shapes
    overlap from a cosine of `overlap` on.
    """
    moments = telling_moments(compared.hand.frame_alpha_pct, compared.quasi.frame_alpha_pct)
    solvers = {name: ExpressionSolver(basis, bounds=bounds) for name, basis in (("hand", faces.hand), ("quasi", faces.quasi))}
    captured = _frames_of(performance, [moment.frame for moment in moments])
    solved = {name: solver.solve(performance) for name, solver in solvers.items() if name not in (weights or {})}
    drawn = solved | dict(weights or {})
    return ExpressionsPage(
        performance=performance,
        faces=faces,
        compared=compared,
        moments=moments,
        captured=captured,
        reproduced={
            "hand": _blended(faces.hand, solvers["hand"].solve(captured)),
            "quasi": _blended(faces.quasi, solvers["quasi"].solve(captured)),
            "pca": _on_axes(faces.eigen, compared.elements, captured),
        },
        weights={name: np.asarray(each, np.float64)[:, : len(faces.hand)] for name, each in drawn.items()},
        bounds=bounds,
        overlap=overlap,
        figures=tuple(figures),
        manifests=tuple(manifests),
        versions=versions(),
        settings=dict(settings or {}),
    )


def _frames_of(performance: Performance, frames: Sequence[int]) -> NDArray[np.float32]:
    """Displacements (f, n, 3) of some frames, in the order asked for, metres."""
    found, first = {}, 0
    for block in performance.blocks():
        found |= {frame: np.array(block[frame - first]) for frame in frames if first <= frame < first + len(block)}
        first += len(block)
    return np.stack([found[frame] for frame in frames])


def _blended(basis: ExpressionBasis, weights: NDArray) -> NDArray[np.float64]:
    return (weights @ basis.rows.astype(np.float64)).reshape(len(weights), -1, 3)


def _on_axes(eigen: Eigenfaces, count: int, displacements: NDArray) -> NDArray[np.float64]:
    """Displacements (f, n, 3) laid on the first axes about their mean."""
    rows, mean = eigen.rows[:count].astype(np.float64), eigen.mean.ravel().astype(np.float64)
    away = displacements.reshape(len(displacements), -1) - mean
    return (mean + away @ rows.T @ rows).reshape(displacements.shape)


def telling_moments(hand_pct: NDArray, quasi_pct: NDArray) -> tuple[Moment, ...]:
    """Frames at which E^H errs most, as in half of the frames, and at which E^QE errs much; alpha (l,) of each, percent.

    The last is the frame farthest from the other two of the twentieth at which E^QE errs most: neighbours look the same.
    """
    order = np.argsort(hand_pct, kind="stable")
    worst, typical = int(order[-1]), int(order[len(order) // 2])
    much = np.flatnonzero(quasi_pct >= np.quantile(quasi_pct, 0.95))
    away = np.minimum(np.abs(much - worst), np.abs(much - typical))
    wanted = (
        (worst, "the largest error with hand-made shapes"),
        (typical, "a typical error: half of the frames have a larger one with hand-made shapes"),
        (int(much[away.argmax()]), "among the largest errors with quasi-eigen faces"),
    )
    told: dict[int, str] = {}
    for frame, why in wanted:
        told[frame] = f"{told[frame]}, and {why}" if frame in told else why
    return tuple(Moment(frame, why) for frame, why in told.items())


def write_expressions_report(page: ExpressionsPage, path: Path | str) -> None:
    """Write the page as one HTML file."""
    hand = page.faces.hand
    painter = FacePainter.framing(hand.neutral, hand.triangles, hand.displacements, height=_TILE)
    shapes = _shapes(page)
    moved_top = _moved_top(page)
    cards = [_card(page, painter, shape, moved_top) for shape in shapes[:PICTURED_SHAPES]]
    write_page(
        path,
        "expressions.html.j2",
        page,
        page=page,
        compared=page.compared,
        told=diagrams.TOLD,
        bases=BASES,
        paper=PAPER_ALPHA_PCT,
        allowed=_allowed(page),
        is_mesh=painter.is_mesh,
        read=_read(page.performance),
        neutral=_uri(painter, [painter.shape(np.zeros_like(hand.neutral))]),
        shapes=shapes,
        exercised=[card for card in cards if card.shape.exercised],
        silent=[card for card in cards if not card.shape.exercised],
        moved_top=moved_top,
        axes=_axes(page, painter, missing_report(page.faces)[:PICTURED_AXES]),
        deviations=f"{DEVIATIONS:g}",
        overlap=overlaps(page.faces, page.overlap),
        span=span_report(page.faces.quasi, page.faces.hyperplane),
        added=page.faces.quasi.names[len(hand) :],
        frames=_frames(page),
        over_all=_over_all(page),
        **_drawn(page, shapes),
    )


def _shapes(page: ExpressionsPage) -> list[_Shape]:
    """All hand-made shapes, the most used first."""
    compared, changes = page.compared, shape_changes(page.faces)
    count = len(compared.names)
    sizes = np.sqrt((length_mm(page.faces.quasi.displacements[:count]) ** 2).mean(axis=1))
    use_mm = np.sqrt((page.weights["quasi"] ** 2).mean(axis=0)) * sizes
    others = np.array(compared.correlation, np.float64)
    np.fill_diagonal(others, -np.inf)
    nearest = others.argmax(axis=1)
    return [
        _Shape(
            index=int(index),
            name=compared.names[index],
            use_mm=float(use_mm[index]),
            kept=float(compared.kept[index]),
            correlation=float(compared.own_correlation[index]),
            nearest=compared.names[nearest[index]] if count > 1 else "",
            nearest_correlation=float(others[index, nearest[index]]) if count > 1 else float("nan"),
            moved_rms_mm=float(changes.rms_mm[index]),
            moved_max_mm=float(changes.largest_mm[index]),
            exercised=bool(compared.exercised[index]),
        )
        for index in np.argsort(-use_mm, kind="stable")
    ]


def _moved_top(page: ExpressionsPage) -> float:
    """Upper end of the colours of what a projection changed, by the shapes that the performance exercised."""
    hand, used = page.faces.hand.displacements, page.compared.exercised
    chosen = used if used.any() else ~used
    return round_top(length_mm(page.faces.quasi.displacements[: len(hand)][chosen] - hand[chosen]))


def _card(page: ExpressionsPage, painter: FacePainter, shape: _Shape, top_mm: float) -> _Card:
    """Figure 2: a hand-made shape, its quasi-eigen face, and how far it moved, as near as it needs to be seen."""
    before = page.faces.hand.displacements[shape.index]
    after = page.faces.quasi.displacements[shape.index]
    near, moved = painter.close_up(before), length_mm(after - before)
    return _Card(_uri(painter, [near.shape(before), near.shape(after), near.errors(after, moved, top_mm)]), shape)


def _axes(page: ExpressionsPage, painter: FacePainter, missing: Sequence[MissingAxis]) -> list[_Axis]:
    """The mean face moved both ways along each axis, and the hand-made shape most like it."""
    eigen, hand = page.faces.hyperplane, page.faces.hand
    shown = []
    for told in missing:
        nearest = hand.displacements[hand.names.index(told.nearest)]
        # an axis has no sign of its own: plus is the way in which it is like the shape beside it
        step = np.copysign(DEVIATIONS, told.correlation) * np.sqrt(eigen.variances[told.axis]) * eigen.vectors[told.axis]
        near = painter.close_up(step, nearest)
        pictures = [near.shape(each) for each in (eigen.mean - step, eigen.mean + step, nearest)]
        shown.append(_Axis(_uri(painter, pictures), float(length_mm(step).max()), told))
    return shown


@dataclass(frozen=True)
class _Frames:
    """Figures 3 and 4: by moment captured and reproduced faces, and what each basis gets wrong there, at one scale."""

    rows: list[tuple[Moment, list[Shown], list[Shown]]]
    top_mm: float
    times: int
    """By which errors of markers are drawn larger."""


def _frames(page: ExpressionsPage) -> _Frames:
    painter = _large(page)
    error_mm = length_mm(page.reproduced["hand"] - page.captured)
    top, times = round_top(error_mm), max(t for t in _TIMES if t == 1 or t * error_mm.max() <= _REACH_MM)
    rows = []
    for number, moment in enumerate(page.moments):
        captured, made = page.captured[number], {name: page.reproduced[name][number] for name in BASES}
        faces = [Shown(_uri(painter, [painter.shape(captured)]), "captured")]
        faces += [Shown(_uri(painter, [painter.shape(made[name])]), _caption(page, name, moment)) for name in BASES]
        rows.append((moment, faces, [_error(painter, name, captured, made[name], (top, times)) for name in BASES]))
    return _Frames(rows, top, times)


def _large(page: ExpressionsPage) -> FacePainter:
    """Of pictures in which all shapes and all pictured frames have room."""
    hand = page.faces.hand
    reach = np.concatenate([hand.displacements, page.captured, *page.reproduced.values()])
    return FacePainter.framing(hand.neutral, hand.triangles, reach, height=_FACE)


def _caption(page: ExpressionsPage, name: str, moment: Moment) -> str:
    found = getattr(page.compared, name)
    alpha, rms = found.frame_alpha_pct[moment.frame], found.frame_rms_mm[moment.frame]
    return f"{diagrams.TOLD[name]}: alpha {alpha:.3g} %, rms {rms:.3g}\u00a0mm"


def _error(painter: FacePainter, name: str, captured: NDArray, made: NDArray, scale: tuple[float, int]) -> Shown:
    error, (top_mm, times) = length_mm(made - captured), scale
    if painter.is_mesh:
        image = painter.errors(captured, error, top_mm)
    else:
        image = painter.against(captured, captured + times * (made - captured))
    return Shown(_uri(painter, [image]), f"{diagrams.TOLD[name]}: {error.max():.3g}\u00a0mm at most")


def _over_all(page: ExpressionsPage) -> tuple[list[Shown], float]:
    """Rms error of each point over the performance, by basis at one scale, and the scale's upper end."""
    painter, still = _large(page), np.zeros_like(page.faces.hand.neutral)
    values = {name: getattr(page.compared, name).vertex_rms_mm for name in BASES}
    top = round_top(values["hand"])
    return [
        Shown(_uri(painter, [painter.errors(still, each, top)]), f"{diagrams.TOLD[name]}: {each.max():.3g}\u00a0mm at most")
        for name, each in values.items()
    ], top


def _drawn(page: ExpressionsPage, shapes: Sequence[_Shape]) -> dict[str, Shown]:
    """Diagrams over time and size."""
    of, time_s = {name: getattr(page.compared, name) for name in BASES}, page.performance.time_s
    chosen = [shape.index for shape in shapes[:DRAWN_WEIGHTS]]
    weights = [page.weights[name][:, chosen] for name in ("hand", "quasi")]
    names, moments = [page.compared.names[index] for index in chosen], [moment.frame for moment in page.moments]
    alphas = {name: found.frame_alpha_pct for name, found in of.items()}
    by_size = {name: found.alpha_by_size_pct for name, found in of.items() if len(found.alpha_by_size_pct)}
    drawn = {
        "curves": drawing(
            diagrams.alpha_curves(time_s, alphas, moments), "Alpha (eq. 6) of each frame; grey: frames pictured below"
        ),
        "weights": drawing(
            diagrams.weight_curves(time_s, names, *weights), f"Weights of the most used shapes (eq. 5), {_allowed(page)}"
        ),
    }
    if by_size:
        told = "Alpha over all frames: eigenfaces as they come, of shapes always the one that takes most of what is left"
        drawn["coverage"] = drawing(diagrams.coverage_curves(by_size, page.compared.elements), told)
    return drawn


def _allowed(page: ExpressionsPage) -> str:
    return "free in size and sign" if page.bounds is None else "from {:g} to {:g}".format(*page.bounds)


def _read(performance: Performance) -> list[tuple[str, str]]:
    """What was read and what reading found, for a table."""
    count, length_s = len(performance), performance.time_s[-1] - performance.time_s[0]
    kind = "vertices" if len(performance.triangles) else "markers"
    rate = f", {(count - 1) / length_s:.4g} frames per second" if length_s > 0 else ""
    told = [
        ("source", performance.source),
        ("frames", f"{count:,}{rate}"),
        (kind, f"{len(performance.neutral):,}"),
    ]
    return told + [(name.replace("_", " "), f"{value:.4g}") for name, value in performance.figures.items()]


def _uri(painter: FacePainter, images: list[Image]) -> str:
    """Pictures in a row: surfaces as JPEG, dots on white as PNG, which is smaller there."""
    row = joined(images)
    return jpeg_uri(row, 86) if painter.is_mesh else png_uri(row, 48)
