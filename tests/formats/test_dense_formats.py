"""COLMAP's dense files and the PMVS workspace, byte by byte."""

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from headcap.cameras import Camera, Rig
from headcap.errors import InputError
from headcap.reconstruction.colmap_engine import fuse_colmap
from headcap.reconstruction.colmap_files import (
    map_tracks,
    read_depth_maps,
    read_map,
    write_depth_maps,
    write_map,
    write_workspace,
)
from headcap.reconstruction.maps import DepthMap
from headcap.reconstruction.pmvs_export import export_pmvs
from headcap.reconstruction.settings import ReconstructSettings


def _camera(name: str, x_m: float) -> Camera:
    pose = np.eye(4)
    pose[0, 3] = -x_m
    return Camera(name, 40, 30, np.array([[50.0, 0, 19.5], [0, 50, 14.5], [0, 0, 1]]), np.zeros(5), pose)


def _wall(camera: Camera) -> DepthMap:
    """A wall one metre away, straight ahead."""
    shape = (camera.height, camera.width)
    normal = np.zeros((*shape, 3), np.float32)
    normal[..., 2] = -1
    ones = np.ones(shape, np.float32)
    grey = np.full((*shape, 3), 90, np.uint8)
    return DepthMap(camera, ones, normal, ones, ones * 1e-3, grey, ones.astype(bool))


@pytest.fixture
def rig() -> Rig:
    return Rig(tuple(_camera(f"cam{k}", 0.05 * k) for k in range(4)))


def test_depth_map_bytes(tmp_path):
    values = np.arange(6, dtype=np.float32).reshape(2, 3)
    write_map(tmp_path / "d.bin", values)
    assert (tmp_path / "d.bin").read_bytes() == b"3&2&1&" + struct.pack("<6f", *range(6))
    np.testing.assert_array_equal(read_map(tmp_path / "d.bin"), values)


def test_normal_map_is_planar(tmp_path):
    values = np.arange(12, dtype=np.float32).reshape(2, 2, 3)
    write_map(tmp_path / "n.bin", values)
    assert (tmp_path / "n.bin").read_bytes() == b"2&2&3&" + struct.pack("<12f", 0, 3, 6, 9, 1, 4, 7, 10, 2, 5, 8, 11)
    np.testing.assert_array_equal(read_map(tmp_path / "n.bin"), values)


def test_map_bytes_that_look_like_the_separator(tmp_path):
    values = np.frombuffer(b"&&&&" * 4, "<f4").reshape(2, 2)
    write_map(tmp_path / "d.bin", values)
    np.testing.assert_array_equal(read_map(tmp_path / "d.bin"), values)


def test_cut_map_is_refused(tmp_path):
    (tmp_path / "d.bin").write_bytes(b"3&2&1&" + bytes(20))
    with pytest.raises(InputError, match="cut short"):
        read_map(tmp_path / "d.bin")


def test_workspace_round_trip_through_pycolmap(tmp_path, rig):
    import pycolmap

    maps = [_wall(camera) for camera in rig]
    images = [depth_map.colour for depth_map in maps]
    write_workspace(tmp_path, list(rig), images, [[1, 2], [0, 2], [1, 3], [2]], map_tracks(maps))
    write_depth_maps(tmp_path, maps)
    model = pycolmap.Reconstruction(str(tmp_path / "sparse"))
    assert model.num_points3D() > 500
    for image in model.images.values():
        camera = rig[image.name.removesuffix(".png")]
        np.testing.assert_allclose(image.cam_from_world().matrix(), camera.camera_from_world[:3], atol=1e-12)
        # the dense stage counts from integer centres: no half pixel is added
        np.testing.assert_allclose(model.cameras[image.camera_id].params, [50, 50, 19.5, 14.5])
    again = read_depth_maps(tmp_path, list(rig), images)
    np.testing.assert_array_equal(again[2].normal, maps[2].normal)
    assert (tmp_path / "stereo" / "patch-match.cfg").read_text().startswith("cam0.png\ncam1.png, cam2.png\n")


def test_empty_maps_are_told(tmp_path, rig):
    maps = [_wall(camera) for camera in rig]
    images = [depth_map.colour for depth_map in maps]
    write_workspace(tmp_path, list(rig), images, [[1], [0], [1], [2]], [])
    for depth_map in maps:
        file = f"{depth_map.name}.png.geometric.bin"
        write_map(tmp_path / "stereo" / "depth_maps" / file, np.zeros((30, 40), np.float32))
        write_map(tmp_path / "stereo" / "normal_maps" / file, depth_map.normal)
    with pytest.raises(InputError, match="empty"):
        read_depth_maps(tmp_path, list(rig), images)


