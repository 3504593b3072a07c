"""Laws of topology, Laplacians, factors and nearest points."""

import numpy as np
import pytest
import trimesh
from scipy import sparse

from headcap.meshes import topology
from headcap.meshes.closest_point import Surface
from headcap.meshes.laplacian import Factor, bilaplacian, cotangent_laplacian, uniform_laplacian, vertex_areas


@pytest.fixture(scope="module")
def sphere():
    mesh = trimesh.creation.icosphere(4)
    return np.array(mesh.vertices), np.array(mesh.faces)


def test_closed_and_opened_sphere(sphere):
    _, triangles = sphere
    assert topology.euler_characteristic(triangles) == 2
    assert topology.boundary_loops(triangles) == []
    opened = triangles[1:]
    (loop,) = topology.boundary_loops(opened)
    assert sorted(loop) == sorted(triangles[0])
    assert topology.euler_characteristic(opened) == 1
    edges = topology.mesh_edges(opened)
    assert edges.boundary.sum() == 3
    assert (edges.triangles[edges.boundary, 1] == -1).all()
    for edge, pair in zip(edges.vertices[:50], edges.triangles[:50], strict=True):
        assert all(np.isin(edge, opened[t]).all() for t in pair if t >= 0)


def test_defects_are_found():
    fan = np.array([[0, 1, 2], [0, 3, 4]])
    assert topology.non_manifold_vertices(fan, 5).tolist() == [0]
    book = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    assert [0, 1] in topology.non_manifold_edges(book).tolist()
    turned = np.array([[0, 1, 2], [0, 1, 3]])
    assert topology.non_manifold_edges(turned).tolist() == [[0, 1]]


def test_polygons_become_fans_in_their_order():
    found = topology.polygon_fans([0, 1, 2, 3, 4, 5, 6, 1, 2, 3, 4, 5], [4, 3, 5])
    np.testing.assert_array_equal(found, [[0, 1, 2], [0, 2, 3], [4, 5, 6], [1, 2, 3], [1, 3, 4], [1, 4, 5]])
    assert topology.polygon_fans([], []).shape == (0, 3)


def test_one_surface_is_known_in_any_order_and_not_inside_out(sphere, rng):
    _, triangles = sphere
    turned = np.roll(triangles, 1, axis=1)[rng.permutation(len(triangles))]
    assert topology.same_triangles(triangles, turned)
    assert not topology.same_triangles(triangles, triangles[:, ::-1])
    assert not topology.same_triangles(triangles, triangles[1:])


def test_components_and_growth():
    triangles = np.array([[0, 1, 2], [1, 3, 2], [4, 5, 6]])
    labels = topology.vertex_components(triangles, 7)
    assert len(set(labels[:4])) == 1
    assert labels[0] != labels[4]
    start = np.zeros(7, bool)
    start[0] = True
    assert topology.grow(start, topology.vertex_adjacency(triangles, 7), 2).tolist() == [True] * 4 + [False] * 3


def test_laplacians_know_constants_and_spheres(sphere):
    vertices, triangles = sphere
    areas = vertex_areas(vertices, triangles)
    # the mean curvature normal of a sphere is twice its position. Over n equal triangles about a vertex the weights sum to
    # n tan(pi/n) and thirds of their areas to n sin(2 pi/n)/6, which makes it 3 / (2 cos^2(pi/n)): 2 for six, 2.29 for five;
    # what remains is of second order in the edges, 0.07 long
    normal = (cotangent_laplacian(vertices, triangles) @ vertices) / areas[:, None]
    valence = np.bincount(triangles.ravel())
    assert sorted(set(valence.tolist())) == [5, 6]
    np.testing.assert_allclose(normal, 1.5 / np.cos(np.pi / valence[:, None]) ** 2 * vertices, atol=2 * 0.07**2)
    assert areas.sum() == pytest.approx(4 * np.pi, rel=0.01)
    for laplacian in (cotangent_laplacian(vertices, triangles), uniform_laplacian(triangles, len(vertices))):
        np.testing.assert_allclose(laplacian @ np.ones(len(vertices)), 0, atol=1e-10)


def test_factor_solves_what_it_was_given(sphere, rng):
    vertices, triangles = sphere
    laplacian, areas = cotangent_laplacian(vertices, triangles), vertex_areas(vertices, triangles)
    matrix = bilaplacian(laplacian, areas) + sparse.diags_array(areas)
    truth = rng.normal(size=(len(vertices), 3))
    np.testing.assert_allclose(Factor(matrix).solve(matrix @ truth), truth, atol=1e-7)


def test_nearest_points_on_a_sphere(sphere, rng):
    vertices, triangles = sphere
    surface = Surface(vertices, triangles)
    queries = rng.normal(size=(500, 3))
    found = surface.closest(queries)
    # the mesh lies inside the sphere by edge^2 / 8 < 0.002
    np.testing.assert_allclose(found.distance, np.abs(np.linalg.norm(queries, axis=1) - 1), atol=2.5e-3)
    np.testing.assert_allclose(found.interpolate(triangles, vertices), found.points, atol=1e-12)
    signed = surface.signed_distance(queries, vertices)
    clear = np.abs(np.linalg.norm(queries, axis=1) - 1) > 0.01
    np.testing.assert_array_equal(signed[clear] > 0, np.linalg.norm(queries[clear], axis=1) > 1)
