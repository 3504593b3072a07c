"""Laws of modified butterfly subdivision: it interpolates, is exact where its rules are, smooth in the limit, has no cracks."""

import numpy as np
import pytest
import trimesh

from headcap.errors import InputError
from headcap.heads import base_head
from headcap.meshes import topology
from headcap.meshes.normals import triangle_normals
from headcap.meshes.subdivision import ordered_rings, subdivide_butterfly

ROOT_5, ROOT_HALF = np.sqrt(5.0), np.sqrt(0.5)


def hexagonal(size: int) -> tuple[np.ndarray, np.ndarray]:
    """A regular triangulation of a rhombus: plane points (size^2, 2), triangles."""
    i, j = np.meshgrid(np.arange(size), np.arange(size), indexing="ij")
    points = np.stack([i + 0.5 * j, np.sqrt(0.75) * j], axis=-1).reshape(-1, 2)
    corner = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).ravel()
    a, b, c, d = corner, corner + size, corner + 1, corner + size + 1
    return points, np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)])


def wheel(valence: int) -> np.ndarray:
    """Triangles of two rings about vertex 0 of a given valence; vertices of the inner ring are regular."""
    k = np.arange(valence)
    after = (k + 1) % valence
    inner, tip, side = 1 + k, 1 + valence + 2 * k, 2 + valence + 2 * k
    first = np.stack([np.zeros_like(k), inner, 1 + after], 1)
    between = np.stack([inner, side, 1 + after], 1)
    left, right = np.stack([inner, tip, side], 1), np.stack([1 + after, side, 1 + valence + 2 * after], 1)
    return np.concatenate([first, between, left, right])


@pytest.fixture(scope="module")
def head():
    return base_head()


@pytest.fixture(scope="module")
def front(head):
    chosen = (head.regions["face"] | head.regions["neck"])[head.triangles].all(axis=1) & (
        head.vertices[head.triangles].mean(1)[:, 2] > 0
    )
    return chosen, subdivide_butterfly(head.triangles, len(head.vertices), chosen)


def test_rings_run_around_each_vertex():
    points, triangles = hexagonal(5)
    start, ring, closed = ordered_rings(triangles, len(points))
    for v in range(len(points)):
        around = points[ring[start[v] : start[v + 1]]] - points[v]
        turn = np.unwrap(np.arctan2(around[:, 1], around[:, 0]))
        assert (np.diff(turn) > 0).all()
        on_rim = (np.abs(points[v, 1]) < 1e-9) or v % 5 in (0, 4) or v // 5 in (0, 4)
        assert closed[v] == (not on_rim)


def test_old_vertices_stay_and_rows_sum_to_one(head, front):
    _, step = front
    n = len(head.vertices)
    fine = step.carry(head.vertices)
    assert np.array_equal(fine[:n], head.vertices)
    assert np.abs(step.operator.sum(axis=1) - 1).max() < 1e-15 * 8


def test_is_affine_invariant(head, front, rng):
    _, step = front
    matrix, shift = rng.normal(size=(3, 3)), rng.normal(size=3)
    assert np.allclose(step.carry(head.vertices @ matrix + shift), step.carry(head.vertices) @ matrix + shift, atol=1e-13)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_is_exact_on_cubics_of_a_regular_grid(degree):
    points, triangles = hexagonal(8)
    step = subdivide_butterfly(triangles, len(points))
    powers = [(a, b) for a in range(degree + 1) for b in range(degree + 1 - a)]
    terms = np.stack([points[:, 0] ** a * points[:, 1] ** b for a, b in powers], axis=1)
    middle = points[step.split_edges].mean(axis=1)
    expected = np.stack([middle[:, 0] ** a * middle[:, 1] ** b for a, b in powers], axis=1)
    inside = np.ones(len(step.split_edges), bool)
    if degree > 1:  # beyond two rings of the boundary no stencil reaches it; planes are exact up to it
        row, column = step.split_edges // 8, step.split_edges % 8
        inside = ((row > 1) & (row < 6) & (column > 1) & (column < 6)).all(axis=1)
        assert inside.sum() > 10
    elif degree == 1:  # the four-point rule needs a straight boundary, which ends at the corners
        inside = ~np.isin(step.split_edges, [0, 7, 56, 63]).any(axis=1)
    new = step.carry(terms)[len(points) :]
    assert np.abs(new - expected)[inside].max() < 1e-11