def test_colmap_fuses_our_maps(rig):
    cloud = fuse_colmap([_wall(camera) for camera in rig], time_s=0.5, settings=ReconstructSettings())
    assert len(cloud) > 300
    np.testing.assert_allclose(cloud.positions[:, 2], 1.0, atol=1e-5)
    np.testing.assert_allclose(cloud.normals[:, 2], -1.0, atol=1e-5)


DOT_SIGMA_PX = 1.5


@pytest.fixture(scope="module")
def pmvs(tmp_path_factory) -> tuple[Path, Rig, np.ndarray]:
    """A workspace of four cameras on an arc, with lens distortion, that photograph one soft dot each at a true point."""
    ring, images, point = [], [], np.array([0.04, -0.03, 0.02])
    lens = np.array([-0.15, 0.05, 1e-3, -5e-4, 0.0])
    for k in range(4):
        yaw, pose = np.deg2rad(15.0 * k), np.eye(4)
        pose[:3, :3] = [[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]]
        pose[2, 3] = 0.5
        matrix = np.array([[260.0 + k, 0, 101.2], [0, 262.0, 74.1], [0, 0, 1]])
        ring.append(Camera(f"cam{k}", 200, 150, matrix, lens, pose))
        u, v = ring[-1].project(point)[0].ravel()
        y, x = np.mgrid[:150, :200]
        dot = 230 * np.exp(-0.5 * ((x - u) ** 2 + (y - v) ** 2) / DOT_SIGMA_PX**2)
        images.append(np.repeat(np.rint(dot)[..., None], 3, 2).astype(np.uint8))
    folder, rig = tmp_path_factory.mktemp("pmvs"), Rig(tuple(ring))
    masks = [image.max(2) > 20 for image in images]
    export_pmvs(folder, rig, images, settings=ReconstructSettings(), masks=masks)
    return folder, rig, point


def _read_projection(path: Path) -> np.ndarray:
    """As PMVS2 reads it: words apart by blanks, numbers in single precision."""
    word, *numbers = path.read_text().split()
    assert word == "CONTOUR"
    return np.array(numbers, np.float32).reshape(3, 4)


def test_pmvs_matrices_project_truth_to_where_the_photographs_show_it(pmvs):
    folder, rig, point = pmvs
    rng = np.random.default_rng(4)
    around = rng.uniform(-0.06, 0.06, (50, 3))
    for k, camera in enumerate(rig):
        projection = _read_projection(folder / "txt" / f"{k:08d}.txt")
        homogeneous = np.c_[around, np.ones(50)] @ projection.T
        straight = camera.undistort_pixels(camera.project(around)[0]) @ camera.matrix[:2, :2].T + camera.matrix[:2, 2]
        # single precision leaves 1e-5 of 200 pixels, undoing the lens 1e-3
        np.testing.assert_allclose(homogeneous[:, :2] / homogeneous[:, 2:], straight, atol=5e-3)
        picture = cv2.imread(str(folder / "visualize" / f"{k:08d}.ppm"))[..., 0].astype(float)
        y, x = np.mgrid[: picture.shape[0], : picture.shape[1]]
        centroid = np.array([(x * picture).sum(), (y * picture).sum()]) / picture.sum()
        dot = projection @ np.append(point, 1)
        # rounding to grey levels and the lens' stretch across the dot move its centroid by some hundredths of a pixel
        np.testing.assert_allclose(centroid, dot[:2] / dot[2], atol=0.1)
        mask = cv2.imread(str(folder / "masks" / f"{k:08d}.pgm"), cv2.IMREAD_UNCHANGED)
        assert mask.shape == picture.shape
        # a pixel at the rim of the silhouette is lost to interpolation
        assert (mask[picture > 120] > 127).all()
        assert (mask[picture < 5] <= 127).all()


def test_pmvs_visibility_and_options_read_back(pmvs):
    folder, rig, _ = pmvs
    words = iter((folder / "vis.dat").read_text().split())
    assert (next(words), int(next(words))) == ("VISDATA", len(rig))
    for k in range(len(rig)):
        number, count = int(next(words)), int(next(words))
        linked = [int(next(words)) for _ in range(count)]
        assert number == k
        assert k not in linked
        assert 0 < len(set(linked)) == count
        assert set(linked) <= set(range(len(rig)))
    assert next(words, None) is None
    options = dict(line.split(" ", 1) for line in (folder / "option-all").read_text().splitlines())
    # every name that PMVS2 knows; it stops at others and where timages or oimages is missing
    known = {"level", "csize", "threshold", "wsize", "minImageNum", "CPU", "setEdge", "useBound", "useVisData", "sequence"}
    assert {"timages", "oimages"} <= set(options) <= known | {"timages", "oimages", "quad", "maxAngle"}
    assert options["timages"] == "-1 0 4"
    assert options["useVisData"] == "1"
    assert (folder / "models").is_dir()
