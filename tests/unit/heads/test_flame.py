"""FLAME's file becomes the paper's model: eyeballs gone, face and neck finer, two joints; and no pickle runs anything."""

import pickle

import numpy as np
import pytest
from scipy import sparse

from headcap.errors import InputError
from headcap.heads import FlameSettings, HeadCoefficients, load_flame
from headcap.heads.safe_pickle import load_pickled_arrays
from headcap.meshes import topology
from headcap.neck import build_chart


@pytest.fixture(scope="module")
def model(flame_pickle):
    return load_flame(flame_pickle)


@pytest.fixture(scope="module")
def coarse(flame_pickle):
    return load_flame(flame_pickle, settings=FlameSettings(wanted_vertices=0))


def test_the_pickle_is_read_as_it_was_written(flame_pickle, flame_arrays):
    found = load_pickled_arrays(flame_pickle)
    assert set(found) == set(flame_arrays)
    for key, expected in flame_arrays.items():
        assert np.array_equal(found[key], expected), key


def test_eyeballs_go_and_the_paper_s_size_comes_out(model, coarse, flame_arrays):
    eyeballs = 2 * 162
    assert len(coarse.vertices) == len(flame_arrays["v_template"]) - eyeballs
    assert topology.vertex_components(coarse.triangles, len(coarse.vertices)).max() == 0
    assert 12_500 < len(model.vertices) < 13_900
    assert len(topology.non_manifold_edges(model.triangles)) == 0
    assert topology.euler_characteristic(model.triangles) == topology.euler_characteristic(coarse.triangles)
    assert (len(model.shape_basis), len(model.expression_basis), len(model.pose_basis)) == (300, 100, 18)
    assert model.vertices.dtype == np.float32


def test_what_stays_moves_as_flame_does(coarse, flame_arrays, rng):
    """FLAME's own formula with eyes at rest, on the vertices that stay."""
    shape, expression = np.zeros(300), np.zeros(100)
    shape[:4], expression[:3] = rng.normal(size=4), rng.normal(size=3)
    pose = rng.normal(0, 0.2, (2, 3))
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_rotvec(pose).as_matrix()
    a = flame_arrays
    neutral = a["v_template"] + a["shapedirs"][:, :, :300] @ shape
    joints = a["J_regressor"] @ neutral
    rest = neutral + a["shapedirs"][:, :, 300:] @ expression
    rest = rest + a["posedirs"] @ np.concatenate([(turns - np.eye(3)).ravel(), np.zeros(18)])
    neck = (rest - joints[1]) @ turns[0].T + joints[1]
    jaw = ((rest - joints[2]) @ turns[1].T + joints[2] - joints[1]) @ turns[0].T + joints[1]
    bones = np.stack([rest, neck, jaw, neck, neck])  # the eyes' bones hang on the neck
    expected = np.einsum("nb,bnk->nk", a["weights"], bones)
    found = coarse.evaluate(HeadCoefficients(shape=shape, expression=expression, pose=pose))
    kept = np.arange(len(a["v_template"]) - 2 * 162)
    # the neck's joint lost one of the 61 vertices it was regressed from, a hundredth of it: micrometres under random shapes;
    # the rest is float32
    assert np.abs(found - expected[kept]).max() < 5e-5
    assert np.allclose(coarse.joints(), (a["J_regressor"] @ a["v_template"])[1:3], atol=1e-6)


def test_face_and_front_neck_are_finer_and_the_back_is_not(model, coarse):
    assert model.regions["front_neck"].sum() > 3.5 * coarse.regions["front_neck"].sum()
    assert model.regions["face"].sum() > 3.5 * coarse.regions["face"].sum()
    # what is left as it was faces away
    kept = np.isin(model.triangles, np.arange(len(coarse.vertices))).all(axis=1)
    whole = model.vertices[model.triangles[kept]].mean(axis=1)
    assert kept.sum() > 200
    assert whole[:, 2].max() < -0.02
    assert model.regions["larynx"].sum() > 300
    assert model.evaluate(HeadCoefficients()).shape == model.vertices.shape


def test_its_neck_can_be_laid_out(model):
    chart = build_chart(model)
    assert chart.distortion.flipped == 0
    assert chart.distortion.mean_stretch < 0.04
    assert np.isin(np.flatnonzero(model.regions["larynx"]), chart.vertices).all()


def test_landmarks_come_from_the_profile(model):
    from headcap.heads import base_head

    base = base_head()
    for name in ("nose_tip", "chin", "crown", "larynx", "mouth_upper"):
        away = np.linalg.norm(model.vertices[model.landmarks[name]] - base.vertices[base.landmarks[name]])
        assert away < 0.008, name


def test_npz_and_masks_and_texture(flame_arrays, model, tmp_path):
    np.savez(tmp_path / "flame.npz", **flame_arrays)
    vertices = flame_arrays["v_template"]
    n, skin = len(vertices), np.arange(len(vertices) - 2 * 162)
    lips = skin[np.linalg.norm((vertices[skin] - [0, -0.068, 0.1]) / [0.026, 0.011, 0.03], axis=1) < 1]
    neck = skin[vertices[skin, 1] < -0.125]
    masks = {"neck": neck, "face": skin[vertices[skin, 2] > 0.0], "lips": lips, "scalp": skin[vertices[skin, 1] > 0.07]}
    (tmp_path / "masks.pkl").write_bytes(pickle.dumps(masks, protocol=2))
    uv = np.random.default_rng(0).uniform(size=(n, 2))
    np.savez(tmp_path / "texture.npz", vt=uv, ft=flame_arrays["f"])
    settings = FlameSettings(wanted_vertices=0, shapes=10, expressions=5)
    full = load_flame(tmp_path / "flame.npz", masks=tmp_path / "masks.pkl", texture=tmp_path / "texture.npz", settings=settings)
    assert np.array_equal(np.flatnonzero(full.regions["neck"]), neck)
    assert len(full.shape_basis) == 10
    assert full.template().uv.shape == (n, 2)
    assert np.allclose(full.uv[full.uv_triangles[5]], (uv * [1, -1] + [0, 1])[flame_arrays["f"][5]])
    assert full.regions["lips_outer"].sum() > 10
    with pytest.raises(InputError, match="texture coordinates"):
        model.template()


