"""Directions of rows seen once against the singular value decomposition of all of them."""

import numpy as np
import pytest

from headcap.neck.training.row_sketch import RowSketch


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
    directions, values = sketch.directions(10)
    _, expected, exact = np.linalg.svd(rows, full_matrices=False)
    assert values == pytest.approx(expected[:10], rel=1e-4)
    # the tenth direction is parted from its neighbours by 0.7: single precision turns it by parts of a thousandth
    assert np.abs(np.einsum("kc,kc->k", directions, exact[:10])) == pytest.approx(1.0, abs=1e-5)
    assert directions @ directions.T == pytest.approx(np.eye(10), abs=1e-12)
    assert sketch.energy == pytest.approx((rows**2).sum(), rel=1e-6)


def test_gives_no_more_directions_than_there_are(rng):
    rows = rng.normal(size=(20, 3)) @ rng.normal(size=(3, 50))
    sketch = RowSketch(50, 20)
    sketch.add(rows)
    directions, values = sketch.directions(10)
    assert directions.shape == (3, 50)
    assert (np.diff(values) <= 0).all()


def test_directions_may_be_asked_for_between_blocks(rng):
    rows = falling_rows(rng, 300, 80, 0.6)
    sketch, whole = RowSketch(80, 30), RowSketch(80, 30)
    sketch.add(rows[:150])
    sketch.directions(5)
    sketch.add(rows[150:])
    whole.add(rows)
    assert sketch.directions(5)[1] == pytest.approx(whole.directions(5)[1], rel=1e-5)
