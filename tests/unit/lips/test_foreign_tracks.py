"""Other programs' tracks in the place of the base tracker's: FLAME parameters by FLAME's own formula, meshes by ties."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from headcap.errors import InputError
from headcap.geometry.transforms import rigid, transform
from headcap.heads import FlameSettings, HeadCoefficients, HeadModel, load_flame, procedural_model
from headcap.lips.foreign_tracks import BaseTrack, SurfaceTies, canonical_track, load_flame_track, mesh_track
from headcap.lips.mouth import find_mouth
from headcap.meshes.normals import vertex_normals

SETTINGS = FlameSettings(shapes=4, expressions=3, first_expression=4, wanted_vertices=0)
FRAMES = 5


@pytest.fixture(scope="module")
def head() -> HeadModel:
    return procedural_model(shapes=4, expressions=3, dtype=np.float64)


@pytest.fixture(scope="module")
def flame_arrays(head: HeadModel) -> dict[str, np.ndarray]:
    """A file of FLAME's form: the procedural head with joints root, neck, jaw and two eyes that carry nothing."""
    n, random = len(head.vertices), np.random.default_rng(5)
    regressor = np.zeros((5, n))
    regressor[0, np.flatnonzero(head.regions["neck"])[::7]] = 1.0
    regressor[0] /= regressor[0].sum()
    regressor[1:3] = head.joint_regressor
    regressor[3:] = head.joint_regressor[:1]
    weights = np.concatenate([head.skinning_weights, np.zeros((n, 2))], axis=1)
    return {
        "v_template": head.vertices,
        "f": head.triangles.astype(np.uint32),
        "shapedirs": np.concatenate([head.shape_basis, head.expression_basis]).transpose(1, 2, 0),
        "posedirs": random.normal(0, 1e-4, (n, 3, 36)),
        "J_regressor": regressor,
        "weights": weights / weights.sum(axis=1, keepdims=True),
    }


