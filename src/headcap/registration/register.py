"""Scan to topology: the base head placed on a scan, bent onto it, its lip line laid into the scan's."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from headcap.errors import InputError
from headcap.geometry.transforms import invert, transform
from headcap.meshes.normals import vertex_normals
from headcap.registration.align import AlignSettings, Placement, align_base, skin_triangles
from headcap.registration.eye_rims import eye_lines, eye_rims
from headcap.registration.lip_line import LipLine, LipLineSettings, find_lip_line
from headcap.registration.nonrigid import Lines, NonrigidSettings, Plate, Target, fit_stage, flipped_triangles, unfold
from headcap.registration.scan import Scan
from headcap.registration.scan_texture import bake_texture_from_scan
from headcap.registration.template import Template

HIDDEN = ("mouth_interior", "lips_inner_upper", "lips_inner_lower", "eyes")


class RegisterSettings(BaseModel):
    """Scan to topology."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    align: AlignSettings = Field(default_factory=AlignSettings, description="Global alignment")
    nonrigid: NonrigidSettings = Field(default_factory=NonrigidSettings, description="Non-rigid fit")
    lip_line: LipLineSettings = Field(default_factory=LipLineSettings, description="Valley between the lips")
    least_face_share: float = Field(0.5, ge=0, le=1, description="Share of the template's face that must lie on the scan")
    lip_stage_mm: float = Field(10.0, description="From this smoothing length on the lip line is held to the scan's")
    eye_stage_mm: float = Field(20.0, description="From this smoothing length on the lids' rims are held to the scan's eye holes")
    texture_px: int = Field(1024, ge=64, description="Side of the texture baked from the scan's colours")


@dataclass(frozen=True)
class RegisteredScan:
    """The subject in the model's topology, upright: y up, z out of the face, metres."""

    template: Template
    figures: dict[str, float]
    """register.error_median_mm, register.error_p95_mm, register.coverage_pct, register.align_score_mm, register.scale,
    register.flipped_triangles, register.lip_line_strength."""
    base_from_scan: NDArray[np.float64]
    """(4, 4) rigid transform from the scan's frame to the template's."""


def register_scan(
    base: Template, scan: Scan, settings: RegisterSettings | None = None, picks: dict[str, NDArray] | None = None
) -> RegisteredScan:
    """Bring a scan in any placement to the base's topology, without landmarks.

    `picks`: optional landmark name -> (3,) place on the scan in metres; three or more replace the search for the placement
    and all are held in the fit. Raises `InputError` for unknown names and scans that are no head.
    """
    settings = settings or RegisterSettings()
    chosen = _picked(base, picks or {})
    hidden = np.logical_or.reduce([base.regions[name] for name in HIDDEN if name in base.regions])
    placement = align_base(
        (base.vertices, skin_triangles(base.triangles, hidden)),
        (scan.vertices, scan.triangles),
        settings.align,
        (base.vertices[chosen.vertices], chosen.targets) if len(chosen.vertices) >= 3 else None,
    )
    plate = Plate(placement.apply(base.vertices), base.triangles)
    target = Target(scan, settings.nonrigid)
    vertices, line = _bend(base, plate, target, scan, hidden, chosen, settings)
    _refuse_without_lips(line, chosen)
    vertices = unfold(plate, vertices, hidden)
    figures = _figures(base, plate, vertices, target, hidden, placement, line)
    _refuse_without_face(base, vertices, target, settings)
    base_from_scan = invert(placement.scan_from_base)
    bent = base.with_vertices(transform(base_from_scan, vertices))
    textured = bake_texture_from_scan(bent, scan, settings.texture_px, base_from_scan)
    return RegisteredScan(textured, figures, base_from_scan)


def lip_pairs(base: Template) -> NDArray[np.int64]:
    """(k, 2) upper and lower vertices along the lip line from right corner (-x) to left; equal at the corners."""
    sides = []
    for side in ("upper", "lower"):
        line = np.flatnonzero(base.regions[f"lips_{side}"] & base.regions[f"lips_inner_{side}"])
        sides.append(line[np.argsort(base.vertices[line, 0])])
    if len(sides[0]) != len(sides[1]) or len(sides[0]) < 3:
        raise ValueError(f"the lip line has {len(sides[0])} upper and {len(sides[1])} lower vertices; they must pair")
    return np.stack(sides, axis=1)


