"""From dense flow to correspondences: equation 6 for cloud points, and reprojection targets for vertices.

Equation 6 (section 4.2): a cloud point p_i is projected into the view c_i that sees it most squarely, the flow leads from the
photograph's pixel to the rendering's, and inverse rendering gives the point v_i of the template there. Here the flow is
computed from the rendering to the photograph and inverted at the point, so that the same flow also tells where each vertex
should appear in each view: geometry alone slides along the skin, these targets do not.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from headcap.cameras import Camera
from headcap.meshes.normals import triangle_normals
from headcap.reconstruction.points import PointCloud
from headcap.registration.flow import Flow, sample
from headcap.registration.photometric import Normal
from headcap.registration.render import Projection


class CorrespondenceSettings(BaseModel):
    """Which flow and which cloud points to believe, and how much."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    least_cosine: float = Field(0.25, description="Surface seen more obliquely than this cosine is left out")
    flow_error_px: float = Field(1.0, description="Standard deviation of a flow observation at the flow's resolution, pixels")
    texture_strength: float = Field(
        0.02, description="Squared gradient of normalised contrast at which flow counts half, 1 / px^2"
    )
    mismatch_limit: float = Field(1.0, description="Largest grey level difference after warping, in units of local contrast")
    point_error_mm: float = Field(0.15, description="Standard deviation of a cloud point along its normal, millimetres")
    slide_error_mm: float = Field(
        1.0, description="Standard deviation of equation 6's surface point along the surface, millimetres"
    )
    point_limit_mm: float = Field(15.0, description="Cloud points farther from their surface point are left out, millimetres")
    normal_cosine: float = Field(0.6, description="Least agreement of a cloud point's normal with its triangle's")
    most_points: int = Field(60000, description="Larger clouds are thinned evenly to so many points for equation 6")
    point_share: float = Field(0.3, description="Weight of one cloud point, for neighbouring points err together")


@dataclass(frozen=True)
class ViewFlow:
    """One view's flow from the rendering at the photograph's moment to the photograph."""

    camera: Camera
    projection: Projection
    flow: Flow | None
    """None where the mesh already lies where the photograph shows it."""
    trusted: NDArray[np.bool_]
    """(h, w) of the window: rendering known, away from its edges, grey levels agree after warping."""
    strength: NDArray[np.float32] | None
    """(h, w) 0 to 1: how much texture the flow had to hold on to."""


@dataclass(frozen=True)
class VertexTargets:
    """Where one view's photograph shows each vertex."""

    camera: Camera
    pixels: NDArray[np.float64]
    """(n, 2) in the whole image."""
    weight: NDArray[np.float64]
    """(n,) 1 / px^2; 0 where the view says nothing."""


@dataclass(frozen=True)
class PointPairs:
    """Cloud points p_i and the surface points v_i of equation 6."""

    triangle: NDArray[np.int64]
    """(k,)"""
    barycentric: NDArray[np.float64]
    """(k, 3)"""
    points: NDArray[np.float64]
    """(k, 3) metres, world."""
    normals: NDArray[np.float64]
    """(k, 3) unit."""


def texture_strength(rendered_normalised: NDArray[np.float32], half: float) -> NDArray[np.float32]:
    """(h, w) from 0 (flat) to 1 (rich) by the smaller eigenvalue of the structure tensor over a 9-pixel window."""
    smallest = cv2.cornerMinEigenVal(rendered_normalised, 9, 3)
    # OpenCV scales the derivative by 1 / (2^(ksize-1) * blockSize) = 1/36 for floats; Sobel 3x3 itself amplifies 8 times
    squared = smallest * (36.0 / 8.0) ** 2 / 81.0
    return (squared / (squared + np.float32(half))).astype(np.float32)


def vertex_targets(
    view: ViewFlow, vertices: NDArray, normals: NDArray, visible: NDArray, settings: CorrespondenceSettings
) -> VertexTargets:
    """Reprojection targets of the mesh (n, 3) as it was rendered, with `visible` (n,) from the z-buffer."""
    window = view.projection.window
    local = view.projection.pixels - (window.x0, window.y0)
    shift = view.flow.at(local)
    towards = view.camera.centre - vertices
    cosine = np.einsum("nk,nk->n", towards, normals) / np.linalg.norm(towards, axis=1)
    trust = sample(view.trusted.astype(np.float32), local)
    strength = sample(view.strength, local)
    good = visible & (cosine > settings.least_cosine) & (trust > 0.99) & np.isfinite(shift).all(1)
    weight = np.where(good, np.nan_to_num(strength) * cosine / settings.flow_error_px**2, 0.0)
    return VertexTargets(view.camera, np.where(good[:, None], view.projection.pixels + shift, 0.0), weight)


