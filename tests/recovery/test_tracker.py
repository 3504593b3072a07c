"""A patch of skin with a slit, photographed by four cameras that do not fire together, is tracked back to its truth."""

import numpy as np
import pytest

from headcap.cameras import Camera, Rig
from headcap.meshes.rasteriser import rasterise
from headcap.registration.anchors import Anchors
from headcap.registration.start import prepare_start
from headcap.registration.template import Template
from headcap.registration.track_settings import TrackSettings
from headcap.registration.tracker import track_anchors, track_chunk

RATE, FRAMES, COLUMNS, SIZE = 60.0, 6, 25, 0.06
SETTINGS = TrackSettings(
    coarse_width_px=100,
    texture_size_px=256,
    graph={"spacing_mm": 10, "fine_spacing_mm": 6},
    flow={"window_px": 11},
    lips={"reach_mm": 8},
)


def _patch() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, triangles, and 1 above / -1 below the slit."""
    axis = np.linspace(-SIZE / 2, SIZE / 2, COLUMNS)
    x, y = np.meshgrid(axis, axis)
    vertices = np.stack([x, y, 0.012 * np.cos(40 * x) * np.cos(30 * y)], -1).reshape(-1, 3)
    a = (np.arange(COLUMNS - 1)[:, None] * COLUMNS + np.arange(COLUMNS - 1)).ravel()
    triangles = np.concatenate([np.stack([a, a + 1, a + COLUMNS + 1], 1), np.stack([a, a + COLUMNS + 1, a + COLUMNS], 1)])
    cut = (COLUMNS // 2) * COLUMNS + np.arange(7, COLUMNS - 7)
    lookup = np.arange(len(vertices))
    lookup[cut] = len(vertices) + np.arange(len(cut))
    above = vertices[triangles].mean(1)[:, 1] > 0
    triangles = np.where(above[:, None], lookup[triangles], triangles).astype(np.int32)
    side = np.sign(vertices[:, 1])
    side[cut] = -1
    return np.concatenate([vertices, vertices[cut]]), triangles, np.concatenate([side, np.ones(len(cut))])


REST, TRIANGLES, SIDE = _patch()
UV = (REST[:, :2] + SIZE / 2) / SIZE


def moved(time_s: float) -> np.ndarray:
    """The truth: it drifts sideways, turns and opens its slit."""
    opening = 0.003 * (time_s * RATE / FRAMES) ** 2
    bump = np.exp(-((REST[:, 0] / 0.012) ** 2) - (REST[:, 1] / 0.015) ** 2) * (np.abs(REST[:, 0]) < 0.016)
    angle = 1.5 * time_s
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    return (REST + SIDE[:, None] * [0, 1, 0] * (0.5 * opening * bump)[:, None]) @ turn.T + time_s * np.array([0.05, 0.02, 0])


def _rig() -> Rig:
    cameras = []
    for c, (x, y) in enumerate([(-0.2, 0.08), (-0.07, -0.1), (0.08, 0.1), (0.2, -0.06)]):
        z = np.array([-x, -y, -0.35])
        z /= np.linalg.norm(z)
        right = np.cross(z, [0, 1, 0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(z, right), z])
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation, -rotation @ [x, y, 0.35]
        matrix = np.array([[800.0, 0, 99.5], [0, 800, 99.5], [0, 0, 1]])
        cameras.append(Camera(f"cam{c}", 200, 200, matrix, np.array([-0.05, 0.02, 0, 0, 0]), pose))
    return Rig(tuple(cameras))


class Frames:
    """Renders what each camera saw at its own moments."""

    delays_s = (0.0, 0.45 / RATE, -0.4 / RATE, 0.2 / RATE)

    def __init__(self, rig: Rig) -> None:
        self.rig, self.cameras = rig, rig.names
        rng = np.random.default_rng(3)
        self.waves = rng.normal(0, 900, (60, 2)), rng.uniform(0, 6.3, 60), rng.normal(0, 9, 60)
        self.cache: dict[tuple[str, int], np.ndarray] = {}

    def nearest(self, camera: str, time_s: float) -> tuple[np.ndarray, float]:
        c = self.cameras.index(camera)
        k = round((time_s - self.delays_s[c]) * RATE)
        taken = k / RATE + self.delays_s[c]
        if (camera, k) not in self.cache:
            self.cache[camera, k] = self._picture(c, taken if k > 0 else 0.0, k)
        return self.cache[camera, k], taken

    def _picture(self, c: int, time_s: float, k: int) -> np.ndarray:
        raster = rasterise(self.rig[c], moved(time_s), TRIANGLES)
        material = np.nan_to_num(raster.interpolate(TRIANGLES, REST[:, :2]))
        frequency, phase, height = self.waves
        grey = 130 + (np.sin(material @ frequency.T + phase) * height).sum(-1)
        noise = np.random.default_rng([c, k]).normal(0, 1.5, grey.shape)
        picture = np.where(raster.hit, (0.85 + 0.1 * c) * grey, 40) + noise
        return np.repeat(np.clip(np.rint(picture), 0, 255).astype(np.uint8)[..., None], 3, axis=2)


@pytest.fixture(scope="module")
def scene():
    rig = _rig()
    frames = Frames(rig)
    near = (np.abs(REST[:, 0]) < 0.02) & (np.abs(REST[:, 1]) < 0.008)
    lips = {"lips_upper": near & (SIDE > 0), "lips_lower": near & (SIDE < 0)}
    template = Template(REST, TRIANGLES, UV, TRIANGLES, regions=lips)
    images = [frames.nearest(camera.name, 0.0)[0] for camera in rig]
    start = prepare_start(template, rig, images, None, SETTINGS)
    timeline = np.arange(FRAMES) / RATE
    return rig, frames, start, timeline, track_anchors(start, rig, frames, None, timeline, SETTINGS)


def _inside() -> np.ndarray:
    return (np.abs(REST[:, :2]) < SIZE / 2 - 0.004).all(1)


def test_texture_is_baked_where_cameras_see(scene):
    start = scene[2]
    assert start.texture_known.mean() > 0.95
    assert start.texture[start.texture_known].std() > 15


def test_tracked_vertices_are_where_the_material_went(scene):
    rig, frames, start, timeline, anchors = scene
    positions, figures = track_chunk(start, anchors, rig, frames, None, 0, FRAMES - 1, SETTINGS)
    assert len(figures["last_step_mm"]) == FRAMES
    errors = np.stack([np.linalg.norm(p - moved(t), axis=1) for p, t in zip(positions, timeline, strict=True)])[:, _inside()]
    # a pixel is 0.45 mm on the skin: 0.2 px in the middle of the distribution, a pixel in its tail
    assert np.median(errors) < 0.09e-3
    assert np.percentile(errors, 95) < 0.45e-3
    middle = [np.flatnonzero((np.abs(REST[:, 0]) < 1e-6) & (np.abs(REST[:, 1]) < 1e-6) & (side == SIDE))[0] for side in (1, -1)]
    gap = np.linalg.norm(positions[-1][middle[0]] - positions[-1][middle[1]])
    truth = np.linalg.norm(moved(timeline[-1])[middle[0]] - moved(timeline[-1])[middle[1]])
    assert truth > 1.5e-3
    assert abs(gap - truth) < 0.5e-3


def test_chunks_meet_without_a_seam(scene, tmp_path):
    rig, frames, start, _, anchors = scene
    anchors.save(tmp_path / "anchors.npz")
    part = Anchors.load(tmp_path / "anchors.npz", 3, 3)
    assert part.first == 1
    assert len(part) == 5
    whole = track_chunk(start, anchors, rig, frames, None, 3, 3, SETTINGS)[0]
    assert np.array_equal(whole, track_chunk(start, part, rig, frames, None, 3, 3, SETTINGS)[0])
