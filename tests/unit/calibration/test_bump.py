"""A camera that moved after calibration is found and named, and no other; exchanged files are told apart."""

import cv2
import numpy as np
import pytest

from headcap.calibration.bump import find_bumped, resect
from headcap.calibration.settings import BumpSettings
from headcap.cameras import Camera, Rig
from headcap.errors import InputError
from headcap.geometry.transforms import from_vector, invert, rigid

SIZE = 480
FOCAL = 900.0
SETTINGS = BumpSettings(features=1200)


def make_rig() -> Rig:
    cameras = []
    for i in range(5):
        angle = np.radians(-36 + 18 * i)
        centre = np.array([np.sin(angle), 0.12 * (-1) ** i, np.cos(angle)])
        z = -centre / np.linalg.norm(centre)
        x = np.cross([0, -1.0, 0], z)
        x /= np.linalg.norm(x)
        rotation = np.stack([x, np.cross(z, x), z])
        matrix = np.array([[FOCAL, 0, SIZE / 2], [0, FOCAL, SIZE / 2], [0, 0, 1]])
        distortion = np.array([-0.08, 0.04, 0, 0, 0])
        cameras.append(Camera(f"cam{i}", SIZE, SIZE, matrix, distortion, rigid(rotation, -rotation @ centre)))
    return Rig(tuple(cameras))


def render(camera: Camera, texture: np.ndarray) -> np.ndarray:
    """A textured cylinder of 0.15 m radius about the y axis, seen by ray casting."""
    v, u = np.mgrid[0:SIZE, 0:SIZE]
    rays = camera.rays(np.stack([u.ravel(), v.ravel()], -1).astype(float))
    c = camera.centre
    a = rays[:, 0] ** 2 + rays[:, 2] ** 2
    b = c[0] * rays[:, 0] + c[2] * rays[:, 2]
    root = b * b - a * (c[0] ** 2 + c[2] ** 2 - 0.15**2)
    hit = root > 0
    t = (-b - np.sqrt(np.where(hit, root, 0))) / a
    point = c + t[:, None] * rays
    x = (np.arctan2(point[:, 0], point[:, 2]) / np.pi + 1) / 2 * texture.shape[1]
    y = (point[:, 1] / 0.6 + 0.5) * texture.shape[0]
    image = cv2.remap(
        texture, x.reshape(SIZE, SIZE).astype(np.float32), y.reshape(SIZE, SIZE).astype(np.float32), cv2.INTER_LINEAR
    )
    return np.where(hit.reshape(SIZE, SIZE), image, 60).astype(np.uint8)


@pytest.fixture(scope="module")
def scene():
    rng = np.random.default_rng(3)
    noise = rng.normal(0, 1, (640, 1024)).astype(np.float32)
    texture = cv2.GaussianBlur(noise, (0, 0), 2) * 4 + cv2.GaussianBlur(noise, (0, 0), 6) * 8
    texture = np.clip(128 + 60 * texture, 0, 255).astype(np.uint8)
    rig = make_rig()
    return rig, [render(camera, texture) for camera in rig], texture


def test_nobody_is_blamed_without_reason(scene):
    rig, images, _ = scene
    report = find_bumped(rig, images, SETTINGS)
    assert report.bumped == ()
    assert all(check.residual_px < 0.8 for check in report.cameras)  # SIFT places its points to half a pixel and better
    report.require_unmoved("take_01")


@pytest.mark.parametrize("camera", [0, 2])
def test_a_bumped_camera_is_named_and_placed_anew(scene, camera):
    rig, images, texture = scene
    # a third of a degree and two millimetres: some five pixels
    turn = from_vector(np.r_[0.004, 0.003, 0.003, 0.002, 0, 0])
    moved = rig[camera].moved(turn @ rig[camera].camera_from_world)
    taken = [render(moved, texture) if i == camera else image for i, image in enumerate(images)]
    report = find_bumped(rig, taken, SETTINGS)
    assert report.bumped == (f"cam{camera}",)
    with pytest.raises(InputError, match=rf"take take_01: cam{camera} is \d+\.\d px off.*moved since calibration"):
        report.require_unmoved("take_01")
    placed = resect(rig, taken, report.bumped, SETTINGS)
    difference = placed[camera].camera_from_world @ invert(moved.camera_from_world)
    # some hundred points of half a pixel on a shallow subject: a pixel is 1.1 mrad, a tenth of it remains in place
    assert np.linalg.norm(difference[:3, 3]) < 2e-3
    assert find_bumped(placed, taken, SETTINGS).bumped == ()


def test_exchanged_files_are_told(scene):
    rig, images, _ = scene
    order = [0, 3, 2, 1, 4]
    report = find_bumped(rig, [images[i] for i in order], SETTINGS)
    assert set(report.bumped) == {"cam1", "cam3"}
    assert {c.camera: c.exchanged_with for c in report.cameras if c.bumped} == {"cam1": "cam3", "cam3": "cam1"}
    with pytest.raises(InputError, match="cam1 shows the view of cam3"):
        report.require_unmoved("take_01")


def test_a_blank_image_gives_no_verdict(scene):
    rig, images, _ = scene
    blank = [np.full_like(image, 80) if i == 4 else image for i, image in enumerate(images)]
    report = find_bumped(rig, blank, SETTINGS)
    assert report.bumped == ()
    assert report.cameras[4].residual_px is None