def targets_normal(targets: VertexTargets, vertices: NDArray, robust_px: float) -> Normal:
    """Normal equations of a view's targets at vertices (n, 3), with Geman-McClure weights of scale `robust_px`."""
    blocks, right = np.zeros((len(vertices), 6)), np.zeros((len(vertices), 3))
    used = np.flatnonzero(targets.weight > 0)
    if len(used) == 0:
        return Normal(blocks, right, 0.0)
    pixels, jacobian = targets.camera.project_with_jacobian(vertices[used])
    residual = targets.pixels[used] - pixels
    squared = np.einsum("nk,nk->n", residual, residual)
    weight = targets.weight[used] / (1 + squared / robust_px**2) ** 2
    _accumulate_targets(used, jacobian, residual, weight, blocks, right)
    return Normal(blocks, right, float(np.sqrt(np.median(squared))))


def residual_spread_px(targets: list[VertexTargets], positions: list[NDArray]) -> float:
    """95th percentile of all views' residuals, pixels, for a mesh (n, 3) placed at each view's moment."""
    parts = [np.zeros(1)]
    for target, vertices in zip(targets, positions, strict=True):
        used = target.weight > 0
        parts.append(np.linalg.norm(target.pixels[used] - target.camera.project(vertices[used])[0], axis=1))
    return float(np.percentile(np.concatenate(parts), 95))


