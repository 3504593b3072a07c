"""Each foreign calibration format: what it holds comes back, and what it means is pinned by numbers read off the file."""

import json
import tomllib

import cv2
import numpy as np
import pycolmap
import pytest
import yaml
from scipy.spatial.transform import Rotation

from headcap.cameras import Camera, Rig
from headcap.cameras.formats import READERS, guess_format, read_rig, write_rig
from headcap.errors import InputError
from headcap.geometry.transforms import invert, rigid

SUFFIX = {"colmap": "", "opencv_yaml": ".yaml", "kalibr": ".yaml", "aniposelib": ".toml", "caliscope": ".toml"}
SUFFIX["transforms_json"] = ".json"


def make_rig(rng: np.random.Generator, *, k3: bool) -> Rig:
    cameras = []
    for i in range(4):
        matrix = np.array([[900 + rng.normal(), 0, 310.25], [0, 905 + rng.normal(), 247.5], [0, 0, 1]])
        distortion = np.array([-0.1, 0.05, 1e-3, -2e-3, 0.01 if k3 else 0.0]) + rng.normal(0, 1e-3, 5) * [1, 1, 1, 1, k3]
        pose = rigid(Rotation.random(rng=rng).as_matrix(), rng.normal(0, 1, 3))
        cameras.append(Camera(f"cam{i:02d}", 640, 480, matrix, distortion, pose))
    return Rig(tuple(cameras))


@pytest.mark.parametrize("name", sorted(READERS))
def test_a_rig_comes_back_as_it_was_written(name, rng, tmp_path):
    rig = make_rig(rng, k3=name in ("opencv_yaml", "aniposelib", "caliscope", "transforms_json", "colmap"))
    path = tmp_path / f"rig{SUFFIX[name]}"
    write_rig(rig, path, name)
    assert guess_format(path) == name
    back = read_rig(path)
    assert back.names == rig.names
    for a, b in zip(back, rig, strict=True):
        assert a.size == b.size
        # every writer prints doubles in full; quaternions, vectors and chains of products round a few times more
        np.testing.assert_allclose(a.matrix, b.matrix, rtol=0, atol=1e-9)
        np.testing.assert_allclose(a.distortion, b.distortion, rtol=0, atol=1e-12)
        np.testing.assert_allclose(a.camera_from_world, b.camera_from_world, rtol=0, atol=1e-12)


def test_colmap_puts_the_first_pixel_at_one_half(rng, tmp_path):
    rig = make_rig(rng, k3=False)
    write_rig(rig, tmp_path / "model", "colmap")
    model = pycolmap.Reconstruction(str(tmp_path / "model"))
    image = next(i for i in model.images.values() if i.name == "cam00.png")
    lens = model.cameras[image.camera_id]
    assert lens.params[2] == pytest.approx(rig[0].matrix[0, 2] + 0.5, abs=1e-9)
    # COLMAP's own projection of a point is ours plus half a pixel: centre, axes and unit in one
    point = rig[0].centre + rig[0].camera_from_world[:3, :3].T @ np.array([0.05, -0.08, 1.0])
    local = image.cam_from_world() * point
    theirs = lens.img_from_cam(local)
    np.testing.assert_allclose(theirs - 0.5, rig[0].project(point[None])[0][0], atol=1e-9)


def test_transforms_json_has_opengl_axes(rng, tmp_path):
    rig = make_rig(rng, k3=False)
    write_rig(rig, tmp_path / "transforms.json", "transforms_json")
    frame = json.loads((tmp_path / "transforms.json").read_text())["frames"][0]
    world_from_camera = np.array(frame["transform_matrix"])
    np.testing.assert_allclose(world_from_camera[:3, 2], -rig[0].axis, atol=1e-12)  # an OpenGL camera looks along -z
    np.testing.assert_allclose(world_from_camera[:3, 1], -rig[0].camera_from_world[1, :3], atol=1e-12)
    np.testing.assert_allclose(world_from_camera[:3, 3], rig[0].centre, atol=1e-12)  # metres
    assert frame["cx"] == pytest.approx(rig[0].matrix[0, 2] + 0.5)


