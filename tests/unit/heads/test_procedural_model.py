"""The procedural model moves like a head: weights are convex and smooth, the jaw opens the mouth, modes are ordered."""

import numpy as np
import pytest

from headcap.heads import HeadCoefficients, procedural_model
from headcap.heads.procedural import lip_pairs, mirror_partners
from headcap.meshes import topology


@pytest.fixture(scope="module")
def model():
    return procedural_model(dtype=np.float64)


def test_sizes_are_the_papers(model):
    assert 12_000 < len(model.vertices) < 14_500
    assert len(model.expression_basis) == 100
    assert len(model.pose_basis) == 18
    assert len(model.shape_basis) == 30


def test_weights_are_convex_symmetric_and_smooth(model):
    weights = model.skinning_weights
    assert weights.min() >= 0
    assert np.abs(weights.sum(axis=1) - 1).max() < 1e-12
    assert np.abs(weights - weights[mirror_partners()]).max() < 0.02
    edges = topology.mesh_edges(model.triangles).vertices
    length = np.linalg.norm(np.diff(model.vertices[edges], axis=1)[:, 0], axis=1)
    slope = np.abs(np.diff(weights[edges], axis=1)[:, 0]).max(axis=1) / length
    # a weight falls from one to zero over 10 mm at least, but at the mouth's corners
    corners = model.vertices[[model.landmarks["mouth_corner_left"], model.landmarks["mouth_corner_right"]]]
    away = np.min([np.linalg.norm(model.vertices[edges[:, 0]] - c, axis=1) for c in corners], axis=0) > 0.02
    mouth = model.regions["mouth_interior"] | model.regions["lips_inner"]
    assert slope[away & ~mouth[edges].any(axis=1)].max() < 1 / 0.010


def test_the_jaw_opens_the_mouth_and_leaves_the_rest(model):
    pose = np.zeros((2, 3))
    pose[1, 0] = 0.3
    moved = np.linalg.norm(model.evaluate(HeadCoefficients(pose=pose)) - model.vertices, axis=1)
    upper, lower = lip_pairs()[len(lip_pairs()) // 2]
    assert moved[upper] < 1e-3
    # the lip line is 0.11 m from the hinge: an arc of 33 mm
    assert moved[lower] == pytest.approx(0.3 * np.linalg.norm((model.vertices[lower] - model.joints()[1])[1:]), rel=0.05)
    # the skin behind the jaw's angle goes along; nothing from the ears up does
    assert moved[model.vertices[:, 1] > 0].max() < 1e-3
    assert moved[model.regions["ears"]].max() < 1.5e-3
    assert moved[model.vertices[:, 1] < model.vertices[:, 1].min() + 0.02].max() < 1e-3


def test_the_neck_turns_the_head_as_a_body_and_not_the_trunk(model):
    pose = np.zeros((2, 3))
    pose[0, 1] = 0.5
    posed = model.evaluate(HeadCoefficients(pose=pose))
    skull = model.regions["scalp"] & (model.vertices[:, 1] > 0)
    before = np.linalg.norm(model.vertices[skull] - model.vertices[skull][0], axis=1)
    after = np.linalg.norm(posed[skull] - posed[skull][0], axis=1)
    assert np.abs(after - before).max() < 5e-4
    bottom = np.unique(topology.boundary_loops(model.triangles)[0])
    assert np.linalg.norm(posed[bottom] - model.vertices[bottom], axis=1).max() < 2e-3


def test_modes_are_ordered_and_expressions_stay_in_the_face(model):
    for basis in (model.shape_basis, model.expression_basis):
        spread = (basis**2).sum(axis=(1, 2))
        assert spread[0] > 3 * spread[-1]
    moved = np.abs(model.expression_basis).max(axis=(0, 2)) > 0
    allowed = model.regions["face"] | model.regions["lips_inner"] | model.regions["mouth_interior"]
    assert not (moved & ~allowed).any()
    upper, lower = lip_pairs()[len(lip_pairs()) // 2]
    apart = np.abs(model.expression_basis[:, upper] - model.expression_basis[:, lower]).max()
    assert apart > 1e-3


def test_people_drawn_from_the_shape_basis_differ_by_millimetres(model, rng):
    people = model.identity(rng.normal(size=(40, 30)))
    spread = np.sqrt(((people - people.mean(axis=0)) ** 2).sum(axis=2).mean())
    assert 2e-3 < spread < 12e-3


def test_regions_of_the_neck_nest(model):
    regions = model.regions
    assert (regions["larynx"] <= regions["front_neck"]).all()
    assert (regions["front_neck"] <= regions["neck"]).all()
    assert (regions["larynx_boundary"] <= regions["larynx"]).all()
    assert not (regions["non_larynx"] & regions["larynx"]).any()
    assert ((regions["non_larynx"] | regions["larynx"]) == regions["neck"]).all()
    adjacency = topology.vertex_adjacency(model.triangles, len(model.vertices))
    interior = regions["larynx"] & ~regions["larynx_boundary"]
    assert not (topology.grow(interior, adjacency, 1) & ~regions["larynx"]).any()
    for name in ("lips_outer", "lips_inner", "face"):
        assert regions[name].sum() > 100
    assert np.flatnonzero(regions["larynx"]).tolist().count(model.landmarks["larynx"]) == 1