def point_pairs(
    cloud: PointCloud,
    views: list[ViewFlow],
    offsets: list[NDArray],
    vertices: NDArray,
    triangles: NDArray,
    settings: CorrespondenceSettings,
) -> PointPairs:
    """Equation 6 for a cloud and a mesh (n, 3), (m, 3) at the frame's moment.

    `offsets` holds per view the mesh's motion (n, 3) from the frame's moment to that of the photograph; a point moves along
    with the surface it is projected onto before it is looked up. Points whose normal disagrees with the triangle found are left
    out: at the lips the ray may meet the wrong one.
    """
    every = slice(None, None, max(1, -(-len(cloud) // settings.most_points)))
    positions, normals = cloud.positions[every].astype(float), cloud.normals[every].astype(float)
    best = _squarest_view(positions, normals, views, settings.least_cosine)
    facing = triangle_normals(vertices, triangles)
    facing /= np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-20)
    parts = []
    for c, (view, offset) in enumerate(zip(views, offsets, strict=True)):
        chosen = np.flatnonzero(best == c)
        triangle, barycentric = _inverse_render(view, positions[chosen], offset, triangles)
        agree = np.einsum("ki,ki->k", facing[triangle], normals[chosen]) > settings.normal_cosine
        hit = (triangle >= 0) & agree
        parts.append((triangle[hit], barycentric[hit], positions[chosen[hit]], normals[chosen[hit]]))
    return PointPairs(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def pairs_normal(
    pairs: PointPairs, vertices: NDArray, triangles: NDArray, settings: CorrespondenceSettings, *, slide: bool = False
) -> Normal:
    """Normal equations of point pairs at vertices (n, 3): tight along the point's normal, loose or (`slide`) free across it."""
    corners = triangles[pairs.triangle]
    surface = np.einsum("kc,kci->ki", pairs.barycentric, vertices[corners])
    residual = pairs.points - surface
    distance = np.linalg.norm(residual, axis=1)
    along = np.einsum("ki,ki->k", residual, pairs.normals)
    scale = settings.point_error_mm * 1e-3
    weight = settings.point_share / (1 + (along / (4 * scale)) ** 2) ** 2 * (distance < settings.point_limit_mm * 1e-3)
    blocks, right = np.zeros((len(vertices), 6)), np.zeros((len(vertices), 3))
    loose = 0.0 if slide else (settings.slide_error_mm * 1e-3) ** -2
    _accumulate_points(corners, pairs.barycentric, pairs.normals, residual, weight, 1 / scale**2, loose, blocks, right)
    return Normal(blocks, right, float(np.median(np.abs(along))) if len(along) else 0.0)


def _squarest_view(positions, normals, views, least_cosine) -> NDArray[np.int64]:
    return _best_view(positions, normals, np.array([view.camera.centre for view in views]), least_cosine)


def _inverse_render(view: ViewFlow, points: NDArray, offset: NDArray, triangles: NDArray):
    """Triangle (k,), -1 where there is none, and barycentrics (k, 3) of equation 6 for points seen by one view."""
    window, raster = view.projection.window, view.projection.raster
    corner = (window.x0, window.y0)
    start, start_weights = _pick(raster, view.camera.project(points)[0] - corner, None)
    moved = points.copy()
    _carry(start, start_weights, triangles, offset, moved)
    pixels = view.camera.project(moved)[0] - corner
    back = 0.0 if view.flow is None else view.flow.inverse_at(pixels)
    return _pick(raster, pixels + back, view.trusted)


def _pick(raster, pixels: NDArray, trusted: NDArray | None):
    triangle, weights = np.full(len(pixels), -1, np.int64), np.zeros((len(pixels), 3))
    _nearest_pixel(raster.triangle, raster.barycentric, raster.hit if trusted is None else trusted, pixels, triangle, weights)
    return triangle, weights


@njit(cache=True)
def _nearest_pixel(raster_triangle, raster_barycentric, trusted, pixels, triangle, weights):
    height, width = raster_triangle.shape
    for i in range(len(pixels)):
        u, v = pixels[i, 0], pixels[i, 1]
        if not (u >= -0.5 and v >= -0.5 and u < width - 0.5 and v < height - 0.5):
            continue
        x, y = int(np.rint(u)), int(np.rint(v))
        if x < width and y < height and trusted[y, x] and raster_triangle[y, x] >= 0:
            triangle[i] = raster_triangle[y, x]
            for k in range(3):
                weights[i, k] = raster_barycentric[y, x, k]


@njit(cache=True)
def _carry(triangle, weights, triangles, offset, points):
    """Move points along with the triangles that they lie on."""
    for i in range(len(points)):
        if triangle[i] < 0:
            continue
        for k in range(3):
            corner = triangles[triangle[i], k]
            for axis in range(3):
                points[i, axis] += weights[i, k] * offset[corner, axis]


@njit(cache=True)
def _best_view(positions, normals, centres, least_cosine):
    best = np.full(len(positions), -1, np.int64)
    for i in range(len(positions)):
        highest = least_cosine
        for c in range(len(centres)):
            x, y, z = centres[c, 0] - positions[i, 0], centres[c, 1] - positions[i, 1], centres[c, 2] - positions[i, 2]
            cosine = (x * normals[i, 0] + y * normals[i, 1] + z * normals[i, 2]) / np.sqrt(x * x + y * y + z * z)
            if cosine > highest:
                highest, best[i] = cosine, c
    return best


@njit(cache=True)
def _accumulate_targets(used, jacobian, residual, weight, blocks, right):
    for i in range(len(used)):
        v, w = used[i], weight[i]
        for k in range(2):
            x, y, z = jacobian[i, k, 0], jacobian[i, k, 1], jacobian[i, k, 2]
            blocks[v, 0] += w * x * x
            blocks[v, 1] += w * x * y
            blocks[v, 2] += w * x * z
            blocks[v, 3] += w * y * y
            blocks[v, 4] += w * y * z
            blocks[v, 5] += w * z * z
            right[v, 0] += w * x * residual[i, k]
            right[v, 1] += w * y * residual[i, k]
            right[v, 2] += w * z * residual[i, k]


@njit(cache=True, error_model="numpy")
def _accumulate_points(corners, barycentric, normals, residual, weight, tight, loose, blocks, right):
    for i in range(len(corners)):
        if weight[i] == 0.0:
            continue
        n0, n1, n2 = normals[i, 0], normals[i, 1], normals[i, 2]
        extra = tight - loose
        along = n0 * residual[i, 0] + n1 * residual[i, 1] + n2 * residual[i, 2]
        for k in range(3):
            share = weight[i] * barycentric[i, k]
            v = corners[i, k]
            blocks[v, 0] += share * (loose + extra * n0 * n0)
            blocks[v, 1] += share * extra * n0 * n1
            blocks[v, 2] += share * extra * n0 * n2
            blocks[v, 3] += share * (loose + extra * n1 * n1)
            blocks[v, 4] += share * extra * n1 * n2
            blocks[v, 5] += share * (loose + extra * n2 * n2)
            right[v, 0] += share * (loose * residual[i, 0] + extra * along * n0)
            right[v, 1] += share * (loose * residual[i, 1] + extra * along * n1)
            right[v, 2] += share * (loose * residual[i, 2] + extra * along * n2)
