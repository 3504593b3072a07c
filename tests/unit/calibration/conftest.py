"""A made-up rig and a board that is held still and moved by turns, with corners as a detector would report them."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from headcap.calibration.board import BoardSettings
from headcap.calibration.detection import CameraDetections
from headcap.cameras import Camera, Rig
from headcap.geometry.transforms import invert, rigid, transform
from headcap.sync.offsets import TimeOffsets

NOISE_PX = 0.05
RATE_HZ = 60.0
STEP_S = 0.2
"""A still tenth of a second, then a tenth of motion."""


@dataclass(frozen=True)
class Scene:
    rig: Rig
    board: BoardSettings
    detections: tuple[CameraDetections, ...]
    offsets: TimeOffsets
    """True start times."""


def make_rig(rng: np.random.Generator, count: int) -> Rig:
    cameras = []
    for i, azimuth in enumerate(np.linspace(-60, 60, count)):
        direction = Rotation.from_euler("YX", [azimuth, -15 * (-1) ** i], degrees=True).apply([0, 0, 1.0])
        z = -direction
        x = np.cross([0, -1.0, 0], z)
        x /= np.linalg.norm(x)
        rotation = Rotation.from_rotvec(rng.normal(0, 0.02, 3)).as_matrix() @ np.stack([x, np.cross(z, x), z])
        focal = 1500 + rng.normal(0, 30)
        matrix = np.array([[focal, 0, 269.5 + rng.normal(0, 4)], [0, focal, 479.5 + rng.normal(0, 4)], [0, 0, 1]])
        distortion = np.array([-0.08 + rng.normal(0, 0.01), 0.05, 5e-4, -5e-4, 0])
        cameras.append(Camera(f"cam{i:02d}", 540, 960, matrix, distortion, rigid(rotation, -rotation @ direction)))
    return Rig(tuple(cameras))


def board_motion(rng: np.random.Generator, steps: int):
    """world_from_board at any times: smooth moves between random poses about the origin, board facing the cameras."""
    turns = [Rotation.from_euler("xyz", np.r_[180, 0, 0] + rng.uniform(-38, 38, 3), degrees=True) for _ in range(steps + 1)]
    places = rng.uniform([-0.06, -0.1, -0.06], [0.06, 0.1, 0.06], (steps + 1, 3))

    def at(time_s: float) -> np.ndarray:
        k = min(int(time_s // STEP_S), steps - 1)
        u = np.clip((time_s - k * STEP_S - STEP_S / 2) / (STEP_S / 2), 0, 1)
        u = u**3 * (10 - 15 * u + 6 * u * u)  # least jerk
        turn = turns[k] * Rotation.from_rotvec(u * (turns[k].inv() * turns[k + 1]).as_rotvec())
        centre = np.array([0.0875, 0.1125, 0])
        return rigid(turn.as_matrix(), (1 - u) * places[k] + u * places[k + 1] - turn.as_matrix() @ centre)

    return at


def observe(rng, camera: Camera, board: BoardSettings, motion, start_s: float, frames: int, every: int) -> CameraDetections:
    """Corners inside the image, noise added, velocities as from neighbouring frames (NaN where it moves fast)."""
    found = []
    for frame in range(1, frames - 1):
        now, before, after = (
            camera.project(transform(motion(start_s + (frame + d) / RATE_HZ), board.corners))[0] for d in (0, -1, 1)
        )
        velocity = (after - before) * RATE_HZ / 2
        still = np.linalg.norm(after - before, axis=1).max() < 1 and np.linalg.norm(after + before - 2 * now, axis=1).max() < 0.1
        inside = ((now > 5) & (now < np.array(camera.size) - 6)).all(1)
        if inside.sum() >= 12 and (frame % every == 0 or (not still and frame % 4 == 1)):
            speed = velocity[inside] if still else np.full((inside.sum(), 2), np.nan)
            found.append((frame, np.flatnonzero(inside), now[inside] + rng.normal(0, NOISE_PX, (inside.sum(), 2)), speed))
    counts = [len(f[1]) for f in found]
    frame = np.array([f[0] for f in found])
    return CameraDetections(
        camera.name,
        *camera.size,
        frames // every,
        frame,
        frame / RATE_HZ,
        np.r_[0, np.cumsum(counts)],
        np.concatenate([f[1] for f in found]),
        np.concatenate([f[2] for f in found]),
        np.concatenate([f[3] for f in found]),
    )


@pytest.fixture(scope="session")
def scene() -> Scene:
    rng = np.random.default_rng(7)
    board = BoardSettings(dictionary="DICT_5X5_100", squares=(7, 9), square_size_mm=25, marker_size_mm=18)
    rig = make_rig(rng, 6)
    steps = 22
    motion = board_motion(rng, steps)
    start = rng.uniform(0, 0.1, len(rig))
    frames = int((steps * STEP_S - 0.1) * RATE_HZ)
    detections = tuple(observe(rng, c, board, motion, s, frames, 3) for c, s in zip(rig, start, strict=True))
    offsets = TimeOffsets("calibration", rig.names, tuple(start), (0.0,) * 6, (1.0,) * 6, ("clap",) * 6)
    # the true world is not the canonical one: nothing may depend on it
    return Scene(rig.transformed(invert(rigid(np.eye(3), [0.3, 0.2, 0.1]))), board, detections, offsets)