def _picked(base: Template, picks: dict[str, NDArray]) -> Lines:
    unknown = sorted(set(picks) - set(base.landmarks))
    if unknown:
        raise InputError(
            f"picks name {', '.join(unknown)}",
            expected=f"names among {', '.join(sorted(base.landmarks))}",
            remedy="Rename or remove them in the picks file.",
        )
    if not picks:
        return Lines.none()
    places = np.array([np.asarray(place, float) for place in picks.values()])
    return Lines(np.array([base.landmarks[name] for name in picks]), places, alone=True)


def _bend(
    base: Template, plate: Plate, target: Target, scan: Scan, hidden: NDArray, picked: Lines, settings: RegisterSettings
) -> tuple[NDArray, LipLine | None]:
    """All stages; from `lip_stage_mm` on the lip line lies in the scan's valley."""
    vertices, lines, line = plate.rest, picked, None
    pairs, rims, lids = lip_pairs(base), eye_rims(base), None
    # the lip line's own vertices face into the mouth: only the valley may draw them, never the nearest point
    pulled = ~hidden
    for stage, length_mm in enumerate(settings.nonrigid.lengths_mm):
        if length_mm <= settings.eye_stage_mm and lids is None:
            lids = eye_lines(plate.rest, vertices, rims, scan)
            lines = lines.joined(lids)
        if length_mm <= settings.lip_stage_mm and line is None:
            line = _find_line(vertices, base, pairs, scan, settings)
            lines = lines if line is None else lines.joined(_line_targets(line, vertices, pairs))
        vertices = fit_stage(plate, vertices, pulled, target, lines, stage, settings.nonrigid)
    return vertices, line


def _find_line(vertices: NDArray, base: Template, pairs: NDArray, scan: Scan, settings: RegisterSettings) -> LipLine | None:
    lips = base.regions["lips_upper"] | base.regions["lips_lower"]
    forward = vertex_normals(vertices, base.triangles)[lips].mean(0)
    return find_lip_line(scan, vertices[pairs].mean(1), forward, settings.lip_line)


def _line_targets(line: LipLine, vertices: NDArray, pairs: NDArray) -> Lines:
    """Each pair of the lip line to the valley at the same share of its length."""
    run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(vertices[pairs].mean(1), axis=0), axis=1))])
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line.points, axis=0), axis=1))])
    at = run / run[-1] * along[-1]
    targets = np.stack([np.interp(at, along, line.points[:, axis]) for axis in range(3)], axis=1)
    both, first = np.unique(pairs.ravel(), return_index=True)
    return Lines(both, np.repeat(targets, 2, axis=0)[first])


def _refuse_without_lips(line: LipLine | None, picked: Lines) -> None:
    """What has no lips where the template's came to lie is no face, or a face placed wrongly; picks vouch for the place."""
    if line is None and len(picked.vertices) < 3:
        raise InputError(
            "the scan shows no line between lips where the mouth should be",
            expected="a head with its mouth closed or nearly so",
            remedy="Check that the scan shows the whole face; or give picks of at least three landmarks.",
        )


def _refuse_without_face(base: Template, vertices: NDArray, target: Target, settings: RegisterSettings) -> None:
    face = base.regions["face"]
    points, _, on_rim = target.nearest(vertices[face])
    share = float(((np.linalg.norm(points - vertices[face], axis=1) < 2e-3) & ~on_rim).mean())
    if share < settings.least_face_share:
        raise InputError(
            f"only {share:.0%} of the face found its place on the scan",
            expected=f"at least {settings.least_face_share:.0%}",
            remedy="Check that the scan shows the whole face; or give picks of at least three landmarks.",
        )


def _figures(
    base: Template, plate: Plate, vertices: NDArray, target: Target, hidden: NDArray, placement: Placement, line: LipLine | None
) -> dict[str, float]:
    """Distances of the skin's vertices to the scan where the scan has skin (not beyond its rims)."""
    points, normals, on_rim = target.nearest(vertices)
    facing = np.einsum("nk,nk->n", vertex_normals(vertices, base.triangles), normals) > 0
    counted = ~hidden & ~on_rim & facing
    distance = 1e3 * np.linalg.norm(points - vertices, axis=1)
    rest_flips = flipped_triangles(plate.rest, plate.triangles) | hidden[plate.triangles].any(1)
    return {
        "register.error_median_mm": float(np.median(distance[counted])),
        "register.error_p95_mm": float(np.percentile(distance[counted], 95)),
        "register.coverage_pct": float(100.0 * counted[~hidden].mean()),
        "register.align_score_mm": placement.score_mm,
        "register.scale": placement.scale,
        "register.flipped_triangles": float((flipped_triangles(vertices, plate.triangles) & ~rest_flips).sum()),
        "register.lip_line_strength": 0.0 if line is None else line.strength,
    }
