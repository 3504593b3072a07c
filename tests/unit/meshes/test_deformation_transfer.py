"""Laws of deformation transfer: it reproduces the source on the source, commutes with motions, and knows a least-squares peer."""

import numpy as np
import pytest
import trimesh

from headcap.errors import InputError
from headcap.geometry.rotations import rotation_matrices
from headcap.meshes.deformation_transfer import DeformationTransfer


def ball(seed: int, amount: float) -> tuple[np.ndarray, np.ndarray]:
    """A lumpy ball and its triangles."""
    random = np.random.default_rng(seed)
    sphere = trimesh.creation.icosphere(2, radius=0.1)
    return sphere.vertices + amount * random.normal(size=sphere.vertices.shape), np.asarray(sphere.faces)


def bent(vertices: np.ndarray) -> np.ndarray:
    """A strong smooth deformation: twisted by 2 rad from end to end, swollen."""
    angle = 10.0 * vertices[:, 2]
    turns = rotation_matrices(np.stack([0 * angle, 0 * angle, angle], axis=1))
    return np.einsum("nij,nj->ni", turns, vertices) * (1.0 + 2.0 * vertices[:, :1])


@pytest.fixture(scope="module")
def source():
    return ball(1, 0.002)


@pytest.fixture(scope="module")
def target():
    return ball(2, 0.004)[0] * [1.4, 0.8, 1.1] + [0.3, 0.0, -0.1]


def test_reproduces_the_source_on_the_source(source):
    vertices, triangles = source
    moved = bent(vertices) + np.array([0.5, 0.0, 0.2])
    assert DeformationTransfer(vertices, vertices, triangles)(moved) == pytest.approx(moved, abs=1e-12)


def test_an_undeformed_source_leaves_the_target(source, target):
    transfer = DeformationTransfer(source[0], target, source[1])
    assert transfer(source[0]) == pytest.approx(target, abs=1e-12)


def test_commutes_with_rigid_motion_at_any_angle(source, target):
    vertices, triangles = source
    transfer = DeformationTransfer(vertices, target, triangles, anchors=vertices[:, 1] < -0.05)
    moved = bent(vertices)
    for vector in ([0.3, -0.2, 0.1], [np.pi, 0.0, 0.0], [0.0, 2.9, 1.0]):
        turn, shift = rotation_matrices(np.array(vector)), np.array([0.2, -0.4, 1.0])
        assert transfer(moved @ turn.T + shift) == pytest.approx(transfer(moved) @ turn.T + shift, abs=1e-11)


def test_an_affine_map_of_the_source_is_one_of_the_target_within_the_surface(source, target):
    """S is the map along the surface; across it Sumner's normal scales its own way, so only maps of similarity are exact."""
    vertices, triangles = source
    similar = 1.3 * vertices @ rotation_matrices(np.array([0.4, 1.2, -0.3])).T
    found = DeformationTransfer(vertices, target, triangles)(similar)
    expected = 1.3 * target @ rotation_matrices(np.array([0.4, 1.2, -0.3])).T
    # the normal n / sqrt|n| scales as lengths do: exact
    assert found - found.mean(0) == pytest.approx(expected - expected.mean(0), abs=1e-12)


def test_is_the_least_squares_solution_with_free_fourth_vertices(source, target):
    """The eliminated Poisson equation against the dense system of eq. 8 over vertices and fourth vertices."""
    triangles = source[1][:60]
    used, compact = np.unique(triangles, return_inverse=True)
    triangles, start, aim = compact.reshape(-1, 3), source[0][used], target[used]
    moved = bent(start)
    transfer = DeformationTransfer(start, aim, triangles)
    gradients = transfer.gradients(moved)
    n, m = len(aim), len(triangles)
    corners = aim[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = 0.5 * np.linalg.norm(normal, axis=1)
    frames = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], normal], axis=-1)
    inverse = np.linalg.inv(frames)
    rows, right = np.zeros((3 * m, n + m)), np.zeros((3 * m, 3))
    for f in range(m):
        # T^T = inverse^T [edges; fourth]
        for k, vertex in enumerate([triangles[f, 1], triangles[f, 2], n + f]):
            rows[3 * f : 3 * f + 3, vertex] += np.sqrt(area[f]) * inverse[f, k]
            rows[3 * f : 3 * f + 3, triangles[f, 0]] -= np.sqrt(area[f]) * inverse[f, k]
        right[3 * f : 3 * f + 3] = np.sqrt(area[f]) * gradients[f].T
    expected = np.linalg.lstsq(rows, right, rcond=None)[0][:n]
    found = transfer(moved)
    assert found - found.mean(0) == pytest.approx(expected - expected.mean(0), abs=1e-9)


def test_two_pieces_stay_where_they_belong(source, target):
    vertices, triangles = source
    pair = np.concatenate([vertices, vertices + np.array([0.5, 0.0, 0.0])])
    both = np.concatenate([triangles, triangles + len(vertices)])
    aims = np.concatenate([target, target + np.array([0.5, 0.0, 0.0])])
    moved = pair.copy()
    moved[len(vertices) :] += [0.0, 0.03, 0.0]
    found = DeformationTransfer(pair, aims, both)(moved)
    assert found[: len(vertices)] == pytest.approx(target, abs=1e-12)
    assert found[len(vertices) :] == pytest.approx(aims[len(vertices) :] + np.array([0.0, 0.03, 0.0]), abs=1e-12)


def test_still_anchors_hold_the_target_still(source, target):
    vertices, triangles = source
    anchors = vertices[:, 1] < -0.04
    moved = np.where((vertices[:, 1] > 0.02)[:, None], 1.3 * vertices, vertices)
    found = DeformationTransfer(vertices, target, triangles, anchors)(moved)
    assert found[anchors].mean(0) == pytest.approx(target[anchors].mean(0), abs=1e-3)
    assert np.abs(found - target).max() > 0.01


def test_refuses_what_it_cannot_carry(source, target):
    vertices, triangles = source
    with pytest.raises(InputError, match="shapes"):
        DeformationTransfer(vertices[:-1], target, triangles)
    flat = vertices.copy()
    flat[triangles[0, 1]] = flat[triangles[0, 0]]
    with pytest.raises(InputError, match="no area"):
        DeformationTransfer(flat, target, triangles)
    with pytest.raises(InputError, match="without a triangle"):
        DeformationTransfer(vertices, target, triangles[20:][~(triangles[20:] == triangles[0, 0]).any(1)])
