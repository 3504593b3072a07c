"""Shapes of another numbering, placement, face or topology come to lie on the performance's face as they lay on their own."""

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.expressions import ExpressionBasis
from headcap.expressions.basis_registration import BasisRegistrationSettings, registered
from headcap.geometry.transforms import from_vector, transform
from headcap.heads import base_head
from headcap.meshes.subdivision import subdivide_butterfly

SIDE = 12
PLACE = from_vector(np.array([0.2, -0.1, 0.3, 0.5, 0.2, 1.0]))
SIZE = 1.1


@pytest.fixture
def basis(rng):
    """A curved sheet, torn along a row whose two rims lie at one place, as lips do."""
    x, y = np.meshgrid(np.linspace(-0.08, 0.08, SIDE), np.linspace(-0.1, 0.1, SIDE))
    vertices = np.stack([x.ravel(), y.ravel(), (0.05 - 3 * x**2 - 2 * y**2).ravel()], axis=1)
    corner = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).ravel()
    quads = np.stack([corner, corner + 1, corner + SIDE + 1, corner + SIDE], axis=1)
    rim = np.arange(5 * SIDE + 3, 5 * SIDE + 9)
    above = np.flatnonzero(quads[:, 0] >= 5 * SIDE)
    twins = np.full(SIDE * SIDE, -1)
    twins[rim] = SIDE * SIDE + np.arange(len(rim))
    upper = quads[above]
    quads[above] = np.where(twins[upper] >= 0, twins[upper], upper)
    vertices = np.concatenate([vertices, vertices[rim]])
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    shapes = 0.004 * rng.normal(size=(3, len(vertices), 3))
    return ExpressionBasis(("a", "b", "c"), vertices, shapes, triangles)


def test_shapes_of_the_very_face_stay_as_they_are(basis):
    found = registered(basis, basis.neutral, np.roll(basis.triangles, 1, axis=1)[::-1])
    assert found.topology == "same"
    # single precision of the products
    np.testing.assert_allclose(found.basis.displacements, basis.displacements, atol=1e-9)
    assert found.figures["neutral_rms_mm"] < 1e-9


def test_a_face_placed_elsewhere_in_another_size_turns_and_scales_its_shapes(basis):
    elsewhere = transform(PLACE, SIZE * basis.neutral.astype(float))
    found = registered(basis, elsewhere, basis.triangles)
    expected = SIZE * basis.displacements.astype(float) @ PLACE[:3, :3].T
    # single precision of the neutral face that the similarity is found from
    np.testing.assert_allclose(found.basis.displacements, expected, atol=1e-8)
    assert found.figures["scale"] == pytest.approx(SIZE, abs=1e-7)


def test_vertices_numbered_anew_are_found_again_also_where_two_lie_at_one_place(basis, rng):
    order = rng.permutation(len(basis.neutral))
    number = np.argsort(order)
    neutral, triangles = basis.neutral[order], number[basis.triangles].astype(np.int32)
    found = registered(basis, neutral, triangles)
    assert found.topology == "reordered"
    np.testing.assert_allclose(found.basis.displacements, basis.displacements[:, order], atol=1e-9)


def test_another_face_is_deformed_as_the_first_one_was(basis):
    """A turn and a growth have one gradient everywhere, which every other face takes over exactly (Sumner & Popovic 2004)."""
    turn = 1.05 * from_vector(np.array([0.1, -0.05, 0.02, 0, 0, 0]))[:3, :3]
    neutral, stretch = basis.neutral.astype(float), np.array([1.1, 0.95, 1.02])
    turned = ExpressionBasis(("turned",), neutral, (neutral @ turn.T - neutral)[None], basis.triangles)
    onto = neutral * stretch
    found = registered(turned, onto, basis.triangles)
    assert found.topology == "same"
    assert found.figures["neutral_rms_mm"] > 1
    # single precision of positions of 0.1 m, through gradients of edges a tenth as long
    np.testing.assert_allclose(found.basis.displacements[0], onto @ turn.T - onto, atol=2e-7)


