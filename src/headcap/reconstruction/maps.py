"""Depth, normal and confidence of one view at cell resolution."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera


@dataclass(frozen=True)
class DepthMap:
    """What one view says about the surface; row and column are cells, whose camera is `camera`."""

    camera: Camera
    """Distortion-free camera whose pixels are the cells: integer pixel centres, so map[row, column] is its pixel."""
    depth: NDArray[np.float32]
    """(rows, columns) camera z in metres, 0 where nothing is known."""
    normal: NDArray[np.float32]
    """(rows, columns, 3) unit, camera frame, z < 0 (towards the camera)."""
    confidence: NDArray[np.float32]
    """(rows, columns) correlation with the sources, 0 to 1."""
    sigma: NDArray[np.float32]
    """(rows, columns) standard deviation of depth in metres, relative between cells."""
    colour: NDArray[np.uint8]
    """(rows, columns, 3) RGB."""
    chosen: NDArray[np.bool_]
    """(rows, columns) cells to make points of; the others only say where the surface is."""

    @property
    def name(self) -> str:
        """The camera's name."""
        return self.camera.name

    @property
    def known(self) -> NDArray[np.bool_]:
        """(rows, columns) true where there is a depth."""
        return self.depth > 0


def cell_camera(camera: Camera, cell_px: int) -> Camera:
    """The camera whose pixels are squares of `cell_px` pixels of `camera`; what is left over at the rim is cut off."""
    columns, rows = camera.width // cell_px, camera.height // cell_px
    matrix = camera.matrix.copy()
    matrix[:2, 2] -= 0.5 * (cell_px - 1)
    matrix[:2] /= cell_px
    return replace(camera, width=columns, height=rows, matrix=matrix)


def normals_from_slopes(matrix: NDArray, plane: NDArray, cell_px: int) -> NDArray[np.float32]:
    """Unit normals (rows, columns, 3) in the camera frame of planes (w, a, b) at cells; `matrix` is the pixels' K.

    A plane is 1 = m . K X with m = (a, b, w - a u - b v), so its normal is along K^T m.
    """
    rows, columns = plane.shape[:2]
    u = cell_px * np.arange(columns) + 0.5 * (cell_px - 1)
    v = (cell_px * np.arange(rows) + 0.5 * (cell_px - 1))[:, None]
    w, a, b = (plane[..., k].astype(np.float64) for k in range(3))
    normal = -np.stack([a, b, w - a * u - b * v], -1) @ matrix
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return (normal / np.where(length > 0, length, 1)).astype(np.float32)
