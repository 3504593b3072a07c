"""Base tracks from files of other programs: every form leads to the same meshes of the head model, or to a message."""

import json
from dataclasses import replace

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.geometry.transforms import from_vector, transform
from headcap.heads import FlameSettings, HeadCoefficients, load_flame, procedural_model
from headcap.lips.base_files import BaseTrackFiles, load_base_track
from headcap.lips.monocular import FrameState, MonocularTrack
from headcap.lips.mouth import find_mouth
from headcap.registration.sequence import MeshSequence, save_chunk

FRAMES, TIME_S = 3, np.arange(3) / 25
SETTINGS = FlameSettings(shapes=4, expressions=3, first_expression=4, wanted_vertices=0)
NAMES = ("nose_tip", "chin", "subnasale", "mouth_corner_left", "mouth_corner_right", "lip_upper_top", "lip_lower_bottom")
NAMES += ("eye_inner_left", "eye_inner_right", "eye_outer_left", "eye_outer_right")


@pytest.fixture(scope="module")
def model():
    return procedural_model(shapes=4, expressions=3)


@pytest.fixture(scope="module")
def mouth(model):
    return find_mouth(np.asarray(model.vertices, float), model.triangles, model.regions)


@pytest.fixture(scope="module")
def meshes(model):
    """A head at rest in the first frame, then smiling and turned."""
    pose = np.zeros((FRAMES, 2, 3))
    pose[:, 1, 0] = [0, 0.1, 0.2]
    placement = np.stack([from_vector(np.array([0, 0.1 * k, 0.02 * k, 0.01 * k, 0, 0.1])) for k in range(FRAMES)])
    expression = np.array([[0, 0, 0], [1, 0, -1], [0, 1, 1.0]])
    return model.evaluate(HeadCoefficients(np.array([1, -1, 0.5, 0]), expression, pose, placement=placement))


def loaded(files, model, mouth, **more):
    return np.array(list(load_base_track(files, model, mouth, TIME_S, **more).meshes(model)))


def test_meshes_of_the_model_s_topology_come_as_they_are(model, mouth, meshes, tmp_path):
    np.save(tmp_path / "meshes.npy", meshes)
    save_chunk(tmp_path / "chunk.npy", meshes)
    MeshSequence("talk", TIME_S, (tmp_path / "chunk.npy",)).save(tmp_path / "sequence.json")
    for name in ("meshes.npy", "sequence.json"):
        np.testing.assert_array_equal(loaded(BaseTrackFiles(tmp_path / name), model, mouth), meshes)
    track = load_base_track(BaseTrackFiles(tmp_path / "meshes.npy"), model, mouth, TIME_S)
    rest = model.identity(np.array([1, -1, 0.5, 0]))
    # the first frame brought upright: by what holds still, which identity has moved a little against the mean head
    apart = track.neutral(model) - rest
    assert np.ptp(apart, axis=0).max() < 0.02 * np.ptp(rest, axis=0).max()


def test_meshes_of_another_topology_ride_on_it(model, mouth, meshes, tmp_path):
    order = np.random.default_rng(2).permutation(len(model.vertices))
    number = np.argsort(order)
    np.save(tmp_path / "meshes.npy", meshes[:, order])
    rest = np.asarray(model.identity(np.array([1, -1, 0.5, 0])))[order]
    lines = [f"v {x:.7f} {y:.7f} {z:.7f}\n" for x, y, z in rest]
    lines += [f"f {a} {b} {c}\n" for a, b, c in number[model.triangles] + 1]
    (tmp_path / "rest.obj").write_text("".join(lines))
    (tmp_path / "names.json").write_text(json.dumps({name: int(number[model.landmarks[name]]) for name in NAMES}))
    files = BaseTrackFiles(tmp_path / "meshes.npy", neutral=tmp_path / "rest.obj", landmarks=tmp_path / "names.json")
    found = loaded(files, model, mouth)
    error_mm = 1e3 * np.linalg.norm(found - meshes, axis=2)[:, mouth.vertices]
    # both topologies are one surface: a vertex may come to lie elsewhere on it, by less than an edge of the lips (about 1 mm)
    assert np.median(error_mm) < 0.5
    with pytest.raises(InputError, match="0 landmarks that both faces have"):
        loaded(replace(files, landmarks=None), model, mouth)
    (tmp_path / "names.json").write_text('{"nose_tip": 99999}')
    with pytest.raises(InputError, match="nose_tip is vertex 99999"):
        loaded(files, model, mouth)
    with pytest.raises(InputError, match=r"rest\.ply cannot be read"):
        loaded(replace(files, neutral=tmp_path / "rest.ply"), model, mouth)


