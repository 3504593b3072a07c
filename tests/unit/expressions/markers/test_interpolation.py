"""Interpolation over the face: exact at markers, blind to nothing, lips apart that touch; and ties of markers to the mesh."""

import json

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from headcap.errors import InputError
from headcap.expressions.markers import MarkerSettings
from headcap.expressions.markers.interpolation import interpolation_matrix
from headcap.expressions.markers.tying import tie_markers
from headcap.geometry.transforms import from_vector, transform
from headcap.heads.procedural import lip_pairs
from headcap.meshes.closest_point import Surface
from headcap.registration.graph import edge_graph

SETTINGS = MarkerSettings()


def at_vertices(vertices, count):
    return sparse.csr_array((np.ones(len(vertices)), (np.arange(len(vertices)), vertices)), shape=(len(vertices), count))


@pytest.fixture(scope="module")
def matrix(person):
    return interpolation_matrix(person.head.vertices, person.head.triangles, at_vertices(person.face, len(person.head.vertices)))


def plain_distance(vertices, places):
    """The peer (n, k): -r of plain distance with a constant, the kernel of space."""

    def kernel(points):
        return -np.linalg.norm(points[:, None] - places[None], axis=2)

    k = len(places)
    system = np.block([[kernel(places), np.ones((k, 1))], [np.ones((1, k)), np.zeros((1, 1))]])
    return np.linalg.solve(system, np.column_stack([kernel(vertices), np.ones(len(vertices))]).T).T[:, :k]


def euclidean_matrix(person):
    return plain_distance(person.head.vertices, person.head.vertices[person.face])


def rms_mm(matrix, person, mask):
    found = np.einsum("nk,fkc->fnc", matrix[mask], person.displacements[:, person.face])
    return 1e3 * np.sqrt(((found - person.displacements[:, mask]) ** 2).sum(axis=2).mean())


def test_markers_keep_their_displacement_and_common_motion_is_common(person, matrix, rng):
    np.testing.assert_allclose(matrix[person.face], np.eye(len(person.face)), atol=1e-9)
    # the energy of a constant is zero but for the condition of the bilaplacian
    np.testing.assert_allclose(matrix.sum(axis=1), 1, atol=1e-6)


def test_markers_inside_triangles_keep_theirs_too(person, rng):
    chosen = rng.choice(np.flatnonzero(person.head.regions["face"][person.head.triangles].all(axis=1)), 20, replace=False)
    shares = rng.dirichlet(np.ones(3), 20)
    columns = person.head.triangles[chosen].ravel()
    places = sparse.csr_array((shares.ravel(), (np.repeat(np.arange(20), 3), columns)), shape=(20, len(person.head.vertices)))
    matrix = interpolation_matrix(person.head.vertices, person.head.triangles, places)
    np.testing.assert_allclose(places @ matrix, np.eye(20), atol=1e-9)


def test_the_face_is_true_to_half_a_millimetre_with_66_markers(person, matrix):
    face = person.head.regions["face"]
    moved_mm = 1e3 * np.sqrt((person.displacements[:, face] ** 2).sum(axis=2).mean())
    assert moved_mm > 3
    assert rms_mm(matrix, person, face) < 0.5
    assert rms_mm(matrix, person, person.lips) < 1.0
    # lips that touch at rest: plain distance lets them drag each other
    assert rms_mm(matrix, person, person.lips) < 0.4 * rms_mm(euclidean_matrix(person), person, person.lips)


