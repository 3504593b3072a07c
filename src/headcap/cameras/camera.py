"""One pinhole camera with Brown-Conrady distortion, and a rig of them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.cameras.projection import project_points, project_points_with_jacobian
from headcap.geometry.transforms import invert

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """A calibrated camera: intrinsics in pixels, pose as camera_from_world."""

    name: str
    width: int
    height: int
    matrix: Array
    """(3, 3) K, integer pixel centres."""
    distortion: Array
    """(5,) OpenCV k1, k2, p1, p2, k3."""
    camera_from_world: Array
    """(4, 4), metres."""

    def __post_init__(self) -> None:
        for field, shape in (("matrix", (3, 3)), ("distortion", (5,)), ("camera_from_world", (4, 4))):
            value = np.ascontiguousarray(getattr(self, field), dtype=np.float64)
            if value.shape != shape or not np.isfinite(value).all():
                raise ValueError(f"camera {self.name}: {field} must be finite {shape}, got {value.shape}")
            value.setflags(write=False)
            object.__setattr__(self, field, value)
        if self.matrix[0, 1] != 0.0:
            raise ValueError(f"camera {self.name}: skew {self.matrix[0, 1]} is not modelled; expected matrix[0, 1] = 0")

    @cached_property
    def centre(self) -> Array:
        """(3,) camera centre in the world, metres."""
        return invert(self.camera_from_world)[:3, 3]

    @property
    def axis(self) -> Array:
        """(3,) unit viewing direction in the world."""
        return self.camera_from_world[2, :3]

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.width, self.height

    def project(self, points_world: Array) -> tuple[Array, Array]:
        """Project (..., 3) world points to pixels (..., 2) and depths z (...), with distortion.

        Points at or behind the camera plane come back as NaN pixels.
        """
        points = np.ascontiguousarray(points_world, np.float64)
        pixels, depth = np.empty((points.size // 3, 2)), np.empty(points.size // 3)
        project_points(points.reshape(-1, 3), self.camera_from_world, self.matrix, self.distortion, pixels, depth)
        return pixels.reshape(*points.shape[:-1], 2), depth.reshape(points.shape[:-1])

    def pixels_from_normalised(self, xy: Array) -> Array:
        """Ideal image plane coordinates (..., 2) to distorted pixels (..., 2)."""
        x, y = xy[..., 0], xy[..., 1]
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        k = self.matrix
        return np.stack([k[0, 0] * xd + k[0, 2], k[1, 1] * yd + k[1, 2]], axis=-1)

    def project_with_jacobian(self, points_world: Array) -> tuple[Array, Array]:
        """Pixels (n, 2) and their derivative (n, 2, 3) with respect to the world points (n, 3)."""
        points = np.ascontiguousarray(points_world, np.float64)
        pixels, jacobian = np.empty((len(points), 2)), np.empty((len(points), 2, 3))
        project_points_with_jacobian(points, self.camera_from_world, self.matrix, self.distortion, pixels, jacobian)
        return pixels, jacobian

    def undistort_pixels(self, pixels: Array) -> Array:
        """Distorted pixels (n, 2) to ideal image plane coordinates (n, 2)."""
        pixels = np.asarray(pixels, float).reshape(-1, 1, 2)
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-12)
        return cv2.undistortPoints(pixels, self.matrix, self.distortion, criteria=criteria).reshape(-1, 2)

    def rays(self, pixels: Array) -> Array:
        """Unit viewing directions (n, 3) in the world for distorted pixels (n, 2)."""
        xy = self.undistort_pixels(pixels)
        local = np.hstack([xy, np.ones((len(xy), 1))])
        world = local @ self.camera_from_world[:3, :3]
        return world / np.linalg.norm(world, axis=1, keepdims=True)

    def moved(self, camera_from_world: Array) -> Camera:
        """The same lens at another pose."""
        return replace(self, camera_from_world=camera_from_world)

    def scaled(self, factor: float) -> Camera:
        """The camera of the image resized by `factor` (cv2.resize's pixel mapping)."""
        matrix = self.matrix.copy()
        matrix[:2] *= factor
        matrix[:2, 2] += 0.5 * factor - 0.5
        return replace(self, width=round(self.width * factor), height=round(self.height * factor), matrix=matrix)


@dataclass(frozen=True)
class Rig:
    """Calibrated cameras in one world frame, in the session's order."""

    cameras: tuple[Camera, ...]

    def __post_init__(self) -> None:
        names = [camera.name for camera in self.cameras]
        if len(set(names)) != len(names):
            raise ValueError(f"camera names must differ, got {names}")

    def __len__(self) -> int:
        return len(self.cameras)

    def __iter__(self):
        return iter(self.cameras)

    def __getitem__(self, name_or_index: str | int) -> Camera:
        if isinstance(name_or_index, str):
            return self.cameras[self.names.index(name_or_index)]
        return self.cameras[name_or_index]

    @property
    def names(self) -> tuple[str, ...]:
        """Names in the rig's order."""
        return tuple(camera.name for camera in self.cameras)

    @cached_property
    def centres(self) -> Array:
        """(n_cameras, 3) in the world, metres."""
        return np.array([camera.centre for camera in self.cameras])

    def only(self, names: Iterable[str]) -> Rig:
        """The named cameras, in the order given."""
        return Rig(tuple(self[name] for name in names))

    def transformed(self, new_from_world: Array) -> Rig:
        """The rig expressed in another world frame."""
        world_from_new = invert(new_from_world)
        return Rig(tuple(camera.moved(camera.camera_from_world @ world_from_new) for camera in self.cameras))

    def to_json(self) -> dict:
        """Plain JSON form; `from_json` is its inverse."""
        return {
            "convention": "integer pixel (0, 0) is the centre of the top-left pixel; x right, y down, z forward; metres",
            "cameras": [
                {
                    "name": camera.name,
                    "width": camera.width,
                    "height": camera.height,
                    "matrix": camera.matrix.tolist(),
                    "distortion": camera.distortion.tolist(),
                    "camera_from_world": camera.camera_from_world.tolist(),
                }
                for camera in self.cameras
            ],
        }

    @classmethod
    def from_json(cls, document: dict) -> Rig:
        """Read what `to_json` made."""
        fields = ("name", "width", "height", "matrix", "distortion", "camera_from_world")
        return cls(tuple(Camera(**{field: camera[field] for field in fields}) for camera in document["cameras"]))