def test_displacements_may_be_carried_as_they_are(basis):
    onto = basis.neutral.astype(float) * [1.1, 0.95, 1.02]
    found = registered(basis, onto, basis.triangles, settings=BasisRegistrationSettings(carry="displacements"))
    # every vertex moves as far as before, but for the size of the whole
    ratio = np.linalg.norm(found.basis.displacements, axis=2) / np.linalg.norm(basis.displacements, axis=2)
    np.testing.assert_allclose(ratio, found.figures["scale"], rtol=1e-5)
    assert found.figures["scale"] != pytest.approx(1.0, abs=1e-4)


def test_points_without_triangles_and_faces_without_landmarks_are_refused(basis):
    with pytest.raises(InputError, match="without triangles"):
        registered(basis, basis.neutral, np.zeros((0, 3), np.int32))
    triangles = basis.triangles[:-1]
    with pytest.raises(InputError, match="no landmarks on the shapes"):
        registered(basis, basis.neutral, triangles)
    with pytest.raises(InputError, match="no landmarks on the performance"):
        registered(basis, basis.neutral, triangles, landmarks={"nose": 3})
    with pytest.raises(InputError, match="landmark nose on the shapes"):
        registered(basis, basis.neutral, triangles, landmarks={"nose": 3000}, onto_landmarks={"nose": 3})
    with pytest.raises(InputError, match="1 landmarks that both faces have"):
        registered(basis, basis.neutral, triangles, landmarks={"nose": 3}, onto_landmarks={"nose": 3})


def test_shapes_of_another_topology_come_over_on_the_skin():
    """A face of four times the triangles, elsewhere, larger, numbered at random: the truth is what it was made of."""
    head = base_head()
    skin = np.any([head.regions[name] for name in ("face", "lips_upper", "lips_lower")], axis=0)
    skin &= ~head.regions["eyes"] & ~head.regions["mouth_interior"]
    truth = np.zeros((2, *head.vertices.shape))
    for shape, (name, direction) in zip(
        truth, (("chin", (0, -0.02, -0.005)), ("mouth_corner_left", (0.005, 0.008, 0))), strict=True
    ):
        away = np.linalg.norm(head.vertices - head.vertices[head.landmarks[name]], axis=1)
        shape[:] = np.exp(-np.square(away / 0.03))[:, None] * direction
    step = subdivide_butterfly(head.triangles, len(head.vertices))
    order = np.random.default_rng(0).permutation(len(step.carry(head.vertices)))
    number = np.argsort(order)
    fine = ExpressionBasis(
        ("jaw", "smile"),
        transform(PLACE, SIZE * step.carry(head.vertices))[order],
        np.stack([SIZE * step.carry(shape)[order] @ PLACE[:3, :3].T for shape in truth]),
        number[step.triangles],
    )
    found = registered(
        fine,
        head.vertices,
        head.triangles,
        landmarks={name: int(number[vertex]) for name, vertex in head.landmarks.items()},
        onto_landmarks=head.landmarks,
        skin=step.carry_mask(skin)[order],
        onto_skin=skin,
    )
    assert found.topology == "other"
    assert found.figures["matched_share"] > 0.99
    error = np.linalg.norm(found.basis.displacements - truth, axis=2)[:, skin]
    # a vertex off by a length moves otherwise by that length times the shape's slope, 25 mm over 30 mm at most
    assert 1e3 * np.percentile(error, 95) <= 0.9 * found.figures["distance_p95_mm"] + 0.01
    # beyond the skin shapes fade: the crown is at rest
    assert np.abs(found.basis.displacements[:, head.vertices[:, 1].argmax()]).max() < 1e-4


def test_a_shape_of_what_this_face_has_not_is_named(basis):
    still = ExpressionBasis(("a", "gaze"), basis.neutral, [basis.displacements[0], 0 * basis.displacements[0]], basis.triangles)
    with pytest.raises(InputError, match="flat shapes: gaze"):
        registered(still, basis.neutral, basis.triangles)
