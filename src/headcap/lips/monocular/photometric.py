"""The dense photometric term: rendered skin against the picture, fused into normal equations without a pixel's Jacobian.

A pixel p that sees triangle (a, b, c) has the residual r_p = I(p) - sum_j l_j c_j with image-linear shares l and vertex colours
c_j = a_j (.) Y(n_j) L. Its derivative is sum_j l_j (g_p . du_j - h_j . dn_j): g_p is the image's gradient there, u_j the
projected vertex, h_j = a_j dY/dn L. Each vertex gathers what the pixels around it say (15 numbers). The gradient of the robust
energy is exact. Of the Gauss-Newton matrix the cross terms between a pixel's corners are lumped on the corners: shares are not
negative and sum to one, so that by Jensen's inequality the lumped matrix bounds the true one from above, and a step never
overshoots the linearised problem.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.lips.monocular.surface import Slopes
from headcap.meshes.rasteriser import Raster, rasterise_pixels

_SUMS = 16
"""Per vertex, sums over pixels by its share in them times their robust weight w: 1 (place 0); gradient's second moments xx, xy,
yy (1 to 3); gradient x, y of each channel (4 to 9); residual times gradient x, y (10, 11); residual of each channel (12 to 14).
Without the robust weight: shares alone (15)."""
_EDGE_JUMP_M = 0.004
"""A step in depth between neighbouring pixels that no skin makes: an occluding border, where a pixel sees two things."""


@dataclass(frozen=True, eq=False)
class Level:
    """A picture at one resolution."""

    camera: Camera
    """Of this resolution; its pose is the identity."""
    picture: NDArray[np.float32]
    """(height, width, 3) linear intensities."""
    slope_x: NDArray[np.float32]
    """(height, width, 3) per pixel."""
    slope_y: NDArray[np.float32]

    @classmethod
    def of(cls, camera: Camera, picture: NDArray) -> Level:
        """Gradients are central differences; the outermost pixels are not used."""
        picture = np.ascontiguousarray(picture, np.float32)
        kernel = np.array([[-0.5, 0.0, 0.5]], np.float32)
        return cls(camera, picture, cv2.filter2D(picture, -1, kernel), cv2.filter2D(picture, -1, kernel.T))


@dataclass(frozen=True, eq=False)
class View:
    """What a level sees of a surface."""

    raster: Raster
    pixels: NDArray[np.float64]
    """(n, 2) projected vertices."""
    depth: NDArray[np.float64]
    """(n,) metres."""
    shares: NDArray[np.float32]
    """(height, width, 3) of the seen triangle's corners, linear in the image."""
    usable: NDArray[np.bool_]
    """(height, width) where skin is seen, away from occluding borders."""


@dataclass(frozen=True, eq=False)
class PhotoSums:
    """What pixels say about vertices, and how well picture and rendering agree."""

    sums: NDArray[np.float64]
    """(n, 16), see `_SUMS`."""
    cost: float
    """Robust energy: sum over pixels of rho(|r| / scale), each at most 1."""
    pixels: float
    """Sum of the pixels' confidences."""
    inliers: float
    """Sum of the robust weights times confidence."""
    squares: float
    """Sum of confidence times robust weight times |r|^2."""
    scale: float
    """Of the robust function, linear intensity."""


def see(level: Level, vertices: NDArray, triangles: NDArray) -> View:
    """Rasterise vertices (n, 3), in the camera's axes, and triangles (m, 3) into a level."""
    pixels, depth = level.camera.project(vertices)
    raster = rasterise_pixels(pixels, depth, triangles, level.camera.size)
    shares = np.zeros_like(raster.barycentric)
    usable = np.zeros(raster.triangle.shape, bool)
    _prepare(raster.triangle, raster.barycentric, raster.depth, pixels, depth, triangles, shares, usable)
    return View(raster, pixels, depth, shares, usable)


def gather(level: Level, view: View, triangles: NDArray, colours: NDArray, confidence: NDArray, scale: float) -> PhotoSums:
    """Gather the photometric term of vertex colours (n, 3), trusted by confidence (n,), at a residual scale (intensity).

    The robust function is Geman and McClure's, rho(x) = x^2 / (1 + x^2), of the length of a pixel's residual over the scale.
    """
    sums, totals = np.zeros((len(colours), _SUMS)), np.zeros(4)
    _gather(
        level.picture,
        level.slope_x,
        level.slope_y,
        view.raster.triangle,
        view.shares,
        view.usable,
        np.ascontiguousarray(triangles),
        np.ascontiguousarray(colours, np.float32),
        np.ascontiguousarray(confidence, np.float32),
        np.float32(1.0 / scale**2),
        sums,
        totals,
    )
    return PhotoSums(sums, *totals.tolist(), scale)


