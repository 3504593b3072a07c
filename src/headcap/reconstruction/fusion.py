"""Depth maps of several views to one point cloud: agreement, weighted means, thinning, outliers."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.reconstruction.maps import DepthMap
from headcap.reconstruction.points import PointCloud
from headcap.reconstruction.rims import doubt_rims
from headcap.reconstruction.settings import FusionSettings
from headcap.reconstruction.visibility import BASE_ANGLE_DEG, MapStack, carry, surface_beside, surface_in_cell, turn
from headcap.reconstruction.windows import JIT

TOTAL, MOVED, NORMAL, TRUST, COLOUR, LIGHT, SUMS = 0, 1, 2, 5, 6, 9, 10
"""Where the sums over agreeing views lie in one array; normal and colour take three places."""
SHEET_SHARE = 0.2
"""Half the thickness of the sheet along a point's tangent plane in which its neighbours lie, as a share of the reach: skin
bends away by reach^2 / (2 radius), which is less for every radius above 2.5 times the reach (lips and nostrils)."""


def fuse(maps: list[DepthMap], *, time_s: float, settings: FusionSettings, cell_px: int = 2) -> PointCloud:
    """Fuse depth maps (any number, any sizes) into points where at least `min_views` views agree.

    Every known cell is carried along its normal to the weighted mean of the surfaces that the agreeing views saw there
    (weights: inverse variances along the normal); of the results, the surest are kept at a least distance from each other.
    """
    if settings.rim_cells > 0:
        maps = [doubt_rims(depth_map, settings.rim_cells) for depth_map in maps]
    stacked = MapStack(maps)
    tangents = math.tan(math.radians(BASE_ANGLE_DEG))
    parts = [
        _fuse_view(
            index, stacked.chosen, *stacked.arrays(), settings.min_views, settings.max_disparity_px / (cell_px * tangents),
            math.cos(math.radians(settings.max_normal_deg)), math.cos(math.radians(settings.max_viewing_deg)),
        )
        for index in range(len(maps))
    ]  # fmt: skip
    positions, normals, sigma, confidence, colours = (np.concatenate(column) for column in zip(*parts, strict=True))
    if settings.box_m is not None:
        inside = ((positions >= settings.box_m[0]) & (positions <= settings.box_m[1])).all(1)
        positions, normals, sigma, confidence, colours = (
            array[inside] for array in (positions, normals, sigma, confidence, colours)
        )
    footprint = _median_footprint(maps, cell_px)
    kept, spacing = _thin_to(positions, sigma, settings.spacing_px * footprint, settings.max_points)
    positions, normals, confidence, colours = (array[kept] for array in (positions, normals, confidence, colours))
    if settings.outlier_neighbours and len(positions) and spacing > 0:
        # where many points made the spacing grow, the reach grows with it
        reach = settings.outlier_reach_px / settings.spacing_px * spacing
        beside = count_neighbours(positions.astype(np.float64), normals.astype(np.float64), reach, SHEET_SHARE * reach)
        crowded = beside >= settings.outlier_neighbours
        positions, normals, confidence, colours = (array[crowded] for array in (positions, normals, confidence, colours))
    return PointCloud(positions.astype(np.float32), normals, confidence, colours, time_s)


def _median_footprint(maps: list[DepthMap], cell_px: int) -> float:
    """Width of a pixel on the surface, metres, median over views."""
    widths = [
        np.median(depth_map.depth[depth_map.known]) / (cell_px * depth_map.camera.matrix[0, 0])
        for depth_map in maps
        if depth_map.known.any()
    ]
    return float(np.median(widths)) if widths else 0.0


@njit(**JIT)
def _fuse_view(
    view, chosen, size, depth, normal, sigma, confidence, colour, matrices, view_from_world, world_from_view, min_views,
    max_gap_px, min_normal_dot, min_facing,
):  # fmt: skip
    """Fused points of one view's cells: positions, normals, sigma, confidence, colours."""
    rows, columns = size[view, 0], size[view, 1]
    most = chosen[view].sum()
    positions, normals = np.empty((most, 3)), np.empty((most, 3), np.float32)
    sigmas, trusts, colours = np.empty(most, np.float32), np.empty(most, np.float32), np.empty((most, 3), np.uint8)
    sums = np.empty(SUMS)
    found = 0
    out = world_from_view[view]
    for row in range(rows):
        for column in range(columns):
            if depth[view, row, column] <= 0.0 or not chosen[view, row, column]:
                continue
            lx, ly, lz, facing = surface_in_cell(view, row, column, depth, normal, matrices)
            if facing < min_facing:
                continue
            n0, n1, n2 = normal[view, row, column, 0], normal[view, row, column, 1], normal[view, row, column, 2]
            wx, wy, wz = carry(out, lx, ly, lz)
            nx, ny, nz = turn(out, n0, n1, n2)
            sums[:] = 0.0
            weight = 1.0 / max((sigma[view, row, column] * n2) ** 2, 1e-14)
            _add_vote(sums, weight, 0.0, nx, ny, nz, confidence[view, row, column], facing, colour[view, row, column])
            agreeing = 1 + _add_other_views(
                sums, view, wx, wy, wz, nx, ny, nz, size, depth, normal, sigma, confidence, colour, matrices, view_from_world,
                max_gap_px, min_normal_dot, min_facing,
            )  # fmt: skip
            if agreeing < min_views:
                continue
            total, shift = sums[TOTAL], sums[MOVED] / sums[TOTAL]
            positions[found, 0], positions[found, 1], positions[found, 2] = wx + shift * nx, wy + shift * ny, wz + shift * nz
            mx, my, mz = sums[NORMAL], sums[NORMAL + 1], sums[NORMAL + 2]
            length = math.sqrt(mx * mx + my * my + mz * mz)
            normals[found, 0], normals[found, 1], normals[found, 2] = mx / length, my / length, mz / length
            sigmas[found] = 1.0 / math.sqrt(total)
            trusts[found] = sums[TRUST] / total
            for band in range(3):
                colours[found, band] = int(sums[COLOUR + band] / sums[LIGHT] + 0.5)
            found += 1
    return positions[:found], normals[:found], sigmas[:found], trusts[:found], colours[:found]


