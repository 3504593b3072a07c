"""The figures by name: unit, default limit, which side of it is good, and what the figure means."""

from dataclasses import dataclass


@dataclass(frozen=True)
class FigureKind:
    """One row of the table of figures."""

    unit: str
    meaning: str
    limit: float | None = None
    """None: the figure is stated, not held to a limit."""
    at_least: bool = False
    """True where more is better."""
    needs_truth: bool = True


def _stated(unit: str, meaning: str, limit: float | None = None) -> FigureKind:
    return FigureKind(unit, meaning, limit, needs_truth=False)


_MATERIAL = "tied at the reference frame to the true surface; later the distance to where that material point has gone"

CATALOGUE: dict[str, FigureKind] = {
    "sync.offset_error_ms": FigureKind("ms", "start times against the true ones, common mean taken out, rms", 0.1),
    "sync.residual_ms": _stated("ms", "disagreement of the pairwise delays with the solved start times, rms"),
    "calibrate.heldout_rms_px": _stated("px", "board corners in poses left out of the adjustment, rms", 0.15),
    "calibrate.heldout_p95_px": _stated("px", "board corners in poses left out of the adjustment, 95th percentile"),
    "calibrate.board_scale_error_mm": _stated("mm", "distances between triangulated held-out corners against the board, rms"),
    "calibrate.centre_error_mm": FigureKind("mm", "camera centres after one rigid alignment, rms", 0.3),
    "calibrate.rotation_error_deg": FigureKind("deg", "camera rotations after the same alignment, rms", 0.03),
    "reconstruct.error_median_mm": FigureKind("mm", "points to the true surface at that time, median", 0.09),
    "reconstruct.error_p90_mm": FigureKind("mm", "points to the true surface at that time, 90th percentile", 0.3),
    "reconstruct.completeness_half_mm": FigureKind("%", "true surface seen by 3 cameras with a point within 0.5 mm", 75.0, True),
    "reconstruct.completeness_1mm": FigureKind("%", "true surface seen by 3 cameras with a point within 1 mm", 94.0, True),
    "reconstruct.points": FigureKind("", "points per frame, median", at_least=True, needs_truth=False),
    "register.error_median_mm": _stated("mm", "template vertices to the scan's surface, median", 0.15),
    "register.error_p95_mm": _stated("mm", "template vertices to the scan's surface, 95th percentile", 0.6),
    "register.flipped_triangles": _stated("", "triangles of the template turned by more than 90 degrees against all around them"),
    "track.surface_error_median_mm": FigureKind("mm", "seen template vertices to the true surface, all frames, median", 0.12),
    "track.surface_error_p95_mm": FigureKind("mm", "seen template vertices to the true surface, 95th percentile", 0.5),
    "track.drift_median_mm": FigureKind("mm", f"seen template vertices {_MATERIAL}, median", 0.15),
    "track.drift_p95_mm": FigureKind("mm", f"seen template vertices {_MATERIAL}, 95th percentile", 0.8),
    "track.drift_all_median_mm": FigureKind("mm", f"all template vertices, seen or not, {_MATERIAL}, median"),
    "track.drift_all_p95_mm": FigureKind("mm", f"all template vertices, seen or not, {_MATERIAL}, 95th percentile"),
    "track.lip_gap_error_mm": FigureKind("mm", "distance between upper and lower inner-lip material points, rms error", 0.5),
    "track.cloud_distance_median_mm": _stated("mm", "reconstructed points to the tracked mesh, median"),
    "track.flipped_triangles": _stated("", "triangles turned by more than 90 degrees against all around them, worst frame"),
}


def unit_of(name: str) -> str:
    """The unit of a figure: from the catalogue, else from the suffix of its name."""
    if name in CATALOGUE:
        return CATALOGUE[name].unit
    suffix = name.rsplit("_", 1)[-1]
    return {"pct": "%", "ppm": "ppm"}.get(suffix, suffix if suffix in ("mm", "px", "ms", "deg", "s", "hz", "m") else "")