def residual_lengths(level: Level, view: View, triangles: NDArray, colours: NDArray, confidence: NDArray) -> NDArray[np.float32]:
    """(k,) lengths of the residuals of all usable pixels whose corners are trusted, in no particular order."""
    here = view.usable & (view.raster.triangle >= 0)
    corners = triangles[view.raster.triangle[here]]
    trusted = confidence[corners].min(axis=1) > 0.0
    rendered = np.einsum("kj,kjc->kc", view.shares[here][trusted], colours[corners[trusted]])
    return np.linalg.norm(level.picture[here][trusted] - rendered, axis=1)


def observed(photo: PhotoSums, colours: NDArray) -> tuple[NDArray, NDArray]:
    """What each vertex looks like: colours (n, 3) for which its mean residual vanishes, and the weight (n,) behind them."""
    weight = photo.sums[:, 0]
    return colours + photo.sums[:, 12:15] / np.maximum(weight, 1e-12)[:, None], weight


@dataclass(frozen=True, eq=False)
class Chain:
    """What a vertex's place, normal and the light do to what is seen and shown of it."""

    pixels: NDArray[np.float64]
    """(n, 2, 3) derivative of projected vertices by their place."""
    colours: NDArray[np.float64]
    """(n, 3, 3) h, derivative of rendered colours (second axis) by the normal."""
    light: NDArray[np.float64]
    """(n, 3, 9) derivative of each channel's rendered colour by that channel's light: albedo times harmonics."""


@dataclass(frozen=True, eq=False)
class Normal:
    """Lumped Gauss-Newton matrices of sum w |r|^2, together an upper bound of the full one."""

    geometry: NDArray[np.float64]
    """(p, p)."""
    mixed: NDArray[np.float64]
    """(p, 27) geometry by light."""
    light: NDArray[np.float64]
    """(27, 27)."""