@njit(inline="always")
def _add_vote(sums, weight, moved, nx, ny, nz, confidence, facing, colour):
    """Add what one view says of a place: weight, distance along the normal, normal, confidence; colour by how it faces it."""
    sums[TOTAL] += weight
    sums[MOVED] += weight * moved
    sums[NORMAL] += weight * nx
    sums[NORMAL + 1] += weight * ny
    sums[NORMAL + 2] += weight * nz
    sums[TRUST] += weight * confidence
    sums[LIGHT] += facing
    for band in range(3):
        sums[COLOUR + band] += facing * colour[band]


@njit(inline="always")
def _add_other_views(
    sums, view, wx, wy, wz, nx, ny, nz, size, depth, normal, sigma, confidence, colour, matrices, view_from_world, max_gap_px,
    min_normal_dot, min_facing,
):  # fmt: skip
    """Add the votes of all other views whose surface agrees with a point and its normal in the world; returns their number."""
    agreeing = 0
    for other in range(len(depth)):
        if other == view:
            continue
        to = view_from_world[other]
        x, y, z = carry(to, wx, wy, wz)
        r, c, gap = surface_beside(other, x, y, z, size, depth, normal, matrices, max_gap_px, min_facing)
        if r < 0:
            continue
        o0, o1, o2 = normal[other, r, c, 0], normal[other, r, c, 1], normal[other, r, c, 2]
        ox, oy, oz = turn(to.T, o0, o1, o2)
        if ox * nx + oy * ny + oz * nz < min_normal_dot:
            continue
        agreeing += 1
        # a gap along the other view's ray is a distance along its normal of gap * (ray . normal)
        slant = (o0 * x + o1 * y + o2 * z) / z
        weight = 1.0 / max((sigma[other, r, c] * o2) ** 2, 1e-14)
        looks = -slant * z / math.sqrt(x * x + y * y + z * z)
        _add_vote(sums, weight, gap * slant, ox, oy, oz, confidence[other, r, c], looks, colour[other, r, c])
    return agreeing


