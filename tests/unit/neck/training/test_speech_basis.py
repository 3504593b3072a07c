"""Laws of the streamed singular vectors: those of the whole matrix, however it is cut."""

import numpy as np

from headcap.neck.training.speech_basis import leading_directions, reduce_rows


def _matrix(rng: np.random.Generator) -> np.ndarray:
    left, right = np.linalg.qr(rng.normal(size=(300, 40)))[0], np.linalg.qr(rng.normal(size=(120, 40)))[0]
    return left * 0.8 ** np.arange(40) @ right.T


def test_the_leading_vectors_are_those_of_the_decomposition(rng):
    matrix = _matrix(rng)
    vectors, values = leading_directions(lambda: (matrix[i : i + 64] for i in range(0, 300, 64)), 120, 6)
    exact = np.linalg.svd(matrix)
    assert np.allclose(vectors @ vectors.T, np.eye(6), atol=1e-10)
    # captured energy is short of the best by at most a thousandth of what is left
    best, left = (exact[1][:6] ** 2).sum(), (exact[1][6:] ** 2).sum()
    assert best - 2e-3 * left < (values**2).sum() <= best + 1e-12
    assert np.allclose(values, exact[1][:6], rtol=0.01)


def test_a_start_among_the_vectors_stays(rng):
    matrix = _matrix(rng)
    exact = np.linalg.svd(matrix)[2][:4]
    vectors, _ = leading_directions(lambda: [matrix], 120, 4, start=exact)
    assert np.abs(np.linalg.svd(vectors @ exact.T)[1] - 1).max() < 1e-6


def test_reduction_keeps_products_and_counts_what_it_drops(rng):
    matrix = _matrix(rng).astype(np.float32)
    reduced, directions, left_out = reduce_rows(lambda: [matrix[:100], matrix[100:]], 120, 20)
    whole = float((matrix.astype(float) ** 2).sum())
    assert reduced.shape == (300, 20)
    assert np.isclose(left_out, whole - (reduced.astype(float) ** 2).sum(), atol=1e-5 * whole)
    assert np.abs(reduced @ directions - matrix).max() ** 2 <= left_out + 1e-6 * whole


def test_few_directions_are_found_among_very_many_columns(rng):
    # a random subspace of 30,000 columns holds next to nothing of them: the search must not take that for an end
    direction = np.linalg.qr(rng.normal(size=(30_000, 3)))[0].T
    matrix = rng.normal(size=(100, 3)) @ direction + rng.normal(0, 1e-4, (100, 30_000))
    vectors, _ = leading_directions(lambda: [matrix], 30_000, 3)
    assert np.linalg.svd(vectors @ direction.T)[1].min() > 0.999
