"""Where several depth maps see one place, and which of them see it best."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.geometry.transforms import invert
from headcap.reconstruction.maps import DepthMap
from headcap.reconstruction.settings import ReconstructSettings
from headcap.reconstruction.windows import JIT

BASE_ANGLE_DEG = 20.0
"""Angle between two views at which a pixel of disparity is reckoned in metres; `choose_sources` prefers it."""


class MapStack:
    """All maps padded into arrays that a kernel can index by view."""

    def __init__(self, maps: list[DepthMap]) -> None:
        size = np.array([depth_map.depth.shape for depth_map in maps])
        rows, columns = size.max(0)
        n = len(maps)
        self.size = size
        self.depth = np.zeros((n, rows, columns), np.float32)
        self.normal = np.zeros((n, rows, columns, 3), np.float32)
        self.sigma = np.zeros((n, rows, columns), np.float32)
        self.confidence = np.zeros((n, rows, columns), np.float32)
        self.colour = np.zeros((n, rows, columns, 3), np.uint8)
        self.chosen = np.zeros((n, rows, columns), np.bool_)
        for k, m in enumerate(maps):
            block = (k, slice(0, size[k, 0]), slice(0, size[k, 1]))
            self.depth[block], self.normal[block], self.sigma[block] = m.depth, m.normal, m.sigma
            self.confidence[block], self.colour[block], self.chosen[block] = m.confidence, m.colour, m.chosen
        self.matrices = np.array([m.camera.matrix for m in maps])
        self.view_from_world = np.array([m.camera.camera_from_world for m in maps])
        self.world_from_view = invert(self.view_from_world)

    def arrays(self) -> tuple:
        """In the order that kernels take them."""
        return (
            self.size, self.depth, self.normal, self.sigma, self.confidence, self.colour, self.matrices,
            self.view_from_world, self.world_from_view,
        )  # fmt: skip


@njit(inline="always")
def surface_in_cell(view, row, column, depth, normal, matrices):
    """Where a cell's surface lies in its camera's frame, x, y, z, and the cosine at which it faces the camera."""
    matrix, d = matrices[view], depth[view, row, column]
    y = (row - matrix[1, 2]) / matrix[1, 1] * d
    x = ((column - matrix[0, 2]) * d - matrix[0, 1] * y) / matrix[0, 0]
    n0, n1, n2 = normal[view, row, column, 0], normal[view, row, column, 1], normal[view, row, column, 2]
    return x, y, d, -(n0 * x + n1 * y + n2 * d) / math.sqrt(x * x + y * y + d * d)


@njit(inline="always")
def carry(pose, x, y, z):
    """A point taken through a pose (4, 4)."""
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3],
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3],
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3],
    )


@njit(inline="always")
def turn(pose, x, y, z):
    """A direction turned by a pose (4, 4)."""
    return (
        pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z,
        pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z,
        pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z,
    )


@njit(**JIT)
def surface_beside(view, x, y, z, size, depth, normal, matrices, max_gap_px, min_facing):
    """Where the surface of `view` meets the ray through a point (x, y, z) of its frame.

    Returns (row, column, gap in z of the surface behind the point), row -1 where the view has nothing near.
    """
    if z <= 1e-6:
        return -1, -1, 0.0
    f = matrices[view, 0, 0]
    column = math.floor((f * x + matrices[view, 0, 1] * y) / z + matrices[view, 0, 2] + 0.5)
    row = math.floor(matrices[view, 1, 1] * y / z + matrices[view, 1, 2] + 0.5)
    if row < 0 or column < 0 or row >= size[view, 0] or column >= size[view, 1]:
        return -1, -1, 0.0
    d = depth[view, row, column]
    if d <= 0.0:
        return -1, -1, 0.0
    nx, ny, nz = normal[view, row, column, 0], normal[view, row, column, 1], normal[view, row, column, 2]
    px = (column - matrices[view, 0, 2] - matrices[view, 0, 1] * (row - matrices[view, 1, 2]) / matrices[view, 1, 1]) / f * d
    py = (row - matrices[view, 1, 2]) / matrices[view, 1, 1] * d
    slant = (nx * x + ny * y + nz * z) / z
    if -slant < min_facing * math.sqrt(x * x + y * y + z * z) / z:
        return -1, -1, 0.0
    gap = (nx * px + ny * py + nz * d) / slant - z
    if abs(gap) > max_gap_px * z / f:
        return -1, -1, 0.0
    return row, column, gap


def best_views(maps: list[DepthMap], settings: ReconstructSettings) -> list[NDArray[np.bool_]]:
    """Per map (rows, columns) true where fewer than `finest_views` other maps see the same place with more pixels.

    A view's pixels on a place are counted along one direction: focal length / depth * cosine of the viewing angle.
    """
    stack = MapStack(maps)
    # in the cells of these maps: the same disagreement in the level's own pixels
    gap_px = settings.fusion.max_disparity_px / (settings.matching.cell_px * math.tan(math.radians(BASE_ANGLE_DEG)))
    facing = math.cos(math.radians(settings.fusion.max_viewing_deg))
    return [
        _rank_view(
            view, stack.size, stack.depth, stack.normal, stack.matrices, stack.view_from_world, stack.world_from_view,
            settings.matching.finest_views, gap_px, facing,
        )
        for view in range(len(maps))
    ]  # fmt: skip


@njit(**JIT)
def _rank_view(view, size, depth, normal, matrices, view_from_world, world_from_view, finest_views, max_gap_px, min_facing):
    """`best_views` of one map."""
    rows, columns = size[view, 0], size[view, 1]
    best = np.zeros((rows, columns), np.bool_)
    for row in range(rows):
        for column in range(columns):
            if depth[view, row, column] <= 0.0:
                continue
            lx, ly, lz, facing = surface_in_cell(view, row, column, depth, normal, matrices)
            if facing < min_facing:
                continue
            mine = facing * matrices[view, 0, 0] / lz
            wx, wy, wz = carry(world_from_view[view], lx, ly, lz)
            better = 0
            for other in range(len(depth)):
                if other == view:
                    continue
                x, y, z = carry(view_from_world[other], wx, wy, wz)
                r, c, _ = surface_beside(other, x, y, z, size, depth, normal, matrices, max_gap_px, min_facing)
                if r < 0:
                    continue
                o0, o1, o2 = normal[other, r, c, 0], normal[other, r, c, 1], normal[other, r, c, 2]
                looks = -(o0 * x + o1 * y + o2 * z) / math.sqrt(x * x + y * y + z * z)
                better += looks * matrices[other, 0, 0] / z > mine
                if better >= finest_views:
                    break
            best[row, column] = better < finest_views
    return best