def test_a_lower_lip_that_moves_leaves_the_upper_one_where_it_rests(person, matrix):
    upper, lower = lip_pairs()[5:-5].T
    vertices, regions = person.head.vertices, person.head.regions
    assert 1e3 * np.linalg.norm(vertices[upper] - vertices[lower], axis=1).max() < 1.0
    low = regions["lips_lower"] | (vertices[:, 1] < vertices[lower, 1].min() - 0.005)
    # the corners are both lips': they rest
    corners = [person.head.landmarks["mouth_corner_left"], person.head.landmarks["mouth_corner_right"]]
    low[corners] = False
    drop = np.where(low[person.face], 1.0, 0.0)
    found, plain = matrix @ drop, euclidean_matrix(person) @ drop
    assert np.abs(found[upper]).max() < 0.2
    # from the resting corners to the middle, above the moving marker of the lower lip, the lower side goes from 0 to 1
    middle = np.abs(vertices[lower, 0]).argmin()
    assert found[lower[middle]] > 0.8
    # what plain distance gives: both sides of the seam go together
    assert np.abs(plain[upper] - plain[lower]).max() < 0.2
    assert plain[upper[middle]] > 0.3


def test_pieces_without_a_marker_stay(person):
    vertices, triangles = person.head.vertices, person.head.triangles
    eye = np.array([[0.03, 0.02, 0.07], [0.04, 0.02, 0.07], [0.03, 0.03, 0.07]])
    both = np.vstack([vertices, eye])
    more = np.vstack([triangles, [[len(vertices), len(vertices) + 1, len(vertices) + 2]]])
    matrix = interpolation_matrix(both, more, at_vertices(person.face[:8], len(both)))
    assert not matrix[len(vertices) :].any()
    np.testing.assert_allclose(matrix[: len(vertices)].sum(axis=1), 1, atol=1e-6)


@pytest.mark.parametrize("region", [True, False])
def test_markers_find_their_places_on_the_mesh_from_any_attitude(person, rng, region):
    at_rest = person.head_positions[0, 7:]
    skin = person.head.regions["face"] if region else None
    moved = from_vector(np.concatenate([2 * rng.normal(size=3), rng.normal(size=3)]))
    ties = tie_markers(
        person.take.names[7:], transform(moved, at_rest), person.head.vertices, person.head.triangles, SETTINGS, region=skin
    )
    placed = transform(ties.mesh_from_head @ moved, at_rest)
    # the placement slides along the skin by what 66 tangent planes leave open
    assert np.linalg.norm(placed - at_rest, axis=1).max() < 0.5e-3
    # in creases, where a marker's foot is not the vertex it was raised from, a foot moves more than its marker: twice is allowed
    feet = Surface(person.head.vertices, person.head.triangles).closest(at_rest).points
    assert np.linalg.norm(ties.marker_from_vertex @ person.head.vertices - feet, axis=1).max() < 1e-3
    # markers stand 3 mm off the skin
    assert ties.distance_mm == pytest.approx(3, abs=0.5)


def test_given_vertices_hold_and_place_the_rest(person, tmp_path):
    names = person.take.names[7:]
    given = {names[k]: int(person.face[k]) for k in (0, 1, 2, 5, 6)}
    (tmp_path / "ties.json").write_text(json.dumps(given))
    # on the skin the given vertices place all markers exactly
    at_rest = transform(from_vector(np.array([0.4, -1, 2, 0.3, 0.1, 0])), person.head.vertices[person.face])
    ties = tie_markers(names, at_rest, person.head.vertices, person.head.triangles, SETTINGS, given=tmp_path / "ties.json")
    assert ties.distance_mm.max() < 1e-6
    np.testing.assert_allclose(ties.marker_from_vertex @ person.head.vertices, person.head.vertices[person.face], atol=1e-9)
    rows = ties.marker_from_vertex.toarray()
    assert all(rows[names.index(name), vertex] == 1 for name, vertex in given.items())


