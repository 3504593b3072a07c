"""Flow on the surface: what every pixel of every view says about the motion of the mesh under it.

The data term of dense flow (Brox et al. 2004: brightness constancy, linearised, robust) with two changes that a mesh makes
possible. The unknown is the surface's motion in space, so all views speak about one unknown; and the smoothness that fills in
flat skin lives on the surface, so that the flow of the upper lip never smooths into the lower one. A pixel's row is shared out
to the corners of its triangle by its barycentrics, which keeps the normal matrix a 3x3 block per vertex. (Sharing out bounds the
true quadratic from above, so steps are careful at the finest scale and the fixed point is the same.)
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from headcap.cameras import Camera
from headcap.registration.local_contrast import Normalised, normalise
from headcap.registration.render import Source, look_up, project, shade


class PhotometricSettings(BaseModel):
    """How rendered template and photographs are compared pixel by pixel."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    window_px: int = Field(
        9, description="Box over which local mean and contrast are taken, pixels; a wide one lets changes of shading pull"
    )
    contrast_floor: float = Field(4.0, description="Grey levels added to the local contrast in quadrature")
    smoothing_px: float = Field(0.7, description="Gaussian smoothing of the photographs, pixels")
    noise: float = Field(2.0, description="Standard deviation of a photograph's noise, grey levels")
    mismatch: float = Field(0.15, description="Error of the rendering in units of local contrast")
    robust_scale: float = Field(1.5, description="Residual, in its standard deviations, at which a pixel loses 3/4 of its weight")
    least_cosine: float = Field(0.2, description="Pixels seen more obliquely than this cosine say nothing")
    margin_px: int = Field(1, description="Pixels this near an edge of the known rendering say nothing")


@dataclass(frozen=True)
class Normal:
    """Normal equations of vertex motion: block-diagonal matrix and right-hand side, both in units of 1 / m^2 and 1 / m."""

    blocks: NDArray[np.float64]
    """(n, 6) xx, xy, xz, yy, yz, zz per vertex."""
    right: NDArray[np.float64]
    """(n, 3)."""
    residual: float
    """Weighted rms residual in its standard deviations."""

    @classmethod
    def zero(cls, n_vertices: int) -> Normal:
        """No data."""
        return cls(np.zeros((n_vertices, 6)), np.zeros((n_vertices, 3)), 0.0)

    def apply(self, vectors: NDArray) -> NDArray[np.float64]:
        """The block-diagonal matrix times vectors (n, 3)."""
        image = np.zeros(self.right.shape)
        add_blocks(self.blocks, np.ascontiguousarray(vectors, np.float64), image)
        return image

    def __add__(self, other: Normal) -> Normal:
        return Normal(self.blocks + other.blocks, self.right + other.right, max(self.residual, other.residual))


@njit(cache=True)
def add_blocks(blocks, vectors, out):
    """Add the symmetric blocks (n, 6) times vectors (n, 3) to `out` (n, 3)."""
    for v in range(len(vectors)):
        x, y, z = vectors[v, 0], vectors[v, 1], vectors[v, 2]
        out[v, 0] += blocks[v, 0] * x + blocks[v, 1] * y + blocks[v, 2] * z
        out[v, 1] += blocks[v, 1] * x + blocks[v, 3] * y + blocks[v, 4] * z
        out[v, 2] += blocks[v, 2] * x + blocks[v, 4] * y + blocks[v, 5] * z