@pytest.mark.parametrize(
    ("valence", "weights"),
    [
        (3, [5 / 12, -1 / 12, -1 / 12]),
        (4, [3 / 8, 0, -1 / 8, 0]),
        (5, [0.35, (ROOT_5 - 1) / 40, -(ROOT_5 + 1) / 40, -(ROOT_5 + 1) / 40, (ROOT_5 - 1) / 40]),
        (8, [7, 1 + 4 * ROOT_HALF, -1, 1 - 4 * ROOT_HALF, -1, 1 - 4 * ROOT_HALF, -1, 1 + 4 * ROOT_HALF] / np.float64(32)),
    ],
)
def test_irregular_vertices_have_the_published_weights(valence, weights):
    triangles = wheel(valence)
    step = subdivide_butterfly(triangles, 1 + 3 * valence)
    row = step.operator.toarray()[1 + 3 * valence + np.flatnonzero((step.split_edges == [0, 1]).all(axis=1))[0]]
    assert row[0] == pytest.approx(0.75, abs=1e-15)
    assert row[1 : 1 + valence] == pytest.approx(weights, abs=1e-15)
    assert (row[1 + valence :] == 0).all()


def test_between_regular_vertices_is_the_butterfly():
    points, triangles = hexagonal(7)
    step = subdivide_butterfly(triangles, 49)
    row = step.operator.toarray()[49 + np.flatnonzero((step.split_edges == [24, 31]).all(axis=1))[0]]
    assert sorted(row[row != 0]) == [-1 / 16] * 4 + [1 / 8] * 2 + [1 / 2] * 2
    edge = points[31] - points[24]
    assert np.allclose(row @ points, points[24] + 0.5 * edge)


def test_between_two_irregular_vertices_is_their_mean():
    solid = trimesh.creation.icosahedron()
    triangles = np.array(solid.faces)
    step = subdivide_butterfly(triangles, 12)
    a, b = step.split_edges[0]
    row = step.operator.toarray()[12]
    start, ring, _ = ordered_rings(triangles, 12)
    expected = np.zeros(12)
    for end, other in ((a, b), (b, a)):
        around = ring[start[end] : start[end + 1]]
        place = list(around).index(other)
        angle = 2 * np.pi * (np.arange(5) - place) / 5
        expected[end] += 0.375
        expected[around] += 0.5 * (0.25 + np.cos(angle) + 0.5 * np.cos(2 * angle)) / 5
    assert np.allclose(row, expected, atol=1e-16)


@pytest.mark.parametrize("k", [2, 4, 5, 7])
def test_an_irregular_boundary_vertex_keeps_planes(k):
    """On the fan's own characteristic points the new vertex lies in the middle of its edge."""
    t = np.pi * np.arange(k + 1) / k
    points = np.concatenate([[[0.0, 0.0]], np.stack([np.cos(t), np.sin(t)], axis=1)])
    fan = np.stack([np.zeros(k, int), 1 + np.arange(k), 2 + np.arange(k)], axis=1)
    step = subdivide_butterfly(fan, k + 2)
    spokes = (step.split_edges[:, 0] == 0) & (step.split_edges[:, 1] > 1) & (step.split_edges[:, 1] < k + 1)
    new = step.carry(points)[k + 2 :][spokes]
    # the outer vertices have two triangles and the plain middle for a rule: the new vertex is the mean of it and the fan's
    assert np.abs(new - points[step.split_edges[spokes]].mean(axis=1)).max() < 1e-14
    assert np.abs(step.operator.sum(axis=1) - 1).max() < 1e-14


