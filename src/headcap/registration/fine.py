"""The fine pass: each frame at full resolution from the coarse trajectory, independent of every other frame.

A frame's result depends on the coarse trajectory and that frame's photographs and cloud alone. Chunks therefore fit together
without a seam wherever a take is cut, and nothing can drift within a chunk.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from headcap.reconstruction.points import PointCloud
from headcap.registration.coarse import SurfaceFlow
from headcap.registration.correspondence import CorrespondenceSettings, PointPairs, ViewFlow, pairs_normal, point_pairs
from headcap.registration.motion import Motion
from headcap.registration.photographs import Photograph
from headcap.registration.photometric import PhotometricSettings
from headcap.registration.reference import Reference
from headcap.registration.refine import Refiner, RefineSettings


class FineTracker:
    """Refines coarse frames one by one; vertices `held` (n,) stay where they are."""

    def __init__(
        self,
        reference: Reference,
        photometric: PhotometricSettings,
        correspondence: CorrespondenceSettings,
        refine: RefineSettings,
        refinements: int,
        *,
        held: NDArray[np.bool_] | None = None,
    ) -> None:
        self.reference, self.photometric, self.refinements = reference, photometric, refinements
        self.correspondence = correspondence
        template = reference.template
        self.refiner = Refiner(template.vertices, template.triangles, refine, held=held)

    def refine(
        self, coarse: NDArray, trajectory: Motion, photographs: list[Photograph], cloud: PointCloud | None
    ) -> tuple[NDArray[np.float64], dict[str, float]]:
        """Positions (n, 3) of one frame from its coarse ones, and the residuals left."""
        flow = SurfaceFlow(self.reference, coarse, trajectory, photographs, self.photometric)
        pairs = None if cloud is None else self._pairs(flow, coarse, cloud)
        # each step is regularised by itself: an error of the coarse pass is no shape to hold on to
        displacement, still = np.zeros_like(coarse), np.zeros_like(coarse)
        figures: dict[str, float] = {}
        for _ in range(self.refinements):
            normal = flow.normal(coarse + displacement)
            if pairs is not None:
                triangles = self.reference.template.triangles
                normal = normal + pairs_normal(pairs, coarse + displacement, triangles, self.correspondence, slide=True)
            update = self.refiner.solve(normal, still)
            displacement += update
            figures = {"surface_flow_residual": normal.residual, "last_step_mm": 1e3 * float(np.sqrt((update**2).sum(1).mean()))}
        return coarse + displacement, figures

    def _pairs(self, flow: SurfaceFlow, positions: NDArray, cloud: PointCloud) -> PointPairs:
        """Equation 6 once the mesh lies where the photographs show it: no flow is left between rendering and photograph."""
        views = [ViewFlow(view.camera, view.projection, None, view.projection.raster.hit, None) for view in flow.views]
        return point_pairs(cloud, views, flow.offsets, positions, self.reference.template.triangles, self.correspondence)
