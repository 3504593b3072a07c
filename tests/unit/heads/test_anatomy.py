"""What a head does not name is found on it: by its profile, by anchors, and in the right frame only."""

import dataclasses

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.heads import base_head, procedural_model
from headcap.heads.anatomy import find_anatomy, profile_landmarks
from headcap.heads.generic import JAW_JOINT_M, NECK_JOINT_M
from headcap.heads.refinement import refine_front
from headcap.heads.regions import with_neck_regions
from headcap.meshes import topology

CHECKED = ("face", "neck", "scalp", "ears", "lips_upper", "lips_lower", "lips_inner_upper", "lips_inner_lower")


@pytest.fixture(scope="module")
def model():
    return procedural_model(12, 3, np.float64)


def agreement(found: np.ndarray, wanted: np.ndarray) -> float:
    return (found & wanted).sum() / (found | wanted).sum()


def test_the_base_head_finds_its_own(model):
    base = base_head()
    anatomy = find_anatomy(base.vertices, base.triangles, {})
    for name in CHECKED:
        assert agreement(anatomy.regions[name], base.regions[name]) > 0.97, name
    assert np.allclose(anatomy.joints, [NECK_JOINT_M, JAW_JOINT_M], atol=1e-3)
    for name in ("nose_tip", "chin", "mouth_upper", "ear_top_left", "crown"):
        away = base.vertices[anatomy.landmarks[name]] - base.vertices[base.landmarks[name]]
        assert np.linalg.norm(away) < 2e-3, name


def test_another_person_is_understood_by_eight_anchors(model, rng):
    """A person drawn from the shape basis, a tenth larger and moved: the truth is the base head's own naming."""
    base = base_head()
    person = 1.1 * model.identity(rng.normal(size=12)) + [0.0, 0.05, -0.02]
    names = ("nose_tip", "chin", "mouth_corner_left", "mouth_corner_right", "eye_outer_left", "eye_outer_right",
             "lip_upper_top", "lip_lower_bottom", "crown", "back_of_head")  # fmt: skip
    anatomy = find_anatomy(person, base.triangles, {name: base.landmarks[name] for name in names})
    for name in CHECKED:
        # a narrow band such as a lip is a few vertices wide
        assert agreement(anatomy.regions[name], base.regions[name]) > (0.6 if "lips" in name else 0.85), name
    truth = model.joint_regressor @ person
    assert np.linalg.norm(anatomy.joints - truth, axis=1).max() < 0.015
    assert np.linalg.norm(person[anatomy.landmarks["larynx"]] - person[base.landmarks["larynx"]]) < 0.015


def test_known_regions_stand(model):
    base = base_head()
    face = base.regions["face"] & (base.vertices[:, 1] < 0.03)
    anatomy = find_anatomy(base.vertices, base.triangles, {}, {"face": face})
    assert np.array_equal(anatomy.regions["face"], face)
    assert not (anatomy.regions["scalp"] & face).any()


def test_another_frame_is_refused():
    base = base_head()
    with pytest.raises(InputError, match="a mesh 264 m wide"):
        profile_landmarks(1e3 * base.vertices)
    with pytest.raises(InputError, match="midline"):
        profile_landmarks(base.vertices + np.array([0.5, 0, 0]))
    with pytest.raises(InputError, match="no skin on the front of its neck"):
        find_anatomy(base.vertices, base.triangles, {}, {"neck": np.zeros(len(base.vertices), bool)})
    with pytest.raises(InputError, match="0 vertices of the front of the neck"):
        with_neck_regions(base.vertices, base.triangles, base.regions, np.array([0, 0.5, 0]), np.array(NECK_JOINT_M))


def test_refinement_comes_near_any_wanted_size(model):
    # the front neck, which is always split, has 4 thousand edges; all of the head would come out at 51 thousand vertices
    for wanted in (18_000, 30_000):
        finer = refine_front(model, wanted)
        assert len(finer.vertices) <= wanted
        assert len(finer.vertices) > 0.97 * wanted
        assert len(topology.non_manifold_edges(finer.triangles)) == 0
    assert refine_front(model, 13_000) is model


def test_the_larynx_region_is_made_anew_on_the_finer_mesh(model):
    finer = refine_front(model, 20_000)
    regions = finer.regions
    adjacency = topology.vertex_adjacency(finer.triangles, len(finer.vertices))
    border = regions["larynx"] & topology.grow(~regions["larynx"], adjacency, 1)
    assert np.array_equal(border, regions["larynx_boundary"])
    edge = finer.vertices[regions["larynx"]]
    before = model.vertices[model.regions["larynx"]]
    assert np.abs(np.ptp(edge, axis=0) - np.ptp(before, axis=0)).max() < 0.008
    assert dataclasses.replace(finer, name="again").topology_digest == finer.topology_digest != model.topology_digest
