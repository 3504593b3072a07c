"""Dense stereo on photographs that the project did not make."""

import json
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from headcap.cameras import Camera, Rig
from headcap.meshes.closest_point import Surface
from headcap.reconstruction.frame import reconstruct_frame
from headcap.reconstruction.photo_consistency import photo_consistency
from headcap.reconstruction.settings import ReconstructSettings

BOX_M = ((-0.073568, 0.021728, -0.012445), (0.028855, 0.181892, 0.062736))


def _temple(folder: Path) -> tuple[Rig, list[np.ndarray]]:
    cameras, images = [], []
    for line in (folder / "templeSR_par.txt").read_text().splitlines()[1:]:
        name, *numbers = line.split()
        values = np.array(numbers, float)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = values[9:18].reshape(3, 3), values[18:]
        cameras.append(Camera(name.removesuffix(".png"), 640, 480, values[:9].reshape(3, 3), np.zeros(5), pose))
        images.append(cv2.imread(str(folder / name)))
    return Rig(tuple(cameras)), images


@pytest.mark.real
def test_temple_left_out_view_is_foretold(test_data):
    rig, images = _temple(test_data / "temple")
    chosen, left_out = [0, 1, 5, 6, 7, 9, 10, 14], 8
    masks = [images[k].max(2) > 60 for k in chosen]  # the plaster is brighter than its stand
    settings = ReconstructSettings(engine="patchmatch")
    cloud = reconstruct_frame(
        Rig(tuple(rig[k] for k in chosen)), [images[k] for k in chosen], time_s=0.0, settings=settings, masks=masks
    )
    inside = ((cloud.positions >= BOX_M[0]) & (cloud.positions <= BOX_M[1])).all(1)
    # some of the stand and of mixed pixels at the silhouette are as bright as the plaster
    assert inside.mean() > 0.95
    # a depth error of 2 mm moves the flutes, 5 mm apart, by 2 pixels in this view and leaves a correlation below 0.5
    assert photo_consistency(cloud, rig[left_out], images[left_out]) > 0.7


def _still_frame(folder: Path, take: str, cameras: list[int]) -> tuple[Rig, list[np.ndarray], np.ndarray, np.ndarray]:
    """True cameras, photographs at 0.30 s (the subject holds still until 0.40 s) and the true mesh."""
    document = json.loads((folder / "truth" / "rig.json").read_text())
    starts = document["takes"][take]["first_frame_time_s"]
    rig, images = [], []
    for k in cameras:
        truth, pose = document["cameras"][k], np.eye(4)
        pose[:3, :3], pose[:3, 3] = truth["R"], truth["t"]
        rig.append(Camera(f"cam{k:02d}", 540, 960, np.array(truth["K"]), np.array(truth["dist"]), pose))
        with av.open(str(folder / "takes" / take / f"cam{k:02d}.mp4")) as container:
            frames = list(zip(range(round((0.30 - starts[k]) * 60) + 1), container.decode(video=0), strict=False))
        images.append(frames[-1][1].to_ndarray(format="bgr24"))
    mesh = np.load(folder / "truth" / f"{take}.npz")
    vertices = mesh["first_m"] + mesh["vertices_mm_i16"][np.abs(mesh["time_s"] - 0.30).argmin()] * 4e-6
    return Rig(tuple(rig)), images, vertices, np.load(folder / "truth" / "topology.npz")["faces"]


@pytest.mark.real
def test_head_at_half_size(test_data):
    rig, images, vertices, faces = _still_frame(test_data / "ict_rig", "speech_01", [4, 5, 6, 7, 8, 9, 10, 11])
    settings = ReconstructSettings(engine="patchmatch", scale=0.5)
    cloud = reconstruct_frame(rig, images, time_s=0.3, settings=settings)
    error_mm = 1e3 * Surface(vertices, faces).closest(cloud.positions.astype(float)).distance
    # A pixel is 0.9 mm at half size and sources stand 22 to 36 degrees apart, so a pixel of disparity is 0.9 / tan(angle) =
    # 1.2 to 2.2 mm of depth, 1.8 at 27 degrees. Converged matches are good to a tenth of it; nine in ten must be within a half,
    # which is what the windows of 7 mm are wrong by where skin bends inside them (nostrils, lids, lips).
    assert np.median(error_mm) < 0.18
    assert np.quantile(error_mm, 0.9) < 0.9
    assert len(cloud) > 15_000
