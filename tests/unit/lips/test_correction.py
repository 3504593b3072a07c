"""The correction layer: laws of the nine numbers, of the canonical frame and of the round trip through eq. 1."""

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.geometry.rotations import rotation_matrices
from headcap.geometry.transforms import from_vector, transform
from headcap.heads import base_head
from headcap.lips.correction import CorrectionLayer, TrueNeutral, canonical_meshes, canonical_truth, triangle_frames
from headcap.lips.mouth import MouthSettings, find_mouth
from headcap.lips.triangle_parameters import triangle_gradients, triangle_parameters
from headcap.synthetic.mesh_takes import mesh_subject

EPS = np.finfo(np.float64).eps


@pytest.fixture(scope="module")
def mouth():
    head = base_head()
    return find_mouth(head.vertices, head.triangles, head.regions)


@pytest.fixture(scope="module")
def subject():
    return mesh_subject(11)


@pytest.fixture(scope="module")
def smiles(subject):
    """(6, n, 3) frames in which the lips move by millimetres."""
    return subject.take("lips", 60, 30.0).meshes[12::9].astype(float)


def axes(rng, count):
    directions = rng.normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def stretches(rng, count):
    """Symmetric positive definite, principal stretches 0.3 to 2.5."""
    turned = rotation_matrices(axes(rng, count) * rng.uniform(0, 3, (count, 1)))
    return turned @ (rng.uniform(0.3, 2.5, (count, 1, 3)) * np.swapaxes(turned, 1, 2))


@pytest.mark.parametrize("angle", [0.0, 1e-14, 1e-9, 1e-7, 1e-4, 0.3, 2.0, np.pi - 1e-4, np.pi - 1e-8, np.pi - 1e-13, np.pi])
def test_numbers_make_the_gradient_again_at_every_angle(rng, angle):
    stretch = stretches(rng, 200)
    vectors = np.concatenate([angle * axes(rng, 197), angle * np.eye(3)])
    gradients = rotation_matrices(vectors) @ stretch
    numbers = triangle_parameters(gradients)
    # sqrt of the condition 2.5 / 0.3 enters the polar factor, a few operations of rounding each entry
    np.testing.assert_allclose(triangle_gradients(numbers), gradients, atol=300 * EPS * 2.5)
    same = np.abs(numbers[:, :3] - vectors).max(axis=1)
    if angle == np.pi:  # v and -v are one rotation
        same = np.minimum(same, np.abs(numbers[:, :3] + vectors).max(axis=1))
    np.testing.assert_array_less(same, 300 * EPS * 2.5 / 0.3)
    np.testing.assert_allclose(numbers[:, 3:6] + 1, np.diagonal(stretch, axis1=1, axis2=2), atol=300 * EPS * 2.5 / 0.3)
    np.testing.assert_allclose(numbers[:, 8], stretch[:, 0, 1], atol=300 * EPS * 2.5 / 0.3)


def test_no_deformation_is_nine_zeros_and_thin_triangles_are_no_trouble(rng):
    assert np.abs(triangle_parameters(np.eye(3))).max() == 0.0
    squashed = rotation_matrices(axes(rng, 50)) @ np.diag([1.0, 1e-6, 1e-3])
    numbers = triangle_parameters(squashed)
    np.testing.assert_allclose(triangle_gradients(numbers), squashed, atol=1e-13)


def test_what_is_no_deformation_becomes_nan():
    inside_out, singular = np.diag([1.0, 1.0, -1.0]), np.diag([1.0, 1.0, 0.0])
    numbers = triangle_parameters(np.stack([inside_out, singular, np.full((3, 3), np.nan), np.eye(3)]))
    assert np.isnan(numbers[:3]).all()
    assert np.isfinite(numbers[3]).all()


def test_equation_one_telescopes_to_the_gradient_from_base_to_truth(mouth, subject, smiles):
    base, neutral, truth_neutral = smiles[:2], base_head().vertices, subject.neutral_m
    layer = CorrectionLayer(mouth, neutral)
    canonical = canonical_meshes(base, neutral, mouth.steady).meshes
    numbers = layer.parameters(canonical, truth_neutral, smiles[2:4])
    anchor, scale = canonical_truth(truth_neutral, neutral, mouth.steady)
    truth = canonical_meshes(scale * smiles[2:4], anchor, mouth.steady).meshes
    corners = mouth.triangles[mouth.layer]
    for k in range(2):
        direct = triangle_frames(truth[k], corners) @ np.linalg.inv(triangle_frames(canonical[k], corners))
        # numbers are kept in single precision
        np.testing.assert_allclose(triangle_gradients(numbers[k]), direct, atol=2e-5)