def test_flame_parameters_and_our_own_track(model, mouth, tmp_path):
    n = len(model.vertices)
    regressor = np.zeros((5, n))
    regressor[1:3] = model.joint_regressor
    regressor[[0, 3, 4]] = model.joint_regressor[0]
    weights = np.concatenate([model.skinning_weights, np.zeros((n, 2))], axis=1)
    np.savez(
        tmp_path / "flame.npz",
        v_template=model.vertices,
        f=model.triangles.astype(np.uint32),
        shapedirs=np.concatenate([model.shape_basis, model.expression_basis]).transpose(1, 2, 0),
        posedirs=np.zeros((n, 3, 36)),
        J_regressor=regressor,
        weights=weights / weights.sum(axis=1, keepdims=True),
    )
    np.savez(tmp_path / "track.npz", expression=np.eye(3), shape=np.ones(4), transl=np.tile([0, 0, 1.0], (3, 1)))
    flame = load_flame(tmp_path / "flame.npz", settings=SETTINGS)
    files = BaseTrackFiles(tmp_path / "track.npz", flame=tmp_path / "flame.npz")
    given = HeadCoefficients(np.ones(4), np.eye(3), np.zeros((3, 2, 3)))
    found = loaded(files, flame, mouth, flame_settings=SETTINGS)
    np.testing.assert_allclose(found, flame.evaluate(given) + np.array([0, 0, 1.0]), atol=1e-6)
    with pytest.raises(InputError, match=r"track\.npz without a FLAME model"):
        loaded(replace(files, flame=None), flame, mouth)
    nothing = np.zeros(FRAMES)
    own = MonocularTrack(
        model.digest,
        TIME_S,
        (FrameState.TRACKED,) * FRAMES,
        np.zeros(4),
        np.eye(3),
        np.zeros((FRAMES, 3)),
        np.tile(np.eye(4), (FRAMES, 1, 1)),
        focal_ratio=1.0,
        light=np.zeros((FRAMES, 3, 9)),
        residual=nothing,
        inliers=nothing,
        correlation=nothing,
        layer=np.zeros(model.vertices.shape),
    )
    own.save(tmp_path / "own.npz")
    np.testing.assert_array_equal(loaded(BaseTrackFiles(tmp_path / "own.npz"), model, mouth), np.array(list(own.meshes(model))))


def test_what_is_no_base_track_is_told(model, mouth, meshes, tmp_path):
    arrays = {
        "few.npy": (meshes[:2], r"few\.npy of 2 frames"),
        "flat.npy": (meshes[0], r"flat\.npy \(\d+, 3\)"),
        "whole.npy": (meshes.astype(int), "of int64"),
        "other.npy": (meshes[:, :-1], "vertices; expected the"),
        "lost.npy": (np.full_like(meshes, np.nan), "without a finite mesh"),
    }
    for name, (array, message) in arrays.items():
        np.save(tmp_path / name, array)
        with pytest.raises(InputError, match=message):
            loaded(BaseTrackFiles(tmp_path / name), model, mouth)
    (tmp_path / "text.npy").write_text("nothing")
    for name, message in (("text.npy", "cannot be read"), ("track.fbx", "ends in .npz")):
        with pytest.raises(InputError, match=message):
            loaded(BaseTrackFiles(tmp_path / name), model, mouth)


def test_a_head_elsewhere_stays_where_it_is(model, mouth, meshes, tmp_path):
    """The neutral mesh is upright whatever the world's axes are."""
    turned = from_vector(np.array([np.pi - 0.2, 0.3, 0.1, 0.4, -0.2, 1.0]))
    np.save(tmp_path / "meshes.npy", meshes)
    np.save(tmp_path / "moved.npy", np.stack([transform(turned, mesh) for mesh in meshes]))
    rests = [
        load_base_track(BaseTrackFiles(tmp_path / name), model, mouth, TIME_S).neutral(model)
        for name in ("meshes.npy", "moved.npy")
    ]
    # single precision at a metre
    np.testing.assert_allclose(*rests, atol=1e-6)
