"""COLMAP's dense files and the PMVS workspace, byte by byte."""

import struct

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


def test_pmvs_workspace(tmp_path, rig):
    ring = []
    for k, camera in enumerate(rig):
        yaw = np.deg2rad(15.0 * k)
        pose = np.eye(4)
        pose[:3, :3] = [[np.cos(yaw), 0, -np.sin(yaw)], [0, 1, 0], [np.sin(yaw), 0, np.cos(yaw)]]
        pose[2, 3] = 1.0
        ring.append(camera.moved(pose))
    images = [np.full((30, 40, 3), 40 * k, np.uint8) for k in range(4)]
    export_pmvs(tmp_path, Rig(tuple(ring)), images, settings=ReconstructSettings())
    for k, camera in enumerate(ring):
        lines = (tmp_path / "txt" / f"{k:08d}.txt").read_text().splitlines()
        assert lines[0] == "CONTOUR"
        projection = np.array([line.split() for line in lines[1:]], float)
        image_point = projection @ [0.01, 0.02, 0.03, 1]
        np.testing.assert_allclose(image_point[:2] / image_point[2], camera.project(np.array([0.01, 0.02, 0.03]))[0])
    links = (tmp_path / "vis.dat").read_text().splitlines()
    assert links[:2] == ["VISDATA", "4"]
    assert links[2].split()[0] == "0"
    assert len(links[2].split()) == 2 + int(links[2].split()[1])
    assert "timages -1 0 4" in (tmp_path / "option-all").read_text()
    assert (tmp_path / "models").is_dir()
