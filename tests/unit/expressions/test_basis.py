import numpy as np
import pytest

from headcap.artifacts import ArtifactError
from headcap.expressions import Eigenfaces, ExpressionBasis, Performance, QuasiEigenFaces
from headcap.expressions.performance import in_memory, joined

TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


@pytest.fixture
def basis(rng):
    return ExpressionBasis(("smile", "frown"), rng.normal(size=(4, 3)), rng.normal(size=(2, 4, 3)), TRIANGLES)


def performance(rng, count, neutral=None, source="take"):
    neutral = np.zeros((4, 3)) if neutral is None else neutral
    return Performance(neutral, TRIANGLES, in_memory(rng.normal(size=(count, 4, 3)), 3), np.arange(count) / 30, source)


def test_blends_are_linear_and_rest_at_the_neutral_face(basis, rng):
    np.testing.assert_array_equal(basis.blend(np.zeros(2)), basis.neutral)
    first, second = rng.normal(size=(2, 5, 2))
    both = basis.blend(first + second) - basis.neutral
    # single precision of numbers near 1
    np.testing.assert_allclose(both, basis.blend(first) + basis.blend(second) - 2 * basis.neutral, atol=1e-5)


def test_names_and_displacements_must_agree(basis):
    with pytest.raises(ValueError, match="1 names"):
        ExpressionBasis(("smile",), basis.neutral, basis.displacements, TRIANGLES)


def test_a_basis_survives_its_file_and_no_other_kind_is_read(basis, tmp_path):
    basis.chosen([1]).save(tmp_path / "basis.npz")
    found = ExpressionBasis.load(tmp_path / "basis.npz")
    assert found.names == ("frown",)
    np.testing.assert_array_equal(found.displacements, basis.displacements[1:])
    with pytest.raises(ArtifactError):
        QuasiEigenFaces.load(tmp_path / "basis.npz")


def test_quasi_eigen_faces_survive_their_file(basis, tmp_path, rng):
    eigen = Eigenfaces(
        np.zeros((4, 3), np.float32), rng.normal(size=(3, 4, 3)).astype(np.float32), np.array([3.0, 2.0, 1.0]), 8.0
    )
    made = QuasiEigenFaces(basis, eigen, basis, rng.normal(size=(2, 3)), (2,))
    made.save(tmp_path / "faces.npz")
    found = QuasiEigenFaces.load(tmp_path / "faces.npz")
    assert (found.missing, found.quasi.names, found.eigen.total_variance) == ((2,), basis.names, 8.0)
    np.testing.assert_array_equal(found.coordinates, made.coordinates)
    np.testing.assert_allclose(found.eigen.coverage, [3 / 8, 5 / 8, 6 / 8])


def test_performances_join_in_order(rng):
    parts = [performance(rng, 5), performance(rng, 4)]
    whole = joined(parts)
    assert len(whole) == 9
    np.testing.assert_array_equal(
        np.concatenate(list(whole.blocks())), np.concatenate([np.concatenate(list(part.blocks())) for part in parts])
    )
    assert next(iter(whole.rows())).shape == (3, whole.columns)


def test_performances_of_other_neutral_faces_do_not_join(rng):
    with pytest.raises(ValueError, match="another neutral"):
        joined([performance(rng, 5), performance(rng, 5, np.ones((4, 3)), "other")])


def test_a_hyperplane_through_the_neutral_face_has_no_offset(rng):
    axes = np.linalg.qr(rng.normal(size=(12, 3)))[0].T.reshape(3, 4, 3).astype(np.float32)
    eigen = Eigenfaces(rng.normal(size=(4, 3)).astype(np.float32), axes, np.array([3.0, 2.0, 1.0]), 8.0)
    through = eigen.through_neutral()
    # single precision of numbers near 1
    np.testing.assert_allclose(through.rows @ through.rows.T, np.eye(4), atol=1e-6)
    assert np.abs(through.offset).max() < 1e-6 < np.abs(eigen.offset).max()
    np.testing.assert_allclose(through.coverage, [*eigen.coverage, eigen.coverage[-1]])
    assert len(through.through_neutral()) == len(through)
