"""Laws of fusion, thinning and neighbour counts."""

import numpy as np
from scipy.spatial import cKDTree

from headcap.reconstruction.fusion import count_neighbours, fuse, thin
from headcap.reconstruction.maps import DepthMap, cell_camera
from headcap.reconstruction.settings import FusionSettings


def _true_map(ball, camera, *, bias=0.0, sigma=1e-4) -> DepthMap:
    """The ball as a perfect map, moved by `bias` metres along the camera's axis."""
    depth = ball.depth(camera)
    known = np.isfinite(depth)
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
    local = np.stack([columns, rows, np.ones(depth.shape)], -1) @ np.linalg.inv(camera.matrix).T * depth[..., None]
    normal = (local - camera.camera_from_world[:3, 3]) / 0.1
    z = np.where(known, depth + bias, 0).astype(np.float32)
    return DepthMap(
        camera=camera,
        depth=z,
        normal=np.where(known[..., None], normal, 0).astype(np.float32),
        confidence=known.astype(np.float32),
        sigma=np.full(depth.shape, sigma, np.float32),
        colour=np.full((*depth.shape, 3), 99, np.uint8),
        chosen=known,
    )


def _cells(ball):
    return [cell_camera(camera.moved(camera.camera_from_world), 2) for camera in ball.rig]


def test_consistent_maps_keep_their_surface(ball):
    cloud = fuse([_true_map(ball, camera) for camera in _cells(ball)], time_s=0.0, settings=FusionSettings())
    error = np.abs(np.linalg.norm(cloud.positions, axis=1) - 0.1)
    # a cell's plane leaves the ball by half a cell's half-diagonal squared over the radius: (1.24 mm)^2 / 0.2 m = 8 um,
    # more where it is seen obliquely
    assert np.median(error) < 8e-6
    assert np.quantile(error, 0.99) < 60e-6
    assert (cloud.colours == 99).all()


def test_views_are_weighed_by_their_variance(ball):
    cameras = _cells(ball)
    maps = [_true_map(ball, cameras[0], bias=0.4e-3, sigma=4e-4), *(_true_map(ball, c, sigma=1e-4) for c in cameras[1:])]
    cloud = fuse(maps, time_s=0.0, settings=FusionSettings())
    front = cloud.positions[:, 2] > 0.09
    # the biased view has 1/16 of each other's weight; with at least two others its pull is below 0.4 / 33 mm
    assert np.abs(np.linalg.norm(cloud.positions[front], axis=1) - 0.1).max() < 0.05e-3


def test_a_surface_only_one_view_claims_is_dropped(ball):
    cameras = _cells(ball)
    far = _true_map(ball, cameras[0], bias=-0.02)
    cloud = fuse([far, *(_true_map(ball, camera) for camera in cameras[1:])], time_s=0.0, settings=FusionSettings())
    assert np.abs(np.linalg.norm(cloud.positions, axis=1) - 0.1).max() < 1e-3


def test_thinning_keeps_distance_and_covers(rng):
    points = rng.uniform(0, 1, (3000, 3)) * [1, 1, 0.02]
    kept = thin(points, np.arange(3000), 0.05)
    tree = cKDTree(points[kept])
    assert tree.query(points[kept], k=2)[0][:, 1].min() >= 0.05
    assert tree.query(points)[0].max() < 0.05


def test_neighbours_are_counted_along_the_surface(rng):
    points, normals = rng.uniform(0, 1, (800, 3)), rng.normal(size=(800, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    step = points[None] - points[:, None]
    near = np.linalg.norm(step, axis=2) < 0.15
    on_sheet = np.abs(np.einsum("ijk,ik->ij", step, normals)) <= 0.03
    np.testing.assert_array_equal(count_neighbours(points, normals, 0.15, 0.03), (near & on_sheet).sum(1) - 1)


def test_point_budget_is_kept(ball):
    maps = [_true_map(ball, camera) for camera in _cells(ball)]
    cloud = fuse(maps, time_s=0.0, settings=FusionSettings(max_points=1500))
    assert 900 < len(cloud) <= 1500
