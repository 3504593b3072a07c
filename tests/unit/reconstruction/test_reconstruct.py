"""From photographs to points: truth recovered, bad input refused."""

import numpy as np
import pytest
import trimesh

from headcap.cameras import Rig
from headcap.errors import InputError
from headcap.reconstruction.estimate import estimate_maps
from headcap.reconstruction.frame import reconstruct_frame
from headcap.reconstruction.fusion import fuse
from headcap.reconstruction.settings import ReconstructSettings

RADIUS_M = 0.1
SETTINGS = ReconstructSettings(engine="patchmatch")


@pytest.fixture(scope="module")
def maps(ball):
    return estimate_maps(ball.rig, ball.images, settings=SETTINGS)


def test_depth_and_normals_of_a_ball(maps, ball):
    front = maps[0]
    truth = ball.depth(front.camera)
    both = front.known & np.isfinite(truth)
    assert both.sum() > 0.8 * np.isfinite(truth).sum()
    # a pixel of disparity is 2.4 mm at 20 degrees; a tenth of it is what 8 x 8 windows with this noise give with ease
    assert np.median(np.abs(front.depth - truth)[both]) < 0.24e-3
    rows, columns = np.nonzero(both)
    local = np.stack([columns, rows, np.ones(len(rows))], 1) @ np.linalg.inv(front.camera.matrix).T * truth[both][:, None]
    centre = front.camera.camera_from_world[:3, 3]
    outward = (local - centre) / RADIUS_M
    angle = np.rad2deg(np.arccos(np.clip((outward * front.normal[both]).sum(1), -1, 1)))
    assert np.median(angle) < 6  # a window spans 8 mm of a 100 mm ball: 4.6 degrees from rim to rim


def test_points_lie_on_the_ball(maps, ball):
    cloud = fuse(maps, time_s=1.5, settings=SETTINGS.fusion)
    radius = np.linalg.norm(cloud.positions, axis=1)
    assert cloud.time_s == 1.5
    assert np.median(np.abs(radius - RADIUS_M)) < 0.15e-3  # several views average the maps' error
    assert np.quantile(np.abs(radius - RADIUS_M), 0.9) < 0.6e-3
    assert np.median((cloud.normals * cloud.positions).sum(1) / radius) > 0.995
    front = np.deg2rad(np.random.default_rng(0).uniform(-30, 30, (400, 2)))
    wanted = RADIUS_M * np.stack([np.sin(front[:, 0]) * np.cos(front[:, 1]), np.sin(front[:, 1]), np.cos(front).prod(1)], 1)
    nearest = np.linalg.norm(wanted[:, None] - cloud.positions[None], axis=2).min(1)
    assert (nearest < 3e-3).mean() > 0.97  # points stand 1.1 to 2 pixels of 0.9 mm apart


def test_exposure_of_each_camera_does_not_matter(maps, ball):
    gains = (1.0, 0.8, 1.15, 0.7, 1.05)
    images = [np.clip(image * gain + 8, 0, 255).astype(np.uint8) for image, gain in zip(ball.images, gains, strict=True)]
    cloud = reconstruct_frame(ball.rig, images, time_s=0.0, settings=SETTINGS)
    assert np.median(np.abs(np.linalg.norm(cloud.positions, axis=1) - RADIUS_M)) < 0.2e-3


def test_prior_and_masks_are_used(ball):
    ball_mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.103)
    vertices, triangles = np.asarray(ball_mesh.vertices), np.asarray(ball_mesh.faces)
    masks = []
    for camera in ball.rig:
        mask = np.zeros((camera.height, camera.width), bool)
        mask[:120] = True
        masks.append(mask)
    maps = estimate_maps(ball.rig, ball.images, settings=SETTINGS, prior=(vertices, triangles), masks=masks)
    assert not any(depth_map.known[61:].any() for depth_map in maps)
    truth = ball.depth(maps[0].camera)
    both = maps[0].known & np.isfinite(truth)
    assert np.median(np.abs(maps[0].depth - truth)[both]) < 0.3e-3


def test_same_input_same_points(ball, maps):
    again = estimate_maps(ball.rig, ball.images, settings=SETTINGS)
    assert all((one.depth == other.depth).all() for one, other in zip(maps, again, strict=True))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rig, images: (Rig(rig.cameras[:2]), images[:2]), "at least 3"),
        (lambda rig, images: (rig, images[:3]), "one per camera"),
        (lambda rig, images: (rig, [image[:-1] for image in images]), "uint8"),
        (lambda rig, images: (rig, [np.full_like(image, 90) for image in images]), "no point"),
    ],
)
def test_unusable_input_is_refused(ball, change, message):
    rig, images = change(ball.rig, ball.images)
    with pytest.raises(InputError, match=message):
        reconstruct_frame(rig, images, time_s=0.0, settings=SETTINGS)


def test_colmap_engine_says_what_it_needs(ball, monkeypatch):
    import pycolmap

    monkeypatch.setattr(pycolmap, "has_cuda", False)
    with pytest.raises(InputError, match="CUDA"):
        reconstruct_frame(ball.rig, ball.images, time_s=0.0, settings=ReconstructSettings(engine="colmap"))