def test_ties_that_cannot_be_are_refused(person, tmp_path):
    names, rest = person.take.names[7:], person.head_positions[0, 7:]
    mesh = person.head.vertices, person.head.triangles

    def tie(positions=rest, **how):
        return tie_markers(names, positions, *mesh, SETTINGS, **how)

    with pytest.raises(InputError, match=r"of which nose are not in the take"):
        tie(given={"m0": 1, "m1": 2, "nose": 3})
    with pytest.raises(InputError, match="vertices of 2 markers"):
        tie(given={"m0": 1, "m1": 2})
    with pytest.raises(InputError, match="m2 lie beyond the mesh's"):
        tie(given={"m0": 1, "m1": 2, "m2": 10**6})
    (tmp_path / "ties.json").write_text("[1, 2]")
    with pytest.raises(InputError, match=r"ties\.json"):
        tie(given=tmp_path / "ties.json")
    given = {names[k]: int(person.face[k]) for k in range(5)}
    off = rest.copy()
    off[40] += [0, 0, 0.03]
    with pytest.raises(InputError, match=r"1 markers lie off the neutral mesh: m40 \d\d mm"):
        tie(off, given=given)
    with pytest.raises(InputError, match="tied to one place"):
        tie(given=given | {names[30]: given["m3"]}, positions=np.vstack([rest[:30], rest[3:4], rest[31:]]))


def test_a_placement_that_is_not_told_is_refused(small_take):
    vertices, triangles = small_take.neutral, small_take.triangles
    # an egg's ring fits as well after half a turn
    ring = vertices[(vertices[:, 1] > 0.0) & (vertices[:, 1] < 0.03)]
    with pytest.raises(InputError, match="markers fit the mesh in"):
        tie_markers(tuple(f"m{k}" for k in range(len(ring))), ring, vertices, triangles, SETTINGS)


@pytest.mark.real
def test_a_real_sculpted_face_is_interpolated_better_than_by_plain_distance(test_data):
    file, clip = np.load(test_data / "ict_head/ict_head.npz"), np.load(test_data / "ict_rig/truth/expression_01.npz")
    skin = int(file["head_neck_vertices"][1])
    faces = file["faces"][(file["faces"] < skin).all(axis=1)]
    quads = faces[faces[:, 3] >= 0]
    triangles = np.concatenate([faces[:, :3], quads[:, [0, 2, 3]]]).astype(np.int32)
    vertices = file["vertices_m"][:skin].astype(float)
    displacements = np.einsum("fk,knc->fnc", clip["blend_weights"][::4], file["expressions_m"][:, :skin])
    landmarks = file["landmarks68"].astype(int)
    graph = edge_graph(vertices, triangles)
    outline, inner = (
        dijkstra(graph, indices=landmarks[48:60], min_only=True),
        dijkstra(graph, indices=landmarks[60:], min_only=True),
    )
    density = 1 + 1.5 * np.exp(-((outline / 0.02) ** 2))
    face = (np.arange(skin) < file["face_vertices"][1]) & (np.abs(displacements).max(axis=(0, 2)) > 5e-4)
    markers = list(landmarks[[30, 48, 54, 51, 57, 8, 27]])
    nearest = dijkstra(graph, indices=markers, min_only=True)
    while len(markers) < 66:
        markers.append(int(np.argmax(np.where(face & (inner > 0.005) & (vertices[:, 2] > 0), nearest * density, -1))))
        nearest = np.minimum(nearest, dijkstra(graph, indices=markers[-1]))
    lips = np.minimum(outline, inner) < 0.008
    ours = interpolation_matrix(vertices, triangles, at_vertices(np.array(markers), skin))
    errors = {}
    for name, matrix in (("ours", ours), ("plain", plain_distance(vertices, vertices[markers]))):
        found = np.einsum("nk,fkc->fnc", matrix, displacements[:, markers])
        squared = ((found - displacements) ** 2).sum(axis=2)
        errors[name] = np.sqrt(squared[:, face].mean()), np.sqrt(squared[:, lips].mean())
    moved = np.sqrt((displacements[:, lips] ** 2).sum(axis=2).mean())
    assert errors["ours"][0] < 0.75 * errors["plain"][0]
    assert errors["ours"][1] < 0.6 * errors["plain"][1]
    assert errors["ours"][1] < 0.25 * moved
