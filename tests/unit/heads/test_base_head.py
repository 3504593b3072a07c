"""The base head is one symmetric manifold skin of human size with a mouth that opens, and a usable atlas."""

import numpy as np
import pytest

from headcap.heads import base_head
from headcap.heads.procedural import eye_rims, lip_pairs, mirror_partners
from headcap.heads.sculpt import head_field
from headcap.meshes import topology
from headcap.meshes.rasteriser import rasterise_pixels


@pytest.fixture(scope="module")
def head():
    return base_head()


def test_is_one_manifold_disc_open_at_the_bottom_only(head):
    n = len(head.vertices)
    assert 11_000 < n < 15_000
    assert len(np.unique(head.triangles)) == n
    assert topology.vertex_components(head.triangles, n).max() == 0
    assert topology.euler_characteristic(head.triangles) == 1
    assert len(topology.non_manifold_edges(head.triangles)) == 0
    assert len(topology.non_manifold_vertices(head.triangles, n)) == 0
    (bottom,) = topology.boundary_loops(head.triangles)
    np.testing.assert_allclose(head.vertices[bottom, 1], head.vertices[:, 1].min(), atol=1e-9)


def test_is_symmetric_to_the_last_bit(head):
    partner = mirror_partners()
    np.testing.assert_array_equal(head.vertices[partner], head.vertices * [-1, 1, 1])
    here = {tuple(sorted(t)) for t in head.triangles.tolist()}
    assert {tuple(sorted(t)) for t in partner[head.triangles].tolist()} == here


def test_has_human_proportions(head):
    place = {name: 1e3 * head.vertices[v] for name, v in head.landmarks.items()}
    # adult means plus or minus two standard deviations, millimetres
    assert 210 < place["crown"][1] - place["menton"][1] < 250
    assert 45 < place["mouth_corner_left"][0] - place["mouth_corner_right"][0] < 56
    scalp = head.vertices[head.regions["scalp"]]
    assert 0.14 < np.ptp(scalp[:, 0]) < 0.17
    pupils = np.abs(head.vertices[head.regions["eyes"], 0]).mean() * 2e3
    assert 58 < pupils < 68
    assert place["nose_tip"][2] == pytest.approx(1e3 * head.vertices[:, 2].max())
    assert place["nose_tip"][2] - place["subnasale"][2] > 12


def test_lips_part_along_a_slit(head):
    pairs = lip_pairs()
    assert (pairs[0, 0], pairs[-1, 0]) == (pairs[0, 1], pairs[-1, 1])
    upper, lower = pairs[1:-1].T
    assert len(np.intersect1d(upper, lower)) == 0
    assert (head.vertices[upper, 1] > head.vertices[lower, 1]).all()
    adjacency = topology.vertex_adjacency(head.triangles, len(head.vertices))
    assert adjacency[np.ix_(upper, lower)].nnz == 0
    # a way from one lip to the other leads round the corner or round the back of the pocket, never across
    reach = np.zeros(len(head.vertices), bool)
    reach[upper[len(upper) // 2]] = True
    assert not topology.grow(reach, adjacency, 8)[lower[len(lower) // 2]]


def test_skin_lies_on_the_sculpted_surface(head):
    off = ~(
        head.regions["eyes"]
        | head.regions["mouth_interior"]
        | head.regions["lips_inner_upper"]
        | head.regions["lips_inner_lower"]
    )
    # the field is only nearly a distance: its gradient is 1 to within a factor of two, so 0.05 is under 0.1 mm
    assert np.quantile(np.abs(head_field(1e3 * head.vertices[off])), 0.99) < 0.05


def test_triangles_are_fine_in_the_face_and_never_slivers(head):
    corners = head.vertices[head.triangles]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    quality = 4 * np.sqrt(3) * area / (edges**2).sum(1)
    assert np.quantile(quality, 0.01) > 0.5
    lips = (head.regions["lips_upper"] | head.regions["lips_lower"])[head.triangles].all(1)
    scalp = head.regions["scalp"][head.triangles].all(1)
    assert np.median(edges[lips]) < 2.6e-3 < 4.5e-3 < np.median(edges[scalp])


def test_atlas_has_no_flip_and_no_overlap(head):
    uv = head.uv[head.uv_triangles]
    a, b = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = 0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    assert (area > 0).all() or (area < 0).all()
    assert head.uv.min() >= 0
    assert head.uv.max() <= 1
    size = 1024
    covered = rasterise_pixels(head.uv * size - 0.5, np.ones(len(head.uv)), head.uv_triangles, (size, size)).hit.mean()
    # texels are counted once, triangles' areas add up: what overlaps is counted twice in the second
    assert covered == pytest.approx(np.abs(area).sum(), rel=0.01)
    face = head.regions["face"][head.triangles].all(1)
    space = head.vertices[head.triangles]
    surface = np.linalg.norm(np.cross(space[:, 1] - space[:, 0], space[:, 2] - space[:, 0]), axis=1)
    density = np.abs(area) / surface
    # a texture of 2048 texels must not show less than the rig's photographs do, 0.375 mm per pixel on the face
    assert 1 / (2048 * np.sqrt(np.median(density[face]))) < 0.375e-3
    # and no texels are spent on the scalp at the face's cost: it has fewer, and no part of the face starves
    assert np.median(density[head.regions["scalp"][head.triangles].all(1)]) < np.median(density[face])
    assert np.quantile(density[face], 0.01) > 0.5 * np.median(density[face])


def test_regions_part_the_head(head):
    names = ("face", "neck", "scalp", "ears", "eyes", "mouth_interior")
    total = sum(head.regions[name].astype(int) for name in names)
    rolled = head.regions["lips_inner_upper"] | head.regions["lips_inner_lower"]
    assert (total <= 1).all()
    assert ((total == 1) | rolled).all()
    assert (head.regions["larynx"] <= head.regions["neck"]).all()
    corners = {head.landmarks["mouth_corner_left"], head.landmarks["mouth_corner_right"]}
    for kind in ("lips", "lips_inner"):
        both = head.regions[f"{kind}_upper"] & head.regions[f"{kind}_lower"]
        assert set(np.flatnonzero(both)) <= corners


def test_eye_rims_are_closed_rings_around_the_eyes(head):
    adjacency = topology.vertex_adjacency(head.triangles, len(head.vertices))
    for ring in eye_rims():
        assert all(adjacency[a, b] for a, b in zip(ring, np.roll(ring, -1), strict=True))
    assert not head.regions["eyes"][eye_rims()].any()
    assert set(np.flatnonzero(head.regions["lid_rims"])) == set(eye_rims().ravel())
