"""`headcap quasi-eigen` and `headcap convert-weights`: files in, files out, around `headcap.expressions`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import digest_settings, save_json, write_manifest
from headcap.errors import InputError, InputErrors
from headcap.evaluation.expressions import KIND, SCHEMA, ExpressionFigures, compare_bases
from headcap.export.expressions import write_basis
from headcap.expressions import ExpressionBasis, Performance, QuasiEigenFaces
from headcap.expressions.arkit import as_arkit
from headcap.expressions.basis_files import read_basis
from headcap.expressions.basis_registration import registered
from headcap.expressions.conversion import Conversion, convert_weights
from headcap.expressions.markers import MarkerTake, marker_performance, mesh_performance, read_markers
from headcap.expressions.markers.performances import basis_at_markers
from headcap.expressions.performance import joined
from headcap.expressions.performance_files import read_performance
from headcap.expressions.quasi_eigen import QuasiEigenSettings, convert_basis
from headcap.expressions.weight_curves import WeightCurves, read_weights, write_weights
from headcap.meshes.files import read_mesh, read_vertex_numbers
from headcap.registration.template import Template
from headcap.report.expressions import collect_expressions_page, write_expressions_report
from headcap.workflow.validation import validate

MARKERS = (".c3d", ".trc", ".csv")
_FORMS = ("basis", "basis.glb", "basis.usdc")
"""Endings that `write_basis` knows, for meshes."""
_MOVES_M = 1e-4


@dataclass(frozen=True)
class QuasiEigenRequest:
    """What `headcap quasi-eigen` was asked for."""

    performance: tuple[Path, ...]
    """Mesh sequences or marker recordings of one person."""
    basis: Path
    neutral: Path | None = None
    """The performer at rest; without it the hand-made shapes' own neutral face is the performer's."""
    unit: str | None = None
    """Of the performance, where its files do not tell."""
    basis_unit: str = "m"
    rate_hz: float = 30.0
    landmarks: Path | None = None
    """Vertex numbers of `neutral` by landmark name, JSON, where the shapes have another topology and it is no template."""
    basis_landmarks: Path | None = None
    on_markers: bool = False
    """Whether markers are worked on directly, without a mesh between them."""
    rigid: tuple[str, ...] | None = None
    leave_out: tuple[str, ...] = ()
    marker_vertices: Path | None = None
    """Vertex numbers by marker name, JSON."""
    neutral_frame: int | None = None
    settings: QuasiEigenSettings = field(default_factory=QuasiEigenSettings)

    @property
    def of_markers(self) -> bool:
        """Whether the performance is a marker recording."""
        return all(path.suffix.lower() in MARKERS for path in self.performance)

    @property
    def given(self) -> list[Path]:
        """Files among what was given."""
        paths = (*self.performance, self.basis, self.neutral, self.landmarks, self.basis_landmarks, self.marker_vertices)
        return [path for path in paths if path is not None and path.is_file()]


def asked_settings(*, components: str | None, **asked: object) -> QuasiEigenSettings:
    """Settings from options, None where one is not given; raises `InputErrors` for values out of range."""
    if components is not None:
        asked["components"] = int(components) if components.isdecimal() else components
    settings, errors = validate(QuasiEigenSettings, {key: value for key, value in asked.items() if value is not None})
    if errors:
        raise InputErrors(errors)
    return settings


def make_quasi_eigen_faces(request: QuasiEigenRequest, out: Path) -> list[str]:
    """Write `faces.npz`, the basis as OBJ set, glTF and USD, weights as CSV and JSON, errors and a page; returns told lines.

    Raises `InputError` or `InputErrors` as `read_performance`, `read_markers`, `read_basis`, `registered` and `convert_basis`.
    """
    basis = read_basis(request.basis, unit=request.basis_unit)
    performance, hand = (_of_markers if request.of_markers else _of_meshes)(request, basis)
    made = convert_basis(performance, hand, request.settings)
    curves = WeightCurves(made.quasi.names, performance.time_s, request.settings.solver(made.quasi).solve(performance))
    compared = compare_bases(performance, made, bounds=request.settings.bounds)
    _write(request, out, performance, made, curves, compared)
    return _told(performance, made, compared)


def _of_meshes(request: QuasiEigenRequest, basis: ExpressionBasis) -> tuple[Performance, ExpressionBasis]:
    unit = request.unit or "m"
    if request.neutral is None:
        performance = read_performance(
            request.performance,
            neutral=basis.neutral,
            triangles=basis.triangles,
            unit=unit,
            rate_hz=request.rate_hz,
            region=_where_shapes_move(basis),
        )
        return performance, basis
    neutral = Template.load(request.neutral) if request.neutral.suffix == ".npz" else request.neutral
    performance = read_performance(request.performance, neutral=neutral, unit=unit, rate_hz=request.rate_hz)
    template = isinstance(neutral, Template)
    known = dict(neutral.landmarks) if template else _numbers(request.landmarks, len(performance.neutral))
    own = _numbers(request.basis_landmarks, len(basis.neutral))
    laid = registered(basis, performance.neutral, performance.triangles, landmarks=own, onto_landmarks=known)
    return performance, laid.basis


def _of_markers(request: QuasiEigenRequest, basis: ExpressionBasis) -> tuple[Performance, ExpressionBasis]:
    takes = [read_markers(path, unit=request.unit, rate_hz=request.rate_hz) for path in request.performance]
    if request.on_markers:
        return _on_markers(request, takes, basis)
    regions = None
    if request.neutral is not None:
        vertices, triangles, regions, known = _performer(request.neutral, request.landmarks)
        own = _numbers(request.basis_landmarks, len(basis.neutral))
        basis = registered(basis, vertices, triangles, landmarks=own, onto_landmarks=known).basis
    performances = [
        mesh_performance(
            take,
            basis.neutral,
            basis.triangles,
            given=request.marker_vertices,
            regions=regions,
            region=None if regions else _where_shapes_move(basis),
            rigid=request.rigid,
            leave_out=request.leave_out,
            neutral_frame=request.neutral_frame,
        )
        for take in takes
    ]
    return (performances[0] if len(performances) == 1 else joined(performances)), basis


def _performer(
    neutral: Path, landmarks: Path | None
) -> tuple[NDArray, NDArray, dict[str, NDArray[np.bool_]], Mapping[str, int] | None]:
    """Vertices, triangles, regions and landmarks of the performer at rest: a template, or a mesh in metres."""
    if neutral.suffix == ".npz":
        template = Template.load(neutral)
        return template.vertices, template.triangles, dict(template.regions), dict(template.landmarks)
    vertices, triangles = read_mesh(neutral)
    return vertices, triangles, {}, _numbers(landmarks, len(vertices))


def _where_shapes_move(basis: ExpressionBasis) -> NDArray[np.bool_]:
    """(n,) the face of a mesh without regions: what some shape moves; the neck's own motion is no expression."""
    return np.abs(basis.displacements).max(axis=(0, 2)) > _MOVES_M