@pytest.fixture(scope="module")
def flame_file(flame_arrays, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("flame") / "flame.npz"
    np.savez(path, **flame_arrays)
    return path


@pytest.fixture(scope="module")
def flame(flame_file: Path) -> HeadModel:
    return load_flame(flame_file, settings=SETTINGS)


@pytest.fixture(scope="module")
def parameters() -> dict[str, np.ndarray]:
    random = np.random.default_rng(6)
    return {
        "shape": random.normal(size=(1, 4)),
        "expr": random.normal(size=(FRAMES, 3)),
        "rotation": random.normal(0, 0.3, (FRAMES, 3)) + np.array([np.pi - 0.3, 0, 0]),
        "neck_pose": random.normal(0, 0.1, (FRAMES, 3)),
        "jaw_pose": random.normal(0, 0.1, (FRAMES, 3)),
        "translation": random.normal(0, 0.2, (FRAMES, 3)) + np.array([0, 0, 1.2]),
    }


def _by_flame(a: dict[str, np.ndarray], p: dict[str, np.ndarray], k: int) -> np.ndarray:
    """FLAME's linear blend skinning along its tree root > neck > jaw, eyes at rest (Li et al. 2017, eq. 1 to 6)."""
    turns = Rotation.from_rotvec(np.stack([p["rotation"][k], p["neck_pose"][k], p["jaw_pose"][k]])).as_matrix()
    neutral = a["v_template"] + a["shapedirs"][:, :, :4] @ p["shape"][0]
    joints = a["J_regressor"] @ neutral
    features = np.concatenate([(turns[1:] - np.eye(3)).ravel(), np.zeros(18)])
    rest = neutral + a["shapedirs"][:, :, 4:] @ p["expr"][k] + a["posedirs"] @ features
    about = [rigid(turn, joint - turn @ joint) for turn, joint in zip(turns, joints[:3], strict=True)]
    bones = [about[0], about[0] @ about[1], about[0] @ about[1] @ about[2]]
    posed = np.stack([transform(bone, rest) for bone in (*bones, bones[1], bones[1])])
    return np.einsum("nb,bnk->nk", a["weights"], posed) + p["translation"][k]


def test_flame_parameters_give_flame_s_meshes(flame, flame_file, flame_arrays, parameters, tmp_path):
    np.savez(tmp_path / "track.npz", **parameters)
    track = load_flame_track(tmp_path / "track.npz", flame, flame_file, rate_hz=25, settings=SETTINGS)
    assert isinstance(track, BaseTrack)
    assert np.allclose(track.time_s, np.arange(FRAMES) / 25)
    for k, mesh in enumerate(track.meshes(flame)):
        # float32 at 1.5 m
        np.testing.assert_allclose(mesh, _by_flame(flame_arrays, parameters, k), atol=2e-6)
    still = parameters | {name: np.zeros_like(value) for name, value in parameters.items() if name != "shape"}
    np.testing.assert_allclose(track.neutral(flame), _by_flame(flame_arrays, still, 0), atol=1e-6)


def test_every_usual_spelling_is_the_same_track(flame, flame_file, parameters, tmp_path):
    p = parameters
    joined = np.concatenate([p["rotation"], p["neck_pose"], p["jaw_pose"], np.zeros((FRAMES, 6))], axis=1)
    shapes = np.repeat(p["shape"], FRAMES, axis=0)
    spellings = [
        p,
        {"expression": p["expr"], "betas": p["shape"][0], "full_pose": joined, "transl": p["translation"]},
        {"exp": p["expr"][:, None], "shape": shapes, "pose": joined[:, :9], "trans": p["translation"], "time_s": np.arange(5.0)},
    ]
    meshes = []
    for k, arrays in enumerate(spellings):
        np.savez(tmp_path / f"{k}.npz", **arrays)
        track = load_flame_track(tmp_path / f"{k}.npz", flame, flame_file, np.arange(5) / 30, settings=SETTINGS)
        meshes.append(np.stack(list(track.meshes(flame))))
    np.testing.assert_allclose(meshes[1], meshes[0], atol=1e-6)
    np.testing.assert_allclose(meshes[2], meshes[0], atol=1e-6)


def test_frames_without_parameters_stay_without_an_answer(flame, flame_file, parameters, tmp_path):
    gap = {name: value.copy() for name, value in parameters.items()}
    gap["expr"][2] = np.nan
    np.savez(tmp_path / "gap.npz", **gap)
    track = load_flame_track(tmp_path / "gap.npz", flame, flame_file, rate_hz=25, settings=SETTINGS)
    assert track.answered.tolist() == [True, True, False, True, True]
    assert [bool(np.isfinite(mesh).all()) for mesh in track.meshes(flame)] == track.answered.tolist()


def test_what_is_no_flame_sequence_is_told(flame, flame_file, head, parameters, tmp_path):
    wrong = {
        "holds weights": {"weights": np.zeros((5, 3))},
        r"jaw \(4, 3\)": parameters | {"jaw_pose": np.zeros((4, 3))},
        r"pose \(5, 12\)": {"expr": parameters["expr"], "pose": np.zeros((5, 12))},
        "without times": None,
        "time_s": parameters | {"time_s": np.zeros(5)},
    }
    for match, arrays in wrong.items():
        np.savez(tmp_path / "wrong.npz", **(arrays or parameters))
        rate = None if arrays is None or "time_s" in arrays else 25
        with pytest.raises(InputError, match=match):
            load_flame_track(tmp_path / "wrong.npz", flame, flame_file, rate_hz=rate, settings=SETTINGS)
    np.savez(tmp_path / "right.npz", **parameters)
    track = load_flame_track(tmp_path / "right.npz", flame, flame_file, rate_hz=25, settings=SETTINGS)
    with pytest.raises(InputError, match="FLAME parameters read for head model"):
        next(track.meshes(head))


# -- meshes -------------------------------------------------------------------------------------------------------------------


def _mixed(head: HeadModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The head as another topology: vertices in another order, triangles beginning elsewhere; order (n,) of its vertices."""
    random = np.random.default_rng(7)
    order = random.permutation(len(head.vertices))
    number = np.argsort(order)
    triangles = np.roll(number[head.triangles], 1, axis=1)[random.permutation(len(head.triangles))]
    return head.vertices[order], triangles, order


def _speaking(head: HeadModel) -> np.ndarray:
    pose = np.zeros((FRAMES, 2, 3))
    pose[:, 1, 0] = np.linspace(0, 0.25, FRAMES)
    expression = np.linspace(0, 1.5, FRAMES)[:, None] * [1.0, -1.0, 0.5]
    return head.evaluate(HeadCoefficients(expression=expression, pose=pose))


def test_meshes_of_the_model_s_own_topology_are_taken_as_they_are(head):
    meshes = _speaking(head)
    motion = rigid(Rotation.from_euler("xyz", [0.2, -0.4, 0.1]).as_matrix(), [0.1, 0.0, 1.0])
    moved = transform(motion, meshes)
    moved[3, 17] = np.nan
    track = mesh_track(head, moved, np.arange(FRAMES) / 30, head.vertices)
    assert isinstance(track, BaseTrack)
    assert track.answered.tolist() == [True, True, True, False, True]
    mouth = find_mouth(head.vertices, head.triangles, head.regions)
    canonical = canonical_track(track, head, mouth)
    still = canonical_track(mesh_track(head, meshes, np.arange(FRAMES) / 30, head.vertices), head, mouth)
    # a rigid motion of a mesh leaves its canonical form as it is; meshes pass as float32, 0.06 um at 1 m
    np.testing.assert_allclose(canonical.meshes[track.answered], still.meshes[track.answered], atol=1e-6)
    assert np.isnan(canonical.meshes[3]).all()


def test_another_topology_rides_along_touching_lips_included(head, rng):
    neutral, triangles, order = _mixed(head)
    meshes = _speaking(head)
    # a registration leaves the model a fifth of a millimetre off the surface; lips touch within less
    off = rng.normal(0, 2e-4, len(head.vertices))
    registered = head.vertices + off[:, None] * vertex_normals(head.vertices, head.triangles)
    track = mesh_track(head, meshes[:, order], np.arange(FRAMES) / 30, neutral, triangles, registered)
    face = head.regions["face"] | head.regions["lips_outer"] | head.regions["lips_inner"]
    error = np.linalg.norm(np.stack(list(track.meshes(head))) - meshes, axis=2)[:, face]
    moved = np.linalg.norm(meshes[-1] - meshes[0], axis=1)[face].max()
    assert moved > 0.02
    # a vertex on the wrong lip would err by the mouth's opening
    assert error.max() < 5 * 2e-4 + 0.02 * moved
    assert np.sqrt((error**2).mean()) < 3e-4


def test_ties_move_with_the_surface(head):
    neutral, triangles, _ = _mixed(head)
    registered = head.vertices + 1e-3 * vertex_normals(head.vertices, head.triangles)
    ties = SurfaceTies.of(neutral, triangles, registered, head.triangles)
    motion = rigid(Rotation.from_euler("xyz", [0.7, -0.4, 0.3]).as_matrix(), [0.3, -0.2, 1.5])
    np.testing.assert_allclose(ties.carry(transform(motion, neutral)), transform(motion, ties.carry(neutral)), atol=1e-12)


def test_meshes_that_do_not_fit_are_told(head):
    times = np.arange(2) / 30
    with pytest.raises(InputError, match=r"neutral head .* m large.*Scale the sequence to metres"):
        mesh_track(head, np.zeros((2, *head.vertices.shape)), times, 1e3 * head.vertices)
    with pytest.raises(InputError, match=r"100 vertices.*Register"):
        mesh_track(head, np.zeros((2, 100, 3)), times, head.vertices[::100][:100])
    with pytest.raises(InputError, match="one mesh per moment"):
        mesh_track(head, np.zeros((3, *head.vertices.shape)), times, head.vertices)
    track = mesh_track(head, np.zeros((2, *head.vertices.shape)), times, head.vertices)
    other = head.part(head.regions["face"] | (head.joint_regressor != 0).any(axis=0))
    with pytest.raises(InputError, match="topology"):
        next(track.meshes(other))
