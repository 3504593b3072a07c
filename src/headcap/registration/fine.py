"""The fine pass: each frame at full resolution from the coarse trajectory, independent of every other frame.

A frame's result depends on the coarse trajectory and that frame's photographs and cloud alone. Chunks therefore fit together
without a seam wherever a take is cut, and nothing can drift within a chunk.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.reconstruction.points import PointCloud
from headcap.registration.coarse import Motion, SurfaceFlow
from headcap.registration.correspondence import CorrespondenceSettings, PointPairs, ViewFlow, pairs_normal, point_pairs
from headcap.registration.photographs import Photograph
from headcap.registration.photometric import PhotometricSettings
from headcap.registration.reference import Reference
from headcap.registration.refine import Refiner, RefineSettings


@dataclass(frozen=True)
class Trajectory:
    """Motion about a frame from the polynomial through its neighbours in the coarse pass.

    A brisk head shake is no parabola within three frames: with two neighbours on either side what is left at half a frame is a
    fifth difference times 0.01, and noise of the coarse pass enters with weights below one.
    """

    time_s: NDArray[np.float64]
    """(k,) frames, rising."""
    positions: NDArray[np.float64]
    """(k, n, 3) metres."""
    index: int
    """Which of them is the frame."""

    def offsets(self, delays_s: list[float]) -> list[NDArray[np.float64]]:
        """Motion (n, 3) from the frame to each of the moments `delays_s` later."""
        return [self._offset(delay_s) for delay_s in delays_s]

    def fields(self, delay_s: float) -> NDArray[np.float64]:
        """(3, n, 3) corrections: more velocity, velocity along the acceleration, more acceleration."""
        step_s = float(np.median(np.diff(self.time_s))) if len(self.time_s) > 1 else 1.0
        ahead, behind = self._offset(0.5 * step_s), self._offset(-0.5 * step_s)
        velocity, acceleration = ahead - behind, 4 * (ahead + behind)
        share = delay_s / step_s
        return np.stack([share * velocity, share * acceleration, share**2 * acceleration])

    def _offset(self, delay_s: float) -> NDArray[np.float64]:
        weights = _lagrange(self.time_s, self.time_s[self.index] + delay_s)
        weights[self.index] -= 1.0
        return np.tensordot(weights, self.positions, axes=1)


def _lagrange(nodes: NDArray, x: float) -> NDArray[np.float64]:
    """Weights (k,) of values at distinct nodes (k,) that give the interpolating polynomial at x."""
    apart = nodes[:, None] - nodes + np.eye(len(nodes))
    factors = np.where(np.eye(len(nodes), dtype=bool), 1.0, (x - nodes) / apart)
    return factors.prod(axis=1)


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
