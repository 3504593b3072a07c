"""Fine per-vertex refinement after the deformation graph (Li et al. 2009, section on detail synthesis).

Unknown: the displacement of each vertex from where the graph left it. The graph carries the reference's detail along with its
local rotations, so a displacement that bends little keeps that detail (the detail-preserving Laplacian of the reference in
linear form). Priors are told as standard deviations of physical things, so that they hold for any mesh density:
bending (change of mean curvature), stretch, and the displacement itself.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy import sparse

from headcap.meshes.laplacian import Factor, bilaplacian, cotangent_laplacian, vertex_areas
from headcap.registration.conjugate_gradient import conjugate_gradient
from headcap.registration.photometric import Normal, add_blocks


class RefineSettings(BaseModel):
    """Priors of the fine refinement."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    bending_per_m: float = Field(3.0, description="Standard deviation of the change of curvature over a patch of 1 cm^2, 1 / m")
    stretch: float = Field(0.1, description="Standard deviation of the displacement's gradient over a patch of 1 cm^2")
    displacement_mm: float = Field(2.0, description="Standard deviation of the displacement itself over a patch of 1 cm^2")
    solver_tolerance: float = Field(1e-3, description="Relative residual at which the conjugate gradient stops")
    solver_iterations: int = Field(60, description="Most steps of the conjugate gradient")


PATCH_M2 = 1e-4
"""Area over which the priors' standard deviations are told: 1 cm^2."""


HELD_WEIGHT = 1e12
"""Weight of a held vertex, 1 / m^2: a standard deviation of a micrometre."""


class Refiner:
    """The prior's matrix of one template, and solves with it; vertices `held` (n,) stay where they are."""

    def __init__(
        self, vertices: NDArray, triangles: NDArray, settings: RefineSettings, *, held: NDArray[np.bool_] | None = None
    ) -> None:
        self.settings = settings
        areas = vertex_areas(vertices, triangles)
        laplacian = cotangent_laplacian(vertices, triangles, least_weight=1e-3)
        bend = bilaplacian(laplacian, np.maximum(areas, 0.1 * np.median(areas))) / (PATCH_M2 * settings.bending_per_m**2)
        stretch = laplacian / (PATCH_M2 * settings.stretch**2)
        stay = sparse.diags_array(areas / (PATCH_M2 * (settings.displacement_mm * 1e-3) ** 2))
        self.prior = sparse.csr_array(bend + stretch + stay)
        if held is not None:
            self.prior = sparse.csr_array(self.prior + sparse.diags_array(HELD_WEIGHT * held))
        self._factor: Factor | None = None

    def prepare(self, normal: Normal) -> None:
        """Factor the preconditioner for data about as strong as `normal`."""
        mean = normal.blocks[:, [0, 3, 5]].mean(1)
        self._factor = Factor(self.prior + sparse.diags_array(mean))

    def solve(self, normal: Normal, displacement: NDArray) -> NDArray[np.float64]:
        """Update (n, 3) to the displacement (n, 3) that minimises data + prior."""
        if self._factor is None:
            self.prepare(normal)
        right = normal.right - self.prior @ displacement

        def apply(vectors: NDArray) -> NDArray:
            """Prior and data times vectors (n, 3)."""
            image = self.prior @ vectors
            add_blocks(normal.blocks, vectors, image)
            return image

        settings = self.settings
        update, converged = conjugate_gradient(
            apply, self._factor.solve, right, settings.solver_tolerance, settings.solver_iterations
        )
        if not converged:
            self._factor = None
        return update