def right_side(photo: PhotoSums, chain: Chain, slopes: Slopes) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Minus half the gradient of sum w |r|^2 by the unknowns of `slopes` (p,) and by the light (27,)."""
    by_vertex = np.einsum("nd,ndi->ni", photo.sums[:, 10:12], chain.pixels).astype(np.float32)
    by_normal = np.einsum("nc,nci->ni", photo.sums[:, 12:15], chain.colours).astype(np.float32)
    p = len(slopes.columns)
    geometry = slopes.normals.reshape(p, -1) @ by_normal.ravel() - slopes.vertices.reshape(p, -1) @ by_vertex.ravel()
    return geometry.astype(np.float64), np.einsum("nc,nck->ck", photo.sums[:, 12:15], chain.light).ravel()


def normal_matrix(photo: PhotoSums, chain: Chain, slopes: Slopes) -> Normal:
    """The lumped matrices at the unknowns of `slopes` (p,) and the light (3 x 9)."""
    seen = np.flatnonzero(photo.sums[:, 0] > 1e-9)
    rows = np.empty((len(slopes.columns), 5 * len(seen)), np.float32)
    sums = photo.sums[seen].astype(np.float32)
    colours = chain.colours[seen].astype(np.float32)
    _rows(sums, seen, chain.pixels[seen].astype(np.float32), colours, slopes.vertices, slopes.normals, rows)
    light = -np.sqrt(sums[:, 0])[:, None, None] * chain.light[seen].astype(np.float32)
    k = light.shape[2]
    mixed, own = np.empty((len(rows), 3 * k)), np.zeros((3 * k, 3 * k))
    for q in range(3):
        block = slice(k * q, k * (q + 1))
        mixed[:, block] = rows[:, q::5] @ light[:, q]
        own[block, block] = light[:, q].T @ light[:, q]
    return Normal((rows @ rows.T).astype(np.float64), mixed, own)


@njit(cache=True)
def _prepare(triangle, barycentric, nearest, pixels, depth, triangles, shares, usable):
    height, width = triangle.shape
    for y in range(1, height - 1):
        for x in range(1, width - 1):
            f = triangle[y, x]
            if f < 0:
                continue
            total = np.float32(0.0)
            for j in range(3):
                shares[y, x, j] = barycentric[y, x, j] * depth[triangles[f, j]]
                total += shares[y, x, j]
            for j in range(3):
                shares[y, x, j] /= total
            a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
            area = (pixels[b, 0] - pixels[a, 0]) * (pixels[c, 1] - pixels[a, 1])
            area -= (pixels[b, 1] - pixels[a, 1]) * (pixels[c, 0] - pixels[a, 0])
            # a skin seen from behind is the inside of a mouth
            if area >= 0.0:
                continue
            z = nearest[y, x]
            usable[y, x] = (
                abs(nearest[y, x - 1] - z) < _EDGE_JUMP_M
                and abs(nearest[y, x + 1] - z) < _EDGE_JUMP_M
                and abs(nearest[y - 1, x] - z) < _EDGE_JUMP_M
                and abs(nearest[y + 1, x] - z) < _EDGE_JUMP_M
            )


@njit(cache=True, fastmath=True)
def _gather(picture, slope_x, slope_y, triangle, shares, usable, triangles, colours, confidence, inverse_square, sums, totals):
    height, width = triangle.shape
    r = np.empty(3, np.float32)
    for y in range(height):
        for x in range(width):
            if not usable[y, x]:
                continue
            f = triangle[y, x]
            trust = np.float32(1.0)
            for j in range(3):
                trust = min(trust, confidence[triangles[f, j]])
            if trust <= 0.0:
                continue
            square = np.float32(0.0)
            for q in range(3):
                r[q] = picture[y, x, q]
                for j in range(3):
                    r[q] -= shares[y, x, j] * colours[triangles[f, j], q]
                square += r[q] * r[q]
            root = np.float32(1.0) / (np.float32(1.0) + square * inverse_square)
            w = trust * root * root
            totals[0] += trust * square * inverse_square * root
            totals[1] += trust
            totals[2] += w
            totals[3] += w * square
            xx = xy = yy = rx = ry = np.float32(0.0)
            for q in range(3):
                gx, gy = slope_x[y, x, q], slope_y[y, x, q]
                xx += gx * gx
                xy += gx * gy
                yy += gy * gy
                rx += r[q] * gx
                ry += r[q] * gy
            for j in range(3):
                own = w * shares[y, x, j]
                into = sums[triangles[f, j]]
                into[0] += own
                into[1] += own * xx
                into[2] += own * xy
                into[3] += own * yy
                for q in range(3):
                    into[4 + 2 * q] += own * slope_x[y, x, q]
                    into[5 + 2 * q] += own * slope_y[y, x, q]
                    into[12 + q] += own * r[q]
                into[10] += own * rx
                into[11] += own * ry
                into[15] += shares[y, x, j]


@njit(cache=True, fastmath=True)
def _rows(sums, seen, jacobian, colour_slopes, vertex_slopes, normal_slopes, rows):
    """Rows (p, 5 per vertex) whose squares make the lumped matrix.

    With W the weight and m_q the mean gradient of channel q: three rows sqrt(W) (m_q . du - h_q . dn), and two rows L^T du with
    L L^T the gradients' spread about their means, sum w g g^T - W sum_q m_q m_q^T.
    """
    k_seen = len(seen)
    factor = np.empty((k_seen, 9), np.float32)
    for k in range(k_seen):
        weight = sums[k, 0]
        root = np.sqrt(weight)
        xx, xy, yy = sums[k, 1], sums[k, 2], sums[k, 3]
        for q in range(3):
            mx, my = sums[k, 4 + 2 * q] / weight, sums[k, 5 + 2 * q] / weight
            factor[k, 2 * q], factor[k, 2 * q + 1] = root * mx, root * my
            xx -= weight * mx * mx
            xy -= weight * mx * my
            yy -= weight * my * my
        first = np.sqrt(max(xx, np.float32(0.0)))
        cross = xy / first if first > 0.0 else np.float32(0.0)
        factor[k, 6], factor[k, 7], factor[k, 8] = first, cross, np.sqrt(max(yy - cross * cross, np.float32(0.0)))
    for p in range(len(rows)):
        row = rows[p]
        for k in range(k_seen):
            v = seen[k]
            dx, dy, dz = vertex_slopes[p, v, 0], vertex_slopes[p, v, 1], vertex_slopes[p, v, 2]
            nx, ny, nz = normal_slopes[p, v, 0], normal_slopes[p, v, 1], normal_slopes[p, v, 2]
            across = jacobian[k, 0, 0] * dx + jacobian[k, 0, 1] * dy + jacobian[k, 0, 2] * dz
            down = jacobian[k, 1, 0] * dx + jacobian[k, 1, 1] * dy + jacobian[k, 1, 2] * dz
            root = np.sqrt(sums[k, 0])
            for q in range(3):
                shade = colour_slopes[k, q, 0] * nx + colour_slopes[k, q, 1] * ny + colour_slopes[k, q, 2] * nz
                row[5 * k + q] = factor[k, 2 * q] * across + factor[k, 2 * q + 1] * down - root * shade
            row[5 * k + 3] = factor[k, 6] * across + factor[k, 7] * down
            row[5 * k + 4] = factor[k, 8] * down
