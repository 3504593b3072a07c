"""A registered template against the scan it was fitted to; no truth is needed."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_json
from headcap.evaluation.ties import at_border
from headcap.geometry.transforms import transform
from headcap.meshes.closest_point import Surface
from headcap.meshes.normals import triangle_normals
from headcap.registration.scan import Scan
from headcap.registration.template import Template

# What a scan of a face with closed lips and a camera outside cannot show.
NOT_SCANNED = ("eyes", "mouth_interior", "lips_inner_upper", "lips_inner_lower")


@dataclass(frozen=True)
class RegistrationErrors:
    """Template vertices against the scan's surface."""

    surface_mm: NDArray[np.float64]
    """(n,) distance of each vertex; NaN where the scan has no surface to compare with."""
    flipped_triangles: int
    """Triangles with no area, or turned by more than 90 degrees against all of the normals around them."""

    def figures(self) -> dict[str, float]:
        """The `register` figures."""
        return {
            "register.error_median_mm": float(np.nanmedian(self.surface_mm)),
            "register.error_p95_mm": float(np.nanpercentile(self.surface_mm, 95)),
            "register.flipped_triangles": float(self.flipped_triangles),
        }


def compare_registration(template: Template, scan_vertices: NDArray, scan_triangles: NDArray) -> RegistrationErrors:
    """Errors of a template against a scan (v, 3), (m, 3), both in metres in one frame.

    Left out are eyes, mouth interior and the inner sides of the lips, which no scan shows, and vertices whose nearest
    point lies on an open border of the scan. Nothing else: a vertex on the wrong layer counts with its distance.
    """
    nearest = Surface(scan_vertices, scan_triangles).closest(template.vertices)
    error = 1e3 * nearest.distance
    error[at_border(nearest.triangle, nearest.barycentric, scan_triangles)] = np.nan
    for name in NOT_SCANNED:
        error[template.regions.get(name, np.zeros(len(error), bool))] = np.nan
    return RegistrationErrors(error, count_flipped(template.vertices, template.triangles))


def place_scan(scan: Scan, placement: Path | str) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """A scan's vertices (v, 3) in the registered template's frame, metres, and its triangles (m, 3).

    `placement` is the `headcap.scan_placement/1` that register wrote; raises `ArtifactError` for another file.
    """
    base_from_scan = np.array(load_json(placement, "scan_placement", 1)["base_from_scan"])
    return transform(base_from_scan, scan.vertices), scan.triangles


def count_flipped(vertices: NDArray, triangles: NDArray) -> int:
    """Triangles of a mesh (n, 3), (m, 3) without area, or turned by more than 90 degrees against every corner's normal."""
    normals = triangle_normals(np.asarray(vertices, float), triangles)
    area = np.linalg.norm(normals, axis=1)
    unit = normals / np.where(area > 0, area, 1.0)[:, None]
    sums = np.stack([np.bincount(triangles.ravel(), np.repeat(unit[:, k], 3), len(vertices)) for k in range(3)], axis=1)
    around = sums[triangles] - unit[:, None]  # the corner's normal without the triangle's own share
    turned = (np.einsum("fck,fk->fc", around, unit) < 0).all(axis=1)
    return int(np.count_nonzero(turned | (area == 0)))