def _thin_to(positions: NDArray, sigma: NDArray, spacing: float, most: int) -> tuple[NDArray, float]:
    """Indices of points at least `spacing` apart, surest first; spacing grows by 8 % until at most `most` are left."""
    order = np.argsort(sigma, kind="stable")
    if spacing <= 0:
        return order[:most], 0.0
    while True:
        kept = thin(positions, order, spacing)
        if len(kept) <= most:
            return kept, spacing
        spacing *= max(1.02, math.sqrt(len(kept) / most))


@njit(**JIT)
def _cell_key(x, y, z):
    """A hash of integer cell coordinates (Teschner et al. 2003)."""
    return ((x * np.int64(73856093)) ^ (y * np.int64(19349663)) ^ (z * np.int64(83492791))) & np.int64(0x7FFFFFFF)


@njit(**JIT)
def thin(positions, order, spacing):
    """Indices of `positions` (n, 3), visited in `order`, that keep at least `spacing` from all kept before."""
    n = len(order)
    buckets = 1
    while buckets < 2 * n + 2:
        buckets *= 2
    head, after = np.full(buckets, -1, np.int64), np.full(n, -1, np.int64)
    kept = np.empty(n, np.int64)
    count = 0
    inverse, near2 = 1.0 / spacing, spacing * spacing
    for k in range(n):
        p = positions[order[k]]
        x, y, z = math.floor(p[0] * inverse), math.floor(p[1] * inverse), math.floor(p[2] * inverse)
        free = True
        for cell in range(27):
            key = _cell_key(x + cell % 3 - 1, y + (cell // 3) % 3 - 1, z + cell // 9 - 1) & (buckets - 1)
            at = head[key]
            while at >= 0:
                q = positions[kept[at]]
                if (p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2 < near2:
                    free = False
                    break
                at = after[at]
            if not free:
                break
        if free:
            key = _cell_key(x, y, z) & (buckets - 1)
            kept[count] = order[k]
            after[count] = head[key]
            head[key] = count
            count += 1
    return kept[:count]


@njit(**JIT)
def count_neighbours(positions, normals, radius, thickness):
    """Number of other points within `radius` of each of `positions` (n, 3), at most `thickness` off its tangent plane."""
    n = len(positions)
    buckets = 1
    while buckets < 2 * n + 2:
        buckets *= 2
    head, after = np.full(buckets, -1, np.int64), np.full(n, -1, np.int64)
    cells = np.empty((n, 3), np.int64)
    inverse, near2 = 1.0 / radius, radius * radius
    for k in range(n):
        for axis in range(3):
            cells[k, axis] = math.floor(positions[k, axis] * inverse)
        key = _cell_key(cells[k, 0], cells[k, 1], cells[k, 2]) & (buckets - 1)
        after[k] = head[key]
        head[key] = k
    counts = np.zeros(n, np.int64)
    seen = np.empty(27, np.int64)
    for k in range(n):
        visited = 0
        for cell in range(27):
            key = _cell_key(cells[k, 0] + cell % 3 - 1, cells[k, 1] + (cell // 3) % 3 - 1, cells[k, 2] + cell // 9 - 1) & (
                buckets - 1
            )
            again = False
            for before in range(visited):
                again |= seen[before] == key
            if again:
                continue
            seen[visited] = key
            visited += 1
            at = head[key]
            while at >= 0:
                if at != k:
                    d, off = 0.0, 0.0
                    for axis in range(3):
                        step = positions[at, axis] - positions[k, axis]
                        d += step * step
                        off += step * normals[k, axis]
                    counts[k] += (d < near2) & (abs(off) <= thickness)
                at = after[at]
    return counts
