"""A small true world: a wavy sheet before five cameras, in the layout of a truth folder."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from headcap.cameras import Camera, Rig
from headcap.geometry.transforms import rigid
from headcap.registration import MeshSequence, Template
from headcap.registration.sequence import save_chunk

RATE_HZ = 60.0


def sheet(n: int = 41, side_m: float = 0.2) -> tuple[np.ndarray, np.ndarray]:
    """A flat grid facing +z: vertices (n * n, 3), triangles counter-clockwise seen from +z."""
    axis = np.linspace(-side_m / 2, side_m / 2, n)
    x, y = np.meshgrid(axis, axis)
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(n * n)], axis=1)
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel(), index[1:, :-1].ravel()
    return vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)


def frontal_rig() -> Rig:
    """Five cameras half a metre off, all looking at the origin, image y down."""
    cameras = []
    for i, (x, y) in enumerate([(0.0, 0.0), (0.2, 0.05), (-0.2, 0.05), (0.1, -0.15), (-0.1, -0.15)]):
        centre = np.array([x, y, 0.5])
        z = -centre / np.linalg.norm(centre)
        right = np.cross(z, [0.0, 1.0, 0.0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(z, right), z])
        matrix = np.array([[800.0, 0, 200], [0, 800, 200], [0, 0, 1]])
        cameras.append(Camera(f"cam{i:02d}", 401, 401, matrix, np.zeros(5), rigid(rotation, -rotation @ centre)))
    return Rig(tuple(cameras))


@dataclass(frozen=True)
class World:
    """What a test writes to disk and compares with."""

    folder: Path
    triangles: np.ndarray
    motion: Callable[[float], np.ndarray]
    time_s: np.ndarray
    rig: Rig
    start_s: tuple[float, ...]

    def template(self, regions: dict[str, np.ndarray] | None = None) -> Template:
        uv = np.zeros((1, 2))
        return Template(self.motion(self.time_s[0]), self.triangles, uv, np.zeros_like(self.triangles), regions or {})

    def sequence(self, positions: np.ndarray, folder: Path) -> MeshSequence:
        save_chunk(folder / "chunk_000.npy", positions)
        return MeshSequence("take", self.time_s, (folder / "chunk_000.npy",))


def write_truth(folder: Path, motion: Callable[[float], np.ndarray], triangles: np.ndarray, frames: int, lips: tuple) -> World:
    """Write a truth folder of one take and return what it holds."""
    folder.mkdir(parents=True)
    rig, time_s = frontal_rig(), 0.05 + np.arange(frames) / RATE_HZ
    start_s = (0.01, 0.05, 0.02, 0.03, 0.04)
    cameras = [
        {
            "K": camera.matrix.tolist(),
            "dist": camera.distortion.tolist(),
            "R": camera.camera_from_world[:3, :3].tolist(),
            "t": camera.camera_from_world[:3, 3].tolist(),
        }
        for camera in rig
    ]
    document = {"fps": RATE_HZ, "width": 401, "height": 401, "cameras": cameras}
    (folder / "rig.json").write_text(json.dumps(document | {"takes": {"take": {"first_frame_time_s": start_s}}}))
    first = motion(time_s[0]).astype(np.float32)
    offsets = np.stack([np.rint((motion(t) - first) / 4e-6).astype(np.int16) for t in time_s])
    np.savez(folder / "take.npz", vertices_mm_i16=offsets, first_m=first, time_s=time_s, reference_camera=1)
    np.savez(folder / "topology.npz", faces=triangles, inner_lip_upper=[lips[0]] * 3, inner_lip_lower=[lips[1]] * 3)
    placed = {"R": np.eye(3).tolist(), "scale": 1000.0, "t": [1.0, 2.0, 3.0]}
    (folder / "scan.json").write_text(json.dumps({"scan_from_world": placed}))
    return World(folder, triangles, motion, time_s, rig, start_s)


@pytest.fixture
def still_world(tmp_path: Path) -> World:
    """A flat sheet that rests."""
    vertices, triangles = sheet()
    return write_truth(tmp_path / "truth", lambda _: vertices, triangles, 4, (10 * 41 + 20, 30 * 41 + 20))


@pytest.fixture
def moving_world(tmp_path: Path) -> World:
    """A wavy sheet that swings by 10 mm three times a second."""
    vertices, triangles = sheet()
    waves = vertices + [0, 0, 1] * (0.004 * np.sin(60 * vertices[:, :1]) * np.cos(50 * vertices[:, 1:2]))

    def motion(time_s: float) -> np.ndarray:
        return waves + 0.01 * np.sin(2 * np.pi * 3 * time_s) * np.array([1.0, 0.5, 0.3])

    return write_truth(tmp_path / "truth", motion, triangles, 12, (10 * 41 + 20, 30 * 41 + 20))
