"""A ball with a solid texture, ray-cast exactly into five cameras."""

from dataclasses import dataclass

import numpy as np
import pytest

from headcap.cameras import Camera, Rig

RADIUS_M = 0.1
DISTANCE_M = 0.8
FOCAL_PX = 800.0


@dataclass(frozen=True)
class Ball:
    rig: Rig
    images: list[np.ndarray]

    def depth(self, camera: Camera) -> np.ndarray:
        """True camera z (height, width) at the camera's pixels, NaN beside the ball."""
        rays = np.stack(
            [*np.meshgrid(np.arange(camera.width), np.arange(camera.height)), np.ones((camera.height, camera.width))], -1
        )
        return _hit(camera, rays @ np.linalg.inv(camera.matrix).T)[0]


def _hit(camera: Camera, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    directions = local @ camera.camera_from_world[:3, :3]
    a, b = (directions**2).sum(-1), directions @ camera.centre
    root = b * b - a * (camera.centre @ camera.centre - RADIUS_M**2)
    z = (-b - np.sqrt(np.where(root > 0, root, np.nan))) / a
    return z, camera.centre + z[..., None] * directions


def _texture(points: np.ndarray) -> np.ndarray:
    """Grey levels of a solid pattern with wavelengths of 5 to 40 mm, several pixels each (a pixel is 1 mm)."""
    rng = np.random.default_rng(7)
    waves = rng.normal(size=(24, 3))
    waves *= (2 * np.pi / np.geomspace(0.005, 0.04, 24) / np.linalg.norm(waves, axis=1))[:, None]
    return 128 + 14 * np.cos(points @ waves.T + rng.uniform(0, 6.3, 24)).sum(-1)


def look_at_centre(name: str, yaw_deg: float, pitch_deg: float, distortion=(0.0,) * 5) -> Camera:
    yaw, pitch = np.deg2rad([yaw_deg, pitch_deg])
    outward = np.array([np.sin(yaw) * np.cos(pitch), np.sin(pitch), np.cos(yaw) * np.cos(pitch)])
    forward = -outward
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = pose[:3, :3] @ (-DISTANCE_M * outward)
    matrix = np.array([[FOCAL_PX, 0, 99.5], [0, FOCAL_PX, 119.5], [0, 0, 1]])
    return Camera(name, 200, 240, matrix, np.array(distortion), pose)


def photograph(camera: Camera, rng: np.random.Generator) -> np.ndarray:
    """The ball on a flat ground, four rays per pixel, with two grey levels of noise."""
    shift = np.array([-0.25, 0.25])
    total = np.zeros((camera.height, camera.width))
    for du in shift:
        for dv in shift:
            pixels = np.stack(np.meshgrid(np.arange(camera.width) + du, np.arange(camera.height) + dv), -1)
            xy = camera.undistort_pixels(pixels.reshape(-1, 2)).reshape(pixels.shape)
            z, points = _hit(camera, np.concatenate([xy, np.ones((*xy.shape[:2], 1))], -1))
            total += np.where(np.isfinite(z), _texture(np.where(np.isfinite(points), points, 0)), 60.0) / 4
    noisy = total + rng.normal(0, 2, total.shape)
    return np.repeat(np.clip(np.rint(noisy), 0, 255).astype(np.uint8)[..., None], 3, 2)


@pytest.fixture(scope="session")
def ball() -> Ball:
    rng = np.random.default_rng(11)
    places = ((0, 0), (20, 5), (-20, -5), (4, 22), (-4, -22))
    rig = Rig(tuple(look_at_centre(f"c{k}", *place, (-0.08, 0.05, 3e-4, -2e-4, 0.0)) for k, place in enumerate(places)))
    return Ball(rig, [photograph(camera, rng) for camera in rig])