def _on_markers(
    request: QuasiEigenRequest, takes: list[MarkerTake], basis: ExpressionBasis
) -> tuple[Performance, ExpressionBasis]:
    if len(takes) > 1:
        raise InputError(
            f"{len(takes)} recordings to be worked on as markers",
            expected="one, since markers are stuck on anew for each",
            remedy="Join them where they were labelled, or leave out --on-markers: on a mesh recordings go together.",
        )
    performance = marker_performance(
        takes[0], rigid=request.rigid, leave_out=request.leave_out, neutral_frame=request.neutral_frame
    )
    return performance, basis_at_markers(basis, performance, given=request.marker_vertices)


def _numbers(path: Path | None, vertices: int) -> Mapping[str, int] | None:
    return None if path is None else read_vertex_numbers(path, vertices)


def _write(
    request: QuasiEigenRequest,
    out: Path,
    performance: Performance,
    made: QuasiEigenFaces,
    curves: WeightCurves,
    compared: ExpressionFigures,
) -> None:
    out.mkdir(parents=True, exist_ok=True)
    made.save(out / "faces.npz")
    write_weights(out / "weights.csv", curves)
    write_weights(out / "weights.json", curves)
    save_json(out / "errors.json", KIND, SCHEMA, compared.to_json())
    for form in _FORMS if len(performance.triangles) else ():
        write_basis(out / form, made.quasi, curves if "." in form else None)
    page = collect_expressions_page(
        performance,
        made,
        compared,
        bounds=request.settings.bounds,
        weights={"quasi": curves.weights},
        overlap=request.settings.overlap,
        settings=request.settings.model_dump(mode="json"),
    )
    write_expressions_report(page, out / "expressions.html")
    write_manifest(
        out / "faces.npz",
        kind="quasi_eigen_faces",
        stage="quasi-eigen",
        settings_digest=digest_settings(settings=request.settings),
        inputs=request.given,
        figures=compared.figures(),
    )


def _told(performance: Performance, made: QuasiEigenFaces, compared: ExpressionFigures) -> list[str]:
    lines = [
        f"{len(performance)} frames of {performance.source}; {len(made.hand)} hand-made shapes",
        f"error of reproduction (alpha, eq. 6): hand-made {compared.hand.alpha_pct:.3g} %, quasi-eigen "
        f"{compared.quasi.alpha_pct:.3g} %, eigenfaces {compared.pca.alpha_pct:.3g} %",
    ]
    if compared.not_exercised:
        lines.append(f"not exercised by this performance: {', '.join(compared.not_exercised)}")
    added = made.quasi.names[len(made.hand) :]
    if added:
        lines.append(f"left out by the hand-made shapes, and added: {', '.join(added)}")
    elif made.missing:
        lines.append(f"left out by the hand-made shapes: {len(made.missing)} eigenfaces, pictured on the page")
    return lines


@dataclass(frozen=True)
class WeightConversionRequest:
    """What `headcap convert-weights` was asked for."""

    weights: Path
    source: Path
    """The basis that the weights are of."""
    target: Path
    arkit: bool = False
    """Whether shapes of the target that are ARKit's get ARKit's names."""
    bounds: tuple[float, float] | None = None


def convert_weight_files(request: WeightConversionRequest, out: Path) -> list[str]:
    """Weights of one basis as weights of another over one topology, CSV or JSON; returns lines that tell what is lost.

    Raises `InputError` as `read_basis`, `read_weights`, `convert_weights` and `as_arkit`.
    """
    source, target = read_basis(request.source), read_basis(request.target)
    if request.arkit:
        target, _ = as_arkit(target)
    curves = read_weights(request.weights).of(source.names)
    found = convert_weights(source, target, curves.weights, request.bounds)
    write_weights(out, WeightCurves(target.names, curves.time_s, found.weights))
    return _residual(found)


def _residual(found: Conversion) -> list[str]:
    rms_mm = float(np.sqrt(np.mean(found.rms_mm**2)))
    worst_mm = float(found.worst_mm.max(initial=0.0))
    return [f"not reached: {rms_mm:.3g} mm rms, {worst_mm:.3g} mm at most, {100 * found.total_share:.3g} % of the motion"]