@pytest.mark.parametrize("identity", ["corrected", "kept"])
def test_the_layer_does_not_see_rigid_motion_and_the_result_moves_with_the_base(mouth, subject, smiles, identity):
    layer = CorrectionLayer(mouth, subject.neutral_m, identity)
    base, truth = smiles[:2], smiles[2:4]
    moves = np.array([[0.4, -0.3, 0.2, 0.1, 0.05, -0.3], [-0.1, 1.2, 0.3, -0.2, 0.0, 1.5]])
    still = canonical_meshes(base, subject.neutral_m, mouth.steady)
    moved_base = np.stack([transform(from_vector(move), mesh) for move, mesh in zip(moves, base, strict=True)])
    moved_truth = np.stack([transform(from_vector(-move), mesh) for move, mesh in zip(moves, truth, strict=True)])
    moved = canonical_meshes(moved_base, subject.neutral_m, mouth.steady)
    expected = layer.parameters(still.meshes, subject.neutral_m, truth)
    numbers = layer.parameters(moved.meshes, transform(from_vector(moves[1]), subject.neutral_m), moved_truth)
    # single precision of the numbers, amplified where triangles are thin
    np.testing.assert_allclose(numbers, expected, atol=1e-5)
    corrected = still.world(layer.corrected(still.meshes, expected))
    again = moved.world(layer.corrected(moved.meshes, expected))
    for move, one, other in zip(moves, corrected, again, strict=True):
        np.testing.assert_allclose(other, transform(from_vector(move), one), atol=1e-11)


def test_a_forehead_whose_vertices_slid_turns_nothing_where_it_is_known_where_they_lie(mouth, subject, smiles):
    neutral = subject.neutral_m
    motion = smiles[2:4] - neutral
    motion[:, mouth.steady] = 0.0
    base, slid = neutral + 0.5 * motion, neutral.copy()
    # half of the forehead's vertices lie three millimetres higher on it, so that a fit to them turns
    slid[mouth.steady[::2]] += [0.0, 3e-3, 1e-3]
    layer = CorrectionLayer(mouth, neutral)
    expected = layer.parameters(base, neutral, neutral + motion)
    told = TrueNeutral(slid, mouth.steady, neutral[mouth.steady])
    anchor, scale = canonical_truth(told, neutral, mouth.steady)
    np.testing.assert_allclose(anchor, slid, atol=1e-12)
    assert scale == pytest.approx(1.0, abs=1e-12)
    # single precision of the numbers, amplified where triangles are thin
    np.testing.assert_allclose(layer.parameters(base, told, slid + motion), expected, atol=1e-5)
    assert np.abs(layer.parameters(base, slid, slid + motion) - expected).max() > 1e-3


def test_a_larger_truth_gives_the_same_layer(mouth, subject, smiles):
    layer = CorrectionLayer(mouth, subject.neutral_m)
    expected = layer.parameters(smiles[:1], subject.neutral_m, smiles[1:2])
    np.testing.assert_allclose(layer.parameters(smiles[:1], 1.7 * subject.neutral_m, 1.7 * smiles[1:2]), expected, atol=1e-5)


def inside_of(mouth, n):
    """Vertices all of whose triangles carry the full correction."""
    full = np.zeros(len(mouth.triangles), bool)
    full[mouth.layer[mouth.fade == 1.0]] = True
    inside = np.ones(n, bool)
    inside[mouth.triangles[~full]] = False
    return inside


