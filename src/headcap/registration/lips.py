"""The lips followed at full resolution within the coarse pass.

Lips carry little texture, move fast and roll. At reduced resolution their flow is too weak to follow, and an error once made
hides the texture that would mend it. So each frame of the coarse pass ends with surface flow at full resolution on the mouth
alone: the skin around it is held where the whole mesh put it. The mouth is a part of the mesh, and so is the price.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra

from headcap.cameras import Camera
from headcap.reconstruction.points import PointCloud
from headcap.registration.correspondence import CorrespondenceSettings
from headcap.registration.fine import FineTracker
from headcap.registration.graph import edge_graph
from headcap.registration.motion import Motion
from headcap.registration.photographs import Photograph
from headcap.registration.reference import Reference, part_of
from headcap.registration.refine import RefineSettings
from headcap.registration.track_settings import LipSettings


class LipTracker:
    """Surface flow on the part of a reference (full resolution) around the lips."""

    def __init__(
        self, reference: Reference, settings: LipSettings, correspondence: CorrespondenceSettings, refine: RefineSettings
    ) -> None:
        template = reference.template
        chosen = near_lips(template.vertices, template.triangles, template.regions, 1e-3 * settings.reach_mm)
        self._chosen = chosen
        part, self.vertices = part_of(reference, chosen)
        held = np.zeros(len(self.vertices), np.bool_)
        if len(self.vertices):
            held = at_rim(template.triangles, part.template.triangles, self.vertices, len(template.vertices))
        self.fine = FineTracker(part, settings.photometric, correspondence, refine, settings.steps, held=held)

    def show(self, reference: Reference) -> None:
        """Compare with another reference of the same template from now on."""
        self.fine.reference = part_of(reference, self._chosen)[0]

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """At the resolution of the photographs that `refine` expects."""
        return self.fine.reference.cameras

    def refine(
        self, positions: NDArray, motion: Motion, photographs: list[Photograph], cloud: PointCloud | None
    ) -> NDArray[np.float64]:
        """Positions (n, 3) of the whole mesh with the mouth drawn to where the photographs show it."""
        if len(self.vertices) == 0:
            return positions
        moved = positions.copy()
        own = _PartMotion(motion, self.vertices)
        moved[self.vertices] = self.fine.refine(positions[self.vertices], own, photographs, cloud)[0]
        return moved


def near_lips(vertices: NDArray, triangles: NDArray, regions: dict[str, NDArray[np.bool_]], reach_m: float) -> NDArray[np.bool_]:
    """(n,) vertices within a distance along the surface from the lips; none where the template names no lips."""
    masks = [mask for name, mask in regions.items() if name.startswith("lips")]
    if not masks or not np.any(masks):
        return np.zeros(len(vertices), np.bool_)
    distance = dijkstra(
        edge_graph(vertices, triangles), indices=np.flatnonzero(np.any(masks, axis=0)), limit=reach_m, min_only=True
    )
    return np.isfinite(distance)


def at_rim(whole: NDArray, part: NDArray, vertices: NDArray, n_vertices: int) -> NDArray[np.bool_]:
    """(k,) vertices of a part that have triangles outside it; `vertices` (k,) are its indices in the whole."""
    count = np.bincount(whole.ravel(), minlength=n_vertices)[vertices]
    return np.bincount(part.ravel(), minlength=len(vertices)) < count


@dataclass(frozen=True)
class _PartMotion:
    """The motion of some vertices."""

    whole: Motion
    vertices: NDArray[np.int64]

    def offsets(self, delays_s: list[float]) -> list[NDArray[np.float64]]:
        """Motion (k, 3) to each of the moments `delays_s` later."""
        return [offset[self.vertices] for offset in self.whole.offsets(delays_s)]

    def fields(self, delay_s: float) -> NDArray[np.float64]:
        """(c, k, 3) what one unit of each correction moves."""
        return self.whole.fields(delay_s)[:, self.vertices]
