"""Dense optical flow between two pictures of one surface under changing light.

Both pictures are normalised by local mean and contrast, dense inverse search (DIS, Kroeger et al. 2016) gives a start that
survives large motion, and variational refinement with the functional of Brox et al. 2004 (brightness and gradient constancy,
robust smoothness) gives sub-pixel flow at full resolution.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from headcap.registration.local_contrast import normalise


class FlowSettings(BaseModel):
    """Dense flow between a rendering and a photograph."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    window_px: int = Field(
        31, description="Box over which local mean and contrast are taken, pixels; 0 compares grey levels as they are"
    )
    contrast_floor: float = Field(8.0, description="Grey levels added to the local contrast in quadrature")
    spread: float = Field(32.0, description="Grey levels per unit of normalised contrast when both are handed to the flow")
    finest_scale: int = Field(1, description="Pyramid level at which dense inverse search stops (0 is the full image)")
    patch_stride_px: int = Field(3, description="Stride of dense inverse search's 8x8 patches, pixels")
    descent_iterations: int = Field(16, description="Gradient descent steps per patch")
    smoothness: float = Field(10.0, description="Weight of smoothness in the variational refinement (alpha)")
    brightness: float = Field(5.0, description="Weight of brightness constancy (delta)")
    gradient: float = Field(10.0, description="Weight of gradient constancy (gamma)")
    outer_iterations: int = Field(5, description="Fixed-point iterations of the variational refinement")
    inner_iterations: int = Field(5, description="Relaxation sweeps per fixed-point iteration")
    consistency_px: float = Field(1.0, description="Largest disagreement of forward and backward flow, pixels")


@dataclass(frozen=True)
class Flow:
    """Where each pixel of the first image is found in the second."""

    displacement: NDArray[np.float32]
    """(h, w, 2) pixels: the first image's pixel u lies at u + displacement(u) in the second."""
    mismatch: NDArray[np.float32]
    """(h, w) difference of the normalised grey levels after warping, in units of local contrast."""

    def at(self, pixels: NDArray) -> NDArray[np.float64]:
        """Displacement (n, 2) at pixels (n, 2) of the first image, bilinear; NaN outside."""
        return sample(self.displacement, pixels)

    def inverse_at(self, pixels: NDArray, *, iterations: int = 4) -> NDArray[np.float64]:
        """Displacement (n, 2) back into the first image at pixels (n, 2) of the second: fixed point of u = p - flow(u)."""
        found = np.array(pixels, float)
        for _ in range(iterations):
            found = pixels - sample(self.displacement, found)
        return found - pixels


def dense_flow(first: NDArray, second: NDArray, settings: FlowSettings) -> Flow:
    """Flow from one grey image (h, w) to another of the same size, floats or bytes."""
    a, b = _prepare(first, settings), _prepare(second, settings)
    displacement = _search(settings).calc(a, b, None)
    if settings.outer_iterations > 0:
        _refinement(settings).calcUV(a, b, *(parts := [np.ascontiguousarray(displacement[..., k]) for k in range(2)]))
        displacement = np.stack(parts, axis=-1)
    grid_x, grid_y = np.meshgrid(np.arange(a.shape[1], dtype=np.float32), np.arange(a.shape[0], dtype=np.float32))
    warped = cv2.remap(
        b, grid_x + displacement[..., 0], grid_y + displacement[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT
    )
    return Flow(displacement, np.abs(warped.astype(np.float32) - a) / settings.spread)


def consistent(forward: Flow, backward: Flow, limit_px: float) -> NDArray[np.bool_]:
    """(h, w) true where going there and back ends within `limit_px` of the start: neither occluded nor lost."""
    h, w = forward.displacement.shape[:2]
    start = np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1).reshape(-1, 2)
    there = forward.displacement.reshape(-1, 2)
    back = sample(backward.displacement, start + there)
    with np.errstate(invalid="ignore"):
        return (np.linalg.norm(there + back, axis=1) < limit_px).reshape(h, w)


def sample(field: NDArray, pixels: NDArray) -> NDArray[np.float64]:
    """Values (n, k) or (n,) of a field (h, w, k) or (h, w) at pixels (n, 2), bilinear; NaN outside or at NaN pixels."""
    h, w = field.shape[:2]
    channels = np.ascontiguousarray(field).reshape(h, w, -1)
    out = np.full((len(pixels), channels.shape[2]), np.nan)
    if channels.size:
        _bilinear(channels, np.ascontiguousarray(pixels, np.float64), out)
    return out.reshape(len(pixels), *field.shape[2:])


@njit(cache=True, error_model="numpy")
def _bilinear(field, pixels, out):
    h, w, channels = field.shape
    for i in range(len(pixels)):
        u, v = pixels[i, 0], pixels[i, 1]
        if not (u >= 0.0 and v >= 0.0 and u <= w - 1 and v <= h - 1):
            continue
        x, y = min(int(u), max(w - 2, 0)), min(int(v), max(h - 2, 0))
        x1, y1 = min(x + 1, w - 1), min(y + 1, h - 1)
        fx, fy = u - x, v - y
        for k in range(channels):
            top = field[y, x, k] * (1 - fx) + field[y, x1, k] * fx
            bottom = field[y1, x, k] * (1 - fx) + field[y1, x1, k] * fx
            out[i, k] = top * (1 - fy) + bottom * fy


def _prepare(image: NDArray, settings: FlowSettings) -> NDArray[np.uint8]:
    if settings.window_px <= 0:
        return np.clip(np.rint(image), 0, 255).astype(np.uint8)
    normal = normalise(image, None, window_px=settings.window_px, floor=settings.contrast_floor).image
    return np.clip(np.rint(128 + settings.spread * normal), 0, 255).astype(np.uint8)


def _search(settings: FlowSettings) -> cv2.DISOpticalFlow:
    search = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    search.setFinestScale(settings.finest_scale)
    search.setPatchStride(settings.patch_stride_px)
    search.setGradientDescentIterations(settings.descent_iterations)
    return search


def _refinement(settings: FlowSettings) -> cv2.VariationalRefinement:
    refinement = cv2.VariationalRefinement_create()
    refinement.setAlpha(settings.smoothness)
    refinement.setDelta(settings.brightness)
    refinement.setGamma(settings.gradient)
    refinement.setFixedPointIterations(settings.outer_iterations)
    refinement.setSorIterations(settings.inner_iterations)
    return refinement