@pytest.mark.parametrize("seed", [11, 12])
def test_round_trip_recovers_the_truth_exactly_where_the_layer_is_whole(seed):
    """Base and truth that differ inside the unfaded mask alone: gradients are compatible, so the least-squares sum is zero."""
    subject, head = mesh_subject(seed), base_head()
    # without a fade the whole mask counts, and the pocket's triangles are not moved in this test's truth
    mouth = find_mouth(head.vertices, head.triangles, head.regions, MouthSettings(fade_mm=0.0))
    take = subject.take("lips", 40, 30.0).meshes.astype(float)
    inside = inside_of(mouth, len(head.vertices))
    assert inside.sum() > 900
    base = np.repeat(subject.neutral_m[None], 3, axis=0)
    truth = base.copy()
    truth[:, inside] = take[[15, 25, 35]][:, inside]
    assert np.abs(truth - base).max() > 4e-3
    layer = CorrectionLayer(mouth, subject.neutral_m)
    corrected = layer.corrected(base, layer.parameters(base, subject.neutral_m, truth))
    # numbers are float32: strains of up to 20 err by 1e-6 over edges of a millimetre, summed over about 40 edges to the rim
    assert np.abs(corrected - truth).max() < 40 * 1e-6 * 1e-3 * 20


def test_round_trip_through_the_fade_and_the_collar(mouth, subject, smiles):
    """A base that sees half of the motion: what is left is what the fade takes off and the rim holds back."""
    base = 0.5 * (smiles + subject.neutral_m)
    layer = CorrectionLayer(mouth, subject.neutral_m)
    corrected = layer.corrected(base, layer.parameters(base, subject.neutral_m, smiles))
    wanted = smiles[:, mouth.vertices]
    before, after = (np.linalg.norm(mesh[:, mouth.vertices] - wanted, axis=2).mean(axis=1) for mesh in (base, corrected))
    assert (after < 0.45 * before).all()
    outside = np.setdiff1d(np.arange(base.shape[1]), mouth.triangles[mouth.patch])
    assert np.array_equal(corrected[:, outside], base[:, outside])


def test_no_correction_changes_nothing(mouth, subject, smiles):
    layer = CorrectionLayer(mouth, subject.neutral_m)
    nothing = np.zeros((len(smiles), len(mouth.layer), 9))
    # edges of C_f are carried as they are: C_f itself solves the equation
    np.testing.assert_allclose(layer.corrected(smiles, nothing), smiles, atol=1e-11)


def test_kept_identity_gives_no_correction_at_rest(mouth, subject):
    other = mesh_subject(12)
    kept, paper = (CorrectionLayer(mouth, other.neutral_m, identity) for identity in ("kept", "corrected"))
    at_rest = other.neutral_m[None]
    assert np.abs(kept.parameters(at_rest, subject.neutral_m, subject.neutral_m[None])).max() < 1e-5
    assert np.abs(paper.parameters(at_rest, subject.neutral_m, subject.neutral_m[None])).max() > 0.1


def test_frames_that_were_not_tracked_are_not_made_up(mouth, subject, smiles):
    layer = CorrectionLayer(mouth, subject.neutral_m)
    lost = smiles.copy()
    lost[1] = np.nan
    numbers = layer.parameters(canonical_meshes(lost, subject.neutral_m, mouth.steady).meshes, subject.neutral_m, smiles)
    assert np.isnan(numbers[1]).all()
    assert np.isfinite(numbers[[0, 2]]).all()


def test_bad_input_is_told(mouth, subject, smiles):
    layer = CorrectionLayer(mouth, subject.neutral_m)
    with pytest.raises(InputError, match="topology"):
        layer.parameters(smiles[:, :100], subject.neutral_m, smiles)
    with pytest.raises(InputError, match="per frame"):
        layer.parameters(smiles[:2], subject.neutral_m, smiles)
    with pytest.raises(InputError, match="mask"):
        layer.corrected(smiles, np.zeros((len(smiles), 3, 9)))
    with pytest.raises(InputError, match="no area"):
        CorrectionLayer(mouth, np.zeros_like(subject.neutral_m))
    with pytest.raises(InputError, match="lips"):
        find_mouth(subject.neutral_m, mouth.triangles, {"face": np.ones(len(subject.neutral_m), bool)})
    with pytest.raises(ValueError, match="fade"):
        MouthSettings(reach_mm=5.0, fade_mm=6.0)


def test_the_outline_runs_from_the_right_corner_over_the_upper_lip(mouth):
    v = base_head().vertices[mouth.outline]
    assert v[0, 0] == v[:, 0].min()
    assert v[mouth.left, 0] == v[:, 0].max()
    upper, lower = v[1 : mouth.left], v[mouth.left + 1 :]
    # the border is as jagged as the triangles are small, about a millimetre
    assert (np.diff(v[: mouth.left + 1, 0]) > -1e-3).all()
    assert upper[:, 1].mean() > lower[:, 1].mean() + 5e-3
