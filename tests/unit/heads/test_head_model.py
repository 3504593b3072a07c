"""Laws of the head model: stages compose, batches broadcast, skinning inverts, derivatives are those of finite differences."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from headcap.artifacts import ArtifactError, save_arrays
from headcap.errors import InputError
from headcap.heads import HeadCoefficients, HeadModel, RestOffset, procedural_model
from headcap.heads.skinning import pose_features
from headcap.meshes.subdivision import subdivide_butterfly


@pytest.fixture(scope="module")
def model() -> HeadModel:
    """A small model with every basis in use: every 12th mode of the procedural one on the front of its face and neck."""
    whole = procedural_model(12, 15, np.float64)
    random = np.random.default_rng(3)
    n = len(whole.vertices)
    return dataclasses.replace(
        whole,
        pose_basis=random.normal(0, 0.002, (18, n, 3)),
        speech_basis=random.normal(0, 0.001, (4, n, 3)),
    )


@pytest.fixture
def some(model, rng) -> HeadCoefficients:
    return HeadCoefficients(
        shape=rng.normal(size=(3, 1, 12)),
        expression=rng.normal(size=(2, 15)),
        pose=rng.normal(0, 0.3, (3, 2, 2, 3)),
        speech=rng.normal(size=4),
        placement=_placements(rng, (2,)),
    )


def _placements(rng, batch):
    out = np.zeros((*batch, 4, 4))
    count = int(np.prod(batch))
    out[..., :3, :3] = Rotation.random(count, rng=rng).as_matrix().reshape(*batch, 3, 3)
    out[..., :3, 3], out[..., 3, 3] = rng.normal(size=(*batch, 3)), 1.0
    return out


def test_at_zero_it_is_the_mean(model):
    zero = HeadCoefficients(np.zeros(12), np.zeros(15), np.zeros((2, 3)), np.zeros(4), np.eye(4))
    assert np.allclose(model.evaluate(zero), model.vertices, atol=1e-15)
    assert np.allclose(model.evaluate(HeadCoefficients()), model.vertices, atol=1e-15)


def test_stages_compose_and_batches_broadcast(model, some, rng):
    offset = RestOffset(np.array([5, 90, 700]), rng.normal(0, 0.01, (2, 3, 3)))
    whole = model.evaluate(some, offset)
    assert whole.shape == (3, 2, *model.vertices.shape)
    identity = model.identity(some.shape)
    joints = model.joints(identity)
    staged = model.skinned(model.rest(some, offset), joints, some.pose, some.placement)
    assert np.allclose(whole, staged, atol=1e-13)
    for i, j in np.ndindex(3, 2):
        one = HeadCoefficients(some.shape[i, 0], some.expression[j], some.pose[i, j], some.speech, some.placement[j])
        alone = model.evaluate(one, RestOffset(offset.vertices, offset.values[j]))
        assert np.allclose(whole[i, j], alone, atol=1e-13)


def test_equation_4_and_5_written_out(model, some):
    """The same head from the paper's formulas, one vertex at a time, with scipy's rotations."""
    i, j = 2, 1
    pose, placement = some.pose[i, j], some.placement[j]
    turns = Rotation.from_rotvec(pose).as_matrix()
    neutral = model.vertices + np.einsum("b,bnk->nk", some.shape[i, 0], model.shape_basis)
    rest = neutral + np.einsum("b,bnk->nk", some.expression[j], model.expression_basis)
    rest += np.einsum("b,bnk->nk", some.speech, model.speech_basis)
    rest += np.einsum("b,bnk->nk", (turns - np.eye(3)).ravel(), model.pose_basis)
    neck, jaw = model.joint_regressor @ neutral
    skull = (rest - neck) @ turns[0].T + neck
    chin = ((rest - jaw) @ turns[1].T + jaw - neck) @ turns[0].T + neck
    posed = np.einsum("nb,bnk->nk", model.skinning_weights, np.stack([rest, skull, chin]))
    expected = posed @ placement[:3, :3].T + placement[:3, 3]
    assert np.allclose(model.evaluate(some)[i, j], expected, atol=1e-13)


def test_blocks_do_not_show(model, rng):
    frames = HeadCoefficients(expression=rng.normal(size=(130, 15)), pose=rng.normal(0, 0.2, (130, 2, 3)))
    whole = model.evaluate(frames)
    for f in (0, 63, 64, 129):
        assert np.allclose(whole[f], model.evaluate(HeadCoefficients(expression=frames.expression[f], pose=frames.pose[f])))


def test_a_shorter_vector_is_one_with_zeros(model, rng):
    few = rng.normal(size=5)
    padded = HeadCoefficients(shape=np.pad(few, (0, 7)), expression=np.pad(few, (0, 10)))
    assert np.allclose(model.evaluate(HeadCoefficients(shape=few, expression=few)), model.evaluate(padded), atol=1e-14)


def test_placement_moves_the_head_as_a_whole(model, some, rng):
    still = dataclasses.replace(some, placement=None)
    moved = model.evaluate(some)
    turn, shift = some.placement[..., :3, :3], some.placement[..., :3, 3]
    expected = np.einsum("jab,ijnb->ijna", turn, model.evaluate(still)) + shift[:, None]
    assert np.allclose(moved, expected, atol=1e-13)


def test_unskinning_inverts_skinning(model, some):
    joints = model.joints(model.identity(some.shape))
    rest = model.rest(some)
    posed = model.skinned(rest, joints, some.pose, some.placement)
    back = model.unskinned(posed, joints, some.pose, some.placement)
    # blends of rotations up to a radian apart are conditioned by a few
    assert np.abs(back - rest).max() < 1e-12


def test_vertex_transforms_turn_displacements(model, some, rng):
    pose = some.pose[0, 0]
    joints, push = model.joints(), rng.normal(0, 0.01, model.vertices.shape)
    turned = np.einsum("nij,nj->ni", model.vertex_transforms(joints, pose)[..., :3], push)
    difference = model.skinned(model.vertices + push, joints, pose) - model.skinned(model.vertices, joints, pose)
    assert np.allclose(turned, difference, atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-7, 0.4, 2.5])
def test_derivative_by_pose_is_that_of_finite_differences(model, some, rng, angle):
    chosen = rng.choice(len(model.vertices), 60, replace=False)
    direction = rng.normal(size=(3, 2, 2, 3))
    pose = angle * direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    at = dataclasses.replace(some, pose=pose)
    analytic = model.pose_derivative(at, vertices=chosen)
    assert analytic.shape == (3, 2, 60, 3, 6)
    step = 1e-6
    for q in range(6):
        push = step * np.eye(6)[q].reshape(2, 3)
        ahead, behind = (model.evaluate(dataclasses.replace(at, pose=pose + s * push))[..., chosen, :] for s in (1, -1))
        numeric = (ahead - behind) / (2 * step)
        # central differences: step^2 times a third derivative of a few times 0.3 m, and rounding of metres over the step
        assert np.abs(analytic[..., q] - numeric).max() < 5 * step**2 + 1e-15 * 3 / step


def test_joints_follow_the_identity_as_the_head_does(model, rng):
    matrix, shift = np.eye(3) + rng.normal(0, 0.1, (3, 3)), rng.normal(size=3)
    assert np.allclose(model.joints(model.vertices @ matrix.T + shift), model.joints() @ matrix.T + shift, atol=1e-12)
    person = model.personal(model.identity(np.ones(12)))
    assert np.allclose(person.joints(), model.joints(model.identity(np.ones(12))))
    assert np.allclose(person.evaluate(HeadCoefficients()), model.identity(np.ones(12)))


def test_pose_features_are_ordered_as_flame_orders_them():
    pose = np.array([[0.0, 0.0, np.pi / 2], [0.0, 0.0, 0.0]])
    assert np.allclose(pose_features(pose), [-1, -1, 0, 1, -1, 0, 0, 0, 0, *[0] * 9])


def test_a_finer_model_evaluates_to_the_finer_mesh(model, some):
    front = model.regions["front_neck"][model.triangles].all(axis=1)
    step = subdivide_butterfly(model.triangles, len(model.vertices), front)
    fine = model.subdivided(step)
    assert np.allclose(fine.rest(some)[0, 0], step.carry(model.rest(some)[0, 0]), atol=1e-13)
    assert np.allclose(fine.joints(fine.identity(some.shape)), model.joints(model.identity(some.shape)))
    assert np.allclose(fine.evaluate(some)[..., : len(model.vertices), :], model.evaluate(some), atol=1e-13)
    assert fine.regions["larynx"].sum() > 3 * model.regions["larynx"].sum()
    assert fine.template().triangles.shape == fine.uv_triangles.shape


def test_a_part_keeps_its_motion_and_refuses_to_lose_its_joints(model, some):
    kept = np.ones(len(model.vertices), bool)
    kept[model.regions["scalp"] & (model.joint_regressor == 0).all(axis=0)] = False
    part = model.part(kept)
    used = np.unique(model.triangles[kept[model.triangles].all(axis=1)])
    assert np.allclose(part.evaluate(some), model.evaluate(some)[..., used, :], atol=1e-13)
    with pytest.raises(InputError, match="joints are regressed"):
        model.part(~model.regions["neck"])


def test_a_file_brings_the_model_back(model, some, tmp_path):
    model.astype(np.float32).save(tmp_path / "head.npz")
    again = HeadModel.load(tmp_path / "head.npz")
    assert again.digest == model.astype(np.float32).digest != model.digest
    assert again.topology_digest == model.topology_digest
    assert again.landmarks == model.landmarks
    assert all(np.array_equal(mask, model.regions[name]) for name, mask in again.regions.items())
    # float32 holds 0.3 m to 2e-8 m
    assert (
        np.abs(
            again.evaluate(dataclasses.replace(some, placement=None)) - model.evaluate(dataclasses.replace(some, placement=None))
        ).max()
        < 1e-6
    )
    save_arrays(tmp_path / "other.npz", "template", 1, {})
    with pytest.raises(ArtifactError, match=r"headcap\.template/1, expected headcap\.head_model/1"):
        HeadModel.load(tmp_path / "other.npz")


def test_nothing_can_be_written_into_a_model(model):
    for array in (model.vertices, model.expression_basis, model.triangles, model.regions["face"]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        model.name = "other"
    model.template().vertices[0] = 0.0


def test_what_does_not_fit_is_refused(model):
    with pytest.raises(InputError, match=r"skinning_weights is \(12813, 2\)"):
        dataclasses.replace(model, skinning_weights=model.skinning_weights[:, :2])
    with pytest.raises(InputError, match="float32"):
        dataclasses.replace(model, expression_basis=model.expression_basis.astype(np.float32))
    with pytest.raises(InputError, match="shape coefficients"):
        model.evaluate(HeadCoefficients(shape=np.zeros(13)))
    with pytest.raises(InputError, match="rotation vectors"):
        model.evaluate(HeadCoefficients(pose=np.zeros((3, 3))))
    with pytest.raises(InputError, match="regions face"):
        dataclasses.replace(model, regions={"face": np.ones(3, bool)})
    with pytest.raises(InputError, match="texture coordinates"):
        dataclasses.replace(model, uv=None, uv_triangles=None).template()