def test_opencv_yaml_projects_with_opencv(rng, tmp_path):
    rig = make_rig(rng, k3=True)
    write_rig(rig, tmp_path / "rig.yaml", "opencv_yaml")
    storage = cv2.FileStorage(str(tmp_path / "rig.yaml"), cv2.FILE_STORAGE_READ)
    k, d, r, t = (storage.getNode(f"camera_0_{field}").mat() for field in ("K", "D", "R", "t"))
    point = rig[0].centre + rig[0].camera_from_world[:3, :3].T @ np.array([0.05, -0.08, 1.0])
    theirs, _ = cv2.projectPoints(point[None], cv2.Rodrigues(r)[0], t, k, d)
    np.testing.assert_allclose(theirs.reshape(2), rig[0].project(point[None])[0][0], atol=1e-9)


def test_kalibr_chains_each_camera_to_the_one_before(rng, tmp_path):
    rig = make_rig(rng, k3=False)
    write_rig(rig, tmp_path / "camchain.yaml", "kalibr")
    chain = yaml.safe_load((tmp_path / "camchain.yaml").read_text())
    expected = rig[2].camera_from_world @ invert(rig[1].camera_from_world)
    np.testing.assert_allclose(chain["cam2"]["T_cn_cnm1"], expected, atol=1e-12)
    np.testing.assert_allclose(chain["cam2"]["intrinsics"][2:], rig[2].matrix[:2, 2], atol=1e-9)  # integer pixel centres
    # a chain from Kalibr itself has no world: the first camera is it, relative poses stay
    del chain["cam0"]["world_from_cam0"]
    (tmp_path / "bare.yaml").write_text(yaml.safe_dump(chain))
    bare = read_rig(tmp_path / "bare.yaml")
    np.testing.assert_allclose(bare[0].camera_from_world, np.eye(4))
    np.testing.assert_allclose(bare[2].camera_from_world @ invert(bare[1].camera_from_world), expected, atol=1e-12)


def test_aniposelib_is_in_millimetres_and_caliscope_in_metres(rng, tmp_path):
    rig = make_rig(rng, k3=True)
    write_rig(rig, tmp_path / "a.toml", "aniposelib")
    write_rig(rig, tmp_path / "c.toml", "caliscope")
    anipose = tomllib.loads((tmp_path / "a.toml").read_text())["cam_1"]
    caliscope = tomllib.loads((tmp_path / "c.toml").read_text())["cameras"]["1"]
    np.testing.assert_allclose(anipose["translation"], 1e3 * rig[1].camera_from_world[:3, 3], atol=1e-9)
    np.testing.assert_allclose(caliscope["translation"], rig[1].camera_from_world[:3, 3], atol=1e-12)
    rotation = cv2.Rodrigues(np.array(anipose["rotation"]))[0]
    np.testing.assert_allclose(rotation, rig[1].camera_from_world[:3, :3], atol=1e-12)
    np.testing.assert_allclose(anipose["matrix"], rig[1].matrix, atol=1e-12)  # integer pixel centres


def test_what_a_format_cannot_hold_is_refused(rng, tmp_path):
    with pytest.raises(InputError, match=r"k3 is not zero.*Kalibr"):
        write_rig(make_rig(rng, k3=True), tmp_path / "camchain.yaml", "kalibr")
    with pytest.raises(InputError, match="calibration format 'metashape'"):
        write_rig(make_rig(rng, k3=True), tmp_path / "x", "metashape")
    (tmp_path / "other.toml").write_text("title = 'no calibration'\n")
    with pytest.raises(InputError, match="no aniposelib calibration"):
        read_rig(tmp_path / "other.toml")
    with pytest.raises(InputError, match="does not exist"):
        read_rig(tmp_path / "nothing.yaml")


@pytest.mark.real
def test_caliscope_reads_its_own_file(test_data):
    rig = read_rig(test_data / "caliscope" / "camera_array.toml")
    assert len(rig) == 4
    assert rig[0].size == (1280, 720)
    assert np.linalg.det(rig[0].camera_from_world[:3, :3]) == pytest.approx(1, abs=1e-12)
