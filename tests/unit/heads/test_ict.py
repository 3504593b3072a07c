"""An ICT-FaceKit head as a model."""

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.heads import HeadCoefficients, load_ict
from headcap.meshes import topology


@pytest.fixture(scope="module")
def model(test_data):
    return load_ict(test_data / "ict_head")


@pytest.mark.real
def test_is_the_skin_at_the_model_s_size(model):
    assert 12_500 < len(model.vertices) < 14_000
    assert topology.vertex_components(model.triangles, len(model.vertices)).max() == 0
    assert len(topology.non_manifold_edges(model.triangles)) == 0
    # neck, mouth and both eyes are open
    assert len(topology.boundary_loops(model.triangles)) == 4
    assert len(model.shape_basis) == 80
    assert "jawOpen" in model.expression_names
    assert len(model.expression_basis) == len(model.expression_names) == 53


@pytest.mark.real
def test_named_expressions_are_the_file_s(model, test_data):
    with np.load(test_data / "ict_head" / "ict_head.npz") as file:
        k = model.expression_names.index("mouthSmile_L")
        truth = file["vertices_m"] + file["expressions_m"][k].astype(float)
    psi = np.zeros(53)
    psi[k] = 1.0
    found = model.evaluate(HeadCoefficients(expression=psi))
    # the skin's vertices come first and stay in place when others are put between them; the file is in half precision
    assert np.abs(found[:11_248] - truth[:11_248]).max() < 1e-6


@pytest.mark.real
def test_lips_part_when_the_jaw_turns(model):
    pose = np.zeros((2, 3))
    pose[1, 0] = 0.25
    moved = np.linalg.norm(model.evaluate(HeadCoefficients(pose=pose)) - model.vertices, axis=1)
    assert moved[model.landmarks["mouth_upper"]] < 2e-3
    assert moved[model.landmarks["mouth_lower"]] > 0.018
    for upper, lower in (("lips_upper", "lips_lower"), ("lips_inner_upper", "lips_inner_lower")):
        assert np.median(moved[model.regions[lower]]) > 5 * np.median(moved[model.regions[upper]])


@pytest.mark.real
def test_the_larynx_of_a_head_made_from_it_lies_in_the_region(model, test_data):
    """The recorded subject is an ICT head with a larynx of known place, somewhat turned: within two centimetres."""
    with np.load(test_data / "ict_rig" / "truth" / "topology.npz") as truth:
        away = np.linalg.norm(model.vertices[model.regions["larynx"]] - truth["larynx0_m"], axis=1)
    assert away.min() < 0.02


def test_what_is_no_head_is_refused(tmp_path):
    with pytest.raises(InputError, match="no file"):
        load_ict(tmp_path)
    np.savez(tmp_path / "ict_head.npz", faces=np.zeros((2, 4), int))
    with pytest.raises(InputError, match="lacks vertices_m"):
        load_ict(tmp_path)
    (tmp_path / "ict_head.npz").write_bytes(b"nothing")
    with pytest.raises(InputError, match="cannot be read"):
        load_ict(tmp_path)
