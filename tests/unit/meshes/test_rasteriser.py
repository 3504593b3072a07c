"""The z-buffer against exact ray casting and its own laws."""

import numpy as np
import pytest
import trimesh

from headcap.cameras import Camera
from headcap.meshes.normals import vertex_normals
from headcap.meshes.rasteriser import rasterise


@pytest.fixture
def camera() -> Camera:
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = [0.01, 0.02, 1.0]
    return Camera("front", 160, 120, np.array([[400.0, 0, 80], [0, 410.0, 61], [0, 0, 1]]), np.zeros(5), pose)


@pytest.fixture
def ball() -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=3, radius=0.1)


def test_depth_is_where_the_ray_meets_the_triangle(camera, ball):
    raster = rasterise(camera, ball.vertices, ball.faces)
    rows, columns = np.nonzero(raster.hit)
    points = raster.interpolate(ball.faces, ball.vertices)[rows, columns]
    pixels, depth = camera.project(points)
    # float32 barycentrics: 6e-8 * 400 px; depth alike
    assert np.abs(pixels - np.stack([columns, rows], 1)).max() < 1e-3
    assert np.abs(depth - raster.depth[rows, columns]).max() < 1e-6


def test_the_nearest_triangle_wins(camera, ball):
    raster = rasterise(camera, ball.vertices, ball.faces)
    normals = vertex_normals(ball.vertices, ball.faces)
    seen = raster.interpolate(ball.faces, normals)[raster.hit]
    towards = camera.centre - raster.interpolate(ball.faces, ball.vertices)[raster.hit]
    # a facet's corner normal may lean back by the facet's half opening (radius 0.1, edge ~0.015: 4 degrees)
    assert (np.einsum("ij,ij->i", seen, towards / np.linalg.norm(towards, axis=1, keepdims=True)) > -0.08).all()


def test_culling_drops_only_back_faces(camera, ball):
    culled = rasterise(camera, ball.vertices, ball.faces, cull_back_faces=True)
    assert np.array_equal(culled.triangle, rasterise(camera, ball.vertices, ball.faces).triangle)
    inside_out = rasterise(camera, ball.vertices, ball.faces[:, ::-1], cull_back_faces=True)
    both = inside_out.hit & culled.hit
    assert both.any()
    assert (inside_out.depth[both] > culled.depth[both]).all()  # only the far side faces the camera now


def test_vertex_normals_of_a_ball_are_radial(ball):
    normals = vertex_normals(ball.vertices, ball.faces)
    assert np.einsum("ij,ij->i", normals, ball.vertices / 0.1).min() > 0.999