def test_converges_to_a_smooth_surface_on_a_sphere():
    solid = trimesh.creation.icosphere(1)
    vertices, triangles = np.array(solid.vertices), np.array(solid.faces)
    turn, radius_error = [], []
    for _ in range(5):
        step = subdivide_butterfly(triangles, len(vertices))
        vertices, triangles = step.carry(vertices), step.triangles
        normals = triangle_normals(vertices, triangles)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        edges = topology.mesh_edges(triangles)
        cosine = np.einsum("ek,ek->e", normals[edges.triangles[:, 0]], normals[edges.triangles[:, 1]])
        turn.append(np.degrees(np.arccos(np.clip(cosine, -1, 1)).max()))
        radius_error.append(np.abs(np.linalg.norm(vertices, axis=1) - 1).max())
    # C1: the angle between neighbouring triangles goes to zero; interpolation of a sphere of 42 points stays within 1 %
    assert (np.diff(turn) < 0).all()
    assert turn[-1] < 0.2 * turn[0]
    assert radius_error[-1] < 0.01


def test_refining_the_samples_of_a_sphere_converges():
    errors = []
    for level in (2, 3, 4):
        solid = trimesh.creation.icosphere(level)
        step = subdivide_butterfly(solid.faces, len(solid.vertices))
        errors.append(np.abs(np.linalg.norm(step.carry(np.array(solid.vertices)), axis=1) - 1).max())
    # second order: halving the edges leaves a quarter of the error
    assert errors[1] < 0.3 * errors[0]
    assert errors[2] < 0.3 * errors[1]


def test_a_part_is_split_without_cracks(head, front):
    chosen, step = front
    n = step.operator.shape[0]
    assert len(topology.non_manifold_edges(step.triangles)) == 0
    assert len(topology.non_manifold_vertices(step.triangles, n)) == 0
    assert topology.euler_characteristic(step.triangles) == topology.euler_characteristic(head.triangles)
    assert len(topology.boundary_loops(step.triangles)) == 1
    per_parent = np.bincount(step.parents, minlength=len(chosen))
    assert (per_parent[chosen] == 4).all()
    assert set(np.unique(per_parent[~chosen])) == {1, 2, 3}
    fine = step.carry(head.vertices)
    coarse_normal, normal = triangle_normals(head.vertices, head.triangles), triangle_normals(fine, step.triangles)
    assert (np.einsum("mk,mk->m", normal, coarse_normal[step.parents]) > 0).all()


def test_everything_a_model_has_is_carried(head, front, rng):
    _, step = front
    n, s = len(head.vertices), len(step.split_edges)
    basis = rng.normal(size=(2, n, 3))
    amounts = np.array([0.3, -2.0])
    together = step.carry(head.vertices + np.einsum("b,bnk->nk", amounts, basis))
    apart = step.carry(head.vertices) + np.einsum("b,bnk->nk", amounts, step.carry_basis(basis))
    assert np.allclose(together, apart, atol=1e-13)
    weights = step.carry_weights(rng.dirichlet([0.2, 0.2, 0.2], n))
    assert weights.shape == (n + s, 3)
    assert weights.min() >= 0
    assert np.allclose(weights.sum(axis=1), 1)
    mask = step.carry_mask(head.regions["face"])
    assert np.array_equal(mask[:n], head.regions["face"])
    fine_inside, coarse_inside = mask[step.triangles].all(axis=1), head.regions["face"][head.triangles].all(axis=1)
    assert fine_inside[coarse_inside[step.parents]].all()
    regressor = rng.normal(size=(2, n))
    assert np.allclose(step.carry_regressor(regressor) @ step.carry(head.vertices), regressor @ head.vertices)


def test_texture_keeps_its_place_and_its_seams(head, front):
    _, step = front
    uv, corners = step.carry_corners(head.triangles, head.uv, head.uv_triangles)
    assert corners.shape == step.triangles.shape

    def doubled_area(points, triangles):
        a, b, c = points[triangles].transpose(1, 0, 2)
        return (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]

    total = np.bincount(step.parents, doubled_area(uv, corners), len(head.triangles))
    assert np.allclose(total, doubled_area(head.uv, head.uv_triangles), atol=1e-15)
    old = step.triangles < len(head.vertices)
    known = set(zip(head.triangles.ravel().tolist(), head.uv_triangles.ravel().tolist(), strict=True))
    assert set(zip(step.triangles[old].tolist(), corners[old].tolist(), strict=True)) <= known


def test_a_mesh_that_is_not_manifold_is_refused():
    book = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    with pytest.raises(InputError, match="non-manifold"):
        subdivide_butterfly(book, 5)