def _with_marker(tmp_path, make):
    marker = tmp_path / "ran"
    path = tmp_path / "evil.pkl"
    path.write_bytes(make(f"touch {marker}"))
    return path, marker


class _Runs:
    def __init__(self, function, *args):
        self.call = (function, args)

    def __reduce__(self):
        return self.call


def test_a_malicious_pickle_does_not_run(tmp_path, flame_arrays):
    import os
    import subprocess

    small = {"v_template": np.zeros((2, 3))}
    cases = {
        "posix.system": lambda command: pickle.dumps(small | {"f": _Runs(os.system, command)}, protocol=2),
        "eval": lambda command: pickle.dumps(_Runs(eval, f"__import__('os').system({command!r})"), protocol=2),
        "subprocess.Popen": lambda command: pickle.dumps([_Runs(subprocess.Popen, command.split())], protocol=4),
        "numpy.load": lambda command: b"cnumpy\nload\n(S'x'\ntR.",
        "chumpy.ch.os.system": lambda command: b"cchumpy.ch\nos.system\n(S'" + command.encode() + b"'\ntR.",
        "scipy.sparse.linalg.eigsh": lambda command: b"cscipy.sparse.linalg\neigsh\n.",
        "an object built": lambda command: b"ccopy_reg\n_reconstructor\n(c__builtin__\nobject\nc__builtin__\nset\nNtR.",
        "outside object": lambda command: b"Pwhatever\n.",
    }
    for asked, make in cases.items():
        path, marker = _with_marker(tmp_path, make)
        with pytest.raises(InputError, match=asked.replace(".", r"\.") + r".*nothing of it was run"):
            load_pickled_arrays(path)
        assert not marker.exists(), asked
    # the same file does harm to who reads it the ordinary way: the test can fail
    path, marker = _with_marker(tmp_path, cases["posix.system"])
    pickle.loads(path.read_bytes())
    assert marker.exists()


def test_files_that_are_no_model_are_refused(tmp_path, flame_pickle, flame_arrays):
    with pytest.raises(InputError, match="no file"):
        load_flame(tmp_path / "none.pkl")
    (tmp_path / "cut.pkl").write_bytes(flame_pickle.read_bytes()[:1000])
    with pytest.raises(InputError, match="cannot be read as a pickled model"):
        load_flame(tmp_path / "cut.pkl")
    (tmp_path / "list.pkl").write_bytes(pickle.dumps([1, 2]))
    with pytest.raises(InputError, match="dictionary"):
        load_flame(tmp_path / "list.pkl")
    (tmp_path / "objects.pkl").write_bytes(pickle.dumps({"v_template": np.array([{}], object)}, protocol=2))
    with pytest.raises(InputError, match=r"objects\.pkl lacks v_template"):
        load_flame(tmp_path / "objects.pkl")
    np.savez(tmp_path / "few.npz", v_template=np.zeros((3, 3)))
    with pytest.raises(InputError, match=r"few\.npz lacks f, shapedirs"):
        load_flame(tmp_path / "few.npz")
    np.savez(tmp_path / "four.npz", **flame_arrays | {"weights": flame_arrays["weights"][:, :4]})
    with pytest.raises(InputError, match=r"weights of four\.npz is \(\d+, 4\)"):
        load_flame(tmp_path / "four.npz")
    np.savez(tmp_path / "texture.npz", vt=np.zeros((3, 2)))
    with pytest.raises(InputError, match="expected vt"):
        load_flame(flame_pickle, texture=tmp_path / "texture.npz")


@pytest.mark.parametrize("protocol", [0, 2, 4, 5])
def test_arrays_of_any_protocol_order_and_type_come_back(tmp_path, rng, protocol):
    content = {
        "columns": np.asfortranarray(rng.normal(size=(4, 3))),
        "big_endian": rng.normal(size=5).astype(">f4"),
        "flags": np.array([True, False]),
        "bytes": np.arange(256, dtype=np.uint8),
        "empty": np.zeros((0, 3)),
        "scalar": np.float64(2.5),
        "numbers": [1, 2, 3],
        "row_matrix": sparse.csr_matrix(np.eye(3)),
        "coordinates": sparse.coo_matrix(np.eye(2)),
    }
    noise = {"text": np.array(["a"]), "fields": np.zeros(2, [("x", "f8")]), "nested": {"a": 1}, "words": ["a"]}
    (tmp_path / "all.pkl").write_bytes(pickle.dumps(content | noise, protocol=protocol))
    found = load_pickled_arrays(tmp_path / "all.pkl")
    assert set(found) == set(content)
    for key, value in content.items():
        value = value.toarray() if sparse.issparse(value) else np.asarray(value)
        assert np.array_equal(found[key], value), key
        assert found[key].dtype == value.dtype
