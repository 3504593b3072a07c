"""Cells at the rim of a surface, where matching windows straddle two depths and the nearer one grows outwards."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.reconstruction.maps import DepthMap
from headcap.reconstruction.windows import JIT

DOUBT = 5.0
"""Factor on the standard deviation of rim cells: they still vote, at 1/25 of the weight."""


def doubt_rims(depth_map: DepthMap, limit_cells: float) -> DepthMap:
    """The map with rim cells made no points of and given less weight; see `rim_cells`."""
    rim = rim_cells(depth_map.depth, depth_map.normal, depth_map.camera.matrix, limit_cells)
    sigma = np.where(rim, DOUBT * depth_map.sigma, depth_map.sigma).astype(np.float32)
    return replace(depth_map, sigma=sigma, chosen=depth_map.chosen & ~rim)


@njit(**JIT)
def rim_cells(depth, normal, matrix, limit_cells) -> NDArray[np.bool_]:
    """Known cells (rows, columns) with one of eight neighbours unknown or `limit_cells` cell widths off the cell's plane."""
    rows, columns = depth.shape
    rim = np.zeros((rows, columns), np.bool_)
    for row in range(rows):
        for column in range(columns):
            d = depth[row, column]
            if d <= 0.0:
                continue
            x, y = (column - matrix[0, 2]) / matrix[0, 0], (row - matrix[1, 2]) / matrix[1, 1]
            n0, n1, n2 = normal[row, column, 0], normal[row, column, 1], normal[row, column, 2]
            offset = (n0 * x + n1 * y + n2) * d
            limit = limit_cells * d / matrix[0, 0]
            for k in range(9):
                r, c = row + k // 3 - 1, column + k % 3 - 1
                if k == 4 or r < 0 or c < 0 or r >= rows or c >= columns:
                    continue
                slant = n0 * (c - matrix[0, 2]) / matrix[0, 0] + n1 * (r - matrix[1, 2]) / matrix[1, 1] + n2
                if depth[r, c] <= 0.0 or (slant < -0.05 and abs(depth[r, c] - offset / slant) > limit):
                    rim[row, column] = True
                    break
    return rim