class ViewComparison:
    """One view's photograph beside the rendering of a mesh; the mesh may then move a little without being rendered again.

    `vertices_world` (n, 3) is the mesh at the photograph's moment, `photograph` grey (h, w).
    """

    def __init__(
        self,
        camera: Camera,
        source: Source,
        vertices_world: NDArray,
        normals: NDArray,
        triangles: NDArray,
        photograph: NDArray[np.float32],
        settings: PhotometricSettings,
    ) -> None:
        self.camera, self.triangles, self.photograph, self.settings = camera, triangles, photograph, settings
        self.projection = project(camera, vertices_world, triangles)
        self.empty = self.projection.raster.triangle.size == 0
        if self.empty:
            return
        rendered, self._known = shade(self.projection, triangles, source)
        self._rendered = self._normalise(rendered, self._known)
        self._inner = inner(self._known, settings.margin_px)
        self._jacobian, self._cosine = _vertex_jacobian(camera, vertices_world, normals, settings.least_cosine)

    def normal(self, vertices_world: NDArray) -> Normal:
        """What the photograph says about the mesh (n, 3) where it is now: rendered pixels are looked up where they moved to."""
        n = len(vertices_world)
        if self.empty:
            return Normal.zero(n)
        pixels = self.camera.project(vertices_world)[0].astype(np.float32)
        seen, found = look_up(self.projection.raster, self.triangles, pixels, self.photograph, self._known)
        residual, gradient, weight = self._compare(self._normalise(seen, found), found)
        blocks, right = np.zeros((n, 6)), np.zeros((n, 3))
        raster = self.projection.raster
        total = _accumulate(
            raster.triangle, raster.barycentric, self.triangles, residual, *gradient, weight, self._jacobian, self._cosine,
            self.settings.robust_scale**2, blocks, right,
        )  # fmt: skip
        return Normal(blocks, right, float(np.sqrt(total[0] / max(total[1], 1e-12))))

    def _normalise(self, image: NDArray, known: NDArray) -> Normalised:
        return normalise(image, known, window_px=self.settings.window_px, floor=self.settings.contrast_floor)

    def _compare(self, seen: Normalised, found: NDArray[np.bool_]):
        settings, rendered = self.settings, self._rendered
        mean = 0.5 * (rendered.image + seen.image)
        # derivative by central differences of both images' mean: the linearisation point half-way between them
        gradient = tuple(cv2.Sobel(mean, cv2.CV_32F, dx, 1 - dx, ksize=3, scale=1 / 8) for dx in (1, 0))
        contrast = np.minimum(rendered.contrast, seen.contrast)
        variance = settings.mismatch**2 + 2 * (settings.noise / contrast) ** 2
        weight = np.where(self._inner & found, 1.0 / variance, 0.0).astype(np.float32)
        return rendered.image - seen.image, gradient, weight


def inner(known: NDArray[np.bool_], margin_px: int) -> NDArray[np.bool_]:
    """The mask (h, w) without a rim of `margin_px`."""
    size = 2 * margin_px + 1
    # single unknown pixels are no edge
    closed = cv2.morphologyEx(known.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    return cv2.erode(closed, np.ones((size, size), np.uint8), borderValue=0).astype(bool) & known


def _vertex_jacobian(camera: Camera, vertices: NDArray, normals: NDArray, least_cosine: float):
    """Pixel derivative (n, 6) per vertex and the cosine (n,) towards the camera, 0 where too oblique."""
    jacobian = camera.project_with_jacobian(vertices)[1].reshape(-1, 6)
    towards = camera.centre - vertices
    cosine = np.einsum("nk,nk->n", towards, normals) / np.linalg.norm(towards, axis=1)
    return np.nan_to_num(jacobian), np.where(cosine > least_cosine, cosine, 0.0)


@njit(cache=True, error_model="numpy", fastmath=True)
def _accumulate(
    triangle, barycentric, triangles, residual, gradient_x, gradient_y, weight, jacobian, cosine, robust_squared, blocks, right
):
    height, width = triangle.shape
    sum_squares, sum_weights = 0.0, 0.0
    for y in range(height):
        for x in range(width):
            w = weight[y, x]
            if w == 0.0:
                continue
            f = triangle[y, x]
            r = residual[y, x]
            squared = r * r * w
            falloff = 1.0 / (1.0 + squared / robust_squared)  # Geman-McClure
            w *= falloff * falloff
            gx, gy = gradient_x[y, x], gradient_y[y, x]
            sum_squares += squared * falloff * falloff
            sum_weights += falloff * falloff
            for k in range(3):
                v = triangles[f, k]
                share = w * barycentric[y, x, k] * cosine[v]
                if share == 0.0:
                    continue
                ax = gx * jacobian[v, 0] + gy * jacobian[v, 3]
                ay = gx * jacobian[v, 1] + gy * jacobian[v, 4]
                az = gx * jacobian[v, 2] + gy * jacobian[v, 5]
                blocks[v, 0] += share * ax * ax
                blocks[v, 1] += share * ax * ay
                blocks[v, 2] += share * ax * az
                blocks[v, 3] += share * ay * ay
                blocks[v, 4] += share * ay * az
                blocks[v, 5] += share * az * az
                right[v, 0] += share * ax * r
                right[v, 1] += share * ay * r
                right[v, 2] += share * az * r
    return sum_squares, sum_weights
