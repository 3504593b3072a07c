"""The studio: lights, the room behind and the shutter, which turn who stands there at a moment into linear light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.meshes.normals import vertex_normals
from headcap.synthetic.lighting import Lights, illuminate
from headcap.synthetic.render import Surface, render_surface
from headcap.synthetic.settings import SensorSettings
from headcap.synthetic.texture import Grain


@dataclass(frozen=True, eq=False)
class Sitter:
    """Whoever is photographed."""

    pose: Callable[[float], tuple[NDArray, Surface]]
    """Vertices (n, 3), metres, and the surface over them at a moment in seconds."""
    openness: NDArray[np.float64]
    """(n,) share of the sky each vertex sees."""
    occluder: NDArray[np.int32]
    """(k, 3) triangles over the same vertices that cast shadows."""
    grain: Grain


@dataclass(frozen=True, eq=False)
class Studio:
    """What pictures of one size have in common."""

    lights: Lights
    background: NDArray[np.float32]
    """(height, width, 3) linear RGB: the room, out of focus."""
    bands: tuple[tuple[tuple[int, int], float], ...]
    """Bands of rows and how long after the frame's time they are read out; one band for a global shutter."""

    @classmethod
    def of(cls, size: tuple[int, int], sensor: SensorSettings, lights: Lights) -> Studio:
        """For pictures of (width, height)."""
        return cls(lights, _background(size, sensor), tuple(_bands(size[1], sensor)))

    def photograph(self, camera: Camera, sitter: Sitter, time_s: float) -> NDArray[np.float32]:
        """Linear RGB (height, width, 3)."""
        parts = []
        for (first, last), later in self.bands:
            vertices, surface = sitter.pose(time_s + later)
            normals = vertex_normals(vertices, surface.triangles)
            light = illuminate(self.lights, vertices, normals, sitter.openness, sitter.occluder, camera.centre)
            behind = self.background[first:last]
            parts.append(render_surface(camera, vertices, surface, light, sitter.grain, behind, (first, last)))
        return np.concatenate(parts)


def _bands(height: int, sensor: SensorSettings) -> list[tuple[tuple[int, int], float]]:
    if sensor.rolling_shutter_s == 0:
        return [((0, height), 0.0)]
    edges = np.linspace(0, height, sensor.rolling_shutter_bands + 1).astype(int)
    middle = 0.5 * (edges[:-1] + edges[1:]) / height
    return [
        ((int(a), int(b)), float(m) * sensor.rolling_shutter_s) for a, b, m in zip(edges[:-1], edges[1:], middle, strict=True)
    ]


def _background(size: tuple[int, int], sensor: SensorSettings) -> NDArray[np.float32]:
    """A little brighter towards the floor."""
    width, height = size
    down = np.linspace(0.9, 1.1, height, dtype=np.float32)[:, None, None]
    return sensor.background * down * np.ones((1, width, 3), np.float32)
