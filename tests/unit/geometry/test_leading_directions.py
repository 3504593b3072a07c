"""Laws of streamed singular vectors: those of the whole matrix, however it is cut, read again and again or only once."""

import numpy as np
import pytest

from headcap.geometry.leading_directions import RowSketch, leading_directions, principal_components, reduce_rows


def _matrix(rng: np.random.Generator) -> np.ndarray:
    left, right = np.linalg.qr(rng.normal(size=(300, 40)))[0], np.linalg.qr(rng.normal(size=(120, 40)))[0]
    return left * 0.8 ** np.arange(40) @ right.T


def test_the_leading_vectors_are_those_of_the_decomposition(rng):
    matrix = _matrix(rng)
    found = leading_directions(lambda: (matrix[i : i + 64] for i in range(0, 300, 64)), 120, 6)
    vectors, values = found.vectors, found.values
    exact = np.linalg.svd(matrix)
    assert np.allclose(vectors @ vectors.T, np.eye(6), atol=1e-10)
    # captured energy is short of the best by at most a thousandth of what is left
    best, left = (exact[1][:6] ** 2).sum(), (exact[1][6:] ** 2).sum()
    assert best - 2e-3 * left < (values**2).sum() <= best + 1e-12
    assert np.allclose(values, exact[1][:6], rtol=0.01)
    assert found.energy == pytest.approx((matrix**2).sum(), rel=1e-12)


def test_a_start_among_the_vectors_stays(rng):
    matrix = _matrix(rng)
    exact = np.linalg.svd(matrix)[2][:4]
    vectors = leading_directions(lambda: [matrix], 120, 4, start=exact).vectors
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
    vectors = leading_directions(lambda: [matrix], 30_000, 3).vectors
    assert np.linalg.svd(vectors @ direction.T)[1].min() > 0.999


def test_what_never_settles_is_the_best_of_the_last_pass(rng, monkeypatch):
    """A flat spectrum, and too few passes: what is given still captures what its values say."""
    monkeypatch.setattr("headcap.geometry.leading_directions.MOST_PASSES", 2)
    matrix = rng.normal(size=(300, 120))
    found = leading_directions(lambda: [matrix], 120, 6)
    assert np.linalg.norm(matrix @ found.vectors.T, axis=0) == pytest.approx(found.values, rel=1e-9)


def test_principal_components_are_directions_about_the_mean(rng):
    rows = (_matrix(rng) + rng.normal(size=120)).astype(np.float32)
    found = principal_components(lambda: (rows[i : i + 70] for i in range(0, 300, 70)), 120, 6)
    exact = rows.astype(float)
    about = exact - exact.mean(axis=0)
    _, values, vectors = np.linalg.svd(about, full_matrices=False)
    assert np.allclose(found.mean, exact.mean(axis=0), atol=1e-6)
    assert found.energy == pytest.approx((values**2).sum(), rel=1e-5)
    assert np.allclose(found.vectors @ found.vectors.T, np.eye(6), atol=1e-6)
    # after three passes the nineteenth direction is (0.8^13)^7 of the sixth: what single precision leaves of rows near 1
    assert np.linalg.svd(found.vectors @ vectors[:6].T)[1].min() > 1 - 1e-5
    coordinates = found.coordinates(rows)
    assert np.allclose(coordinates, about @ found.vectors.T, atol=1e-5)
    assert (np.diff((coordinates**2).sum(axis=0)) < 0).all()


def test_components_of_rounding_are_left_out(rng):
    rows = (rng.normal(size=(50, 3)) @ rng.normal(size=(3, 200)) + 5.0).astype(np.float32)
    assert len(principal_components(lambda: [rows], 200, 20).vectors) == 3


def falling_rows(random: np.random.Generator, rows: int, columns: int, decay: float) -> np.ndarray:
    """Random rows whose singular values fall geometrically."""
    left, right = (np.linalg.qr(random.normal(size=(size, 60)))[0] for size in (rows, columns))
    return (left * decay ** np.arange(60)) @ right.T


@pytest.mark.parametrize("block", [1, 37, 300])
def test_agrees_with_the_decomposition_of_everything(rng, block):
    rows = falling_rows(rng, 900, 150, 0.7)
    sketch = RowSketch(150, 30)
    for first in range(0, 900, block):
        sketch.add(rows[first : first + block])
    found = sketch.directions(10)
    directions, values = found.vectors, found.values
    _, expected, exact = np.linalg.svd(rows, full_matrices=False)
    assert values == pytest.approx(expected[:10], rel=1e-4)
    # the tenth direction is parted from its neighbours by 0.7: single precision turns it by parts of a thousandth
    assert np.abs(np.einsum("kc,kc->k", directions, exact[:10])) == pytest.approx(1.0, abs=1e-5)
    assert directions @ directions.T == pytest.approx(np.eye(10), abs=1e-12)
    assert found.energy == pytest.approx((rows**2).sum(), rel=1e-6)


def test_gives_no_more_directions_than_there_are(rng):
    rows = rng.normal(size=(20, 3)) @ rng.normal(size=(3, 50))
    sketch = RowSketch(50, 20)
    sketch.add(rows)
    found = sketch.directions(10)
    directions, values = found.vectors, found.values
    assert directions.shape == (3, 50)
    assert (np.diff(values) <= 0).all()


def test_directions_may_be_asked_for_between_blocks(rng):
    rows = falling_rows(rng, 300, 80, 0.6)
    sketch, whole = RowSketch(80, 30), RowSketch(80, 30)
    sketch.add(rows[:150])
    sketch.directions(5)
    sketch.add(rows[150:])
    whole.add(rows)
    assert sketch.directions(5).values == pytest.approx(whole.directions(5).values, rel=1e-5)
