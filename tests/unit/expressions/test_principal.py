"""Laws of eq. 2: eigenfaces are those of the whole matrix, however the frames come."""

import tracemalloc

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.expressions import Performance
from headcap.expressions.performance import in_memory
from headcap.expressions.principal import EXACT, eigenfaces

NO_TRIANGLES = np.zeros((0, 3), np.int32)
LONG = EXACT + 200


def performance_of(displacements, block=64):
    count, points = displacements.shape[:2]
    neutral = np.arange(3 * points).reshape(points, 3) / 1000
    return Performance(neutral, NO_TRIANGLES, in_memory(displacements, block), np.arange(count) / 30, "take")


def moving(rng, frames, points, modes=25, decay=0.75):
    """Metres: motion whose variances fall geometrically, about an offset."""
    weights = rng.normal(size=(frames, modes)) * 1e-3 * decay ** np.arange(modes)
    shapes = rng.normal(size=(modes, 3 * points))
    rows = weights @ shapes + 2e-3 * rng.normal(size=3 * points)
    return rows.astype(np.float32).reshape(frames, points, 3)


def exact(displacements):
    rows = displacements.reshape(len(displacements), -1).astype(float)
    about = rows - rows.mean(axis=0)
    _, values, vectors = np.linalg.svd(about, full_matrices=False)
    return values**2 / len(rows), vectors


def share_of(displacements):
    rows = displacements.reshape(len(displacements), -1).astype(float)
    rows -= rows.mean(axis=0)
    variances = np.linalg.eigvalsh(rows @ rows.T if len(rows) < rows.shape[1] else rows.T @ rows)[::-1]
    return np.cumsum(variances) / variances.sum()


@pytest.mark.parametrize(
    ("frames", "points"), [(60, 90), (600, 20), (LONG, (EXACT + 100) // 3)], ids=["gram", "covariance", "long"]
)
def test_eigenfaces_are_those_of_the_decomposition_of_everything(rng, frames, points):
    displacements = moving(rng, frames, points)
    found = eigenfaces(performance_of(displacements), count=8)
    variances, vectors = exact(displacements)
    # squares of single precision; what an iteration leaves of the nineteenth direction in the eighth is smaller
    np.testing.assert_allclose(found.variances, variances[:8], rtol=1e-5)
    np.testing.assert_allclose(found.total_variance, variances.sum(), rtol=1e-5)
    np.testing.assert_allclose(found.rows @ found.rows.T, np.eye(8), atol=1e-6)
    assert np.linalg.svd(found.rows @ vectors[:8].T)[1].min() > 1 - 1e-5
    np.testing.assert_allclose(found.mean, displacements.mean(axis=0, dtype=float), atol=1e-9)


@pytest.mark.parametrize(("frames", "points"), [(80, 50), (LONG, 250)])
@pytest.mark.parametrize("coverage", [0.9, 0.995])
def test_as_few_axes_as_cover(rng, frames, points, coverage):
    displacements = moving(rng, frames, points)
    found = eigenfaces(performance_of(displacements), coverage=coverage)
    share = share_of(displacements)
    assert len(found) == np.searchsorted(share, coverage) + 1
    np.testing.assert_allclose(found.coverage, share[: len(found)], atol=1e-6)


def test_more_axes_than_the_search_begins_with(rng):
    displacements = moving(rng, LONG, 250, modes=200, decay=0.99)
    share = share_of(displacements)
    expected = np.searchsorted(share, 0.995) + 1
    assert expected > 100
    found = eigenfaces(performance_of(displacements))
    assert abs(len(found) - expected) <= 1
    assert found.coverage[-1] >= 0.995


@pytest.mark.parametrize("block", [1, 37, LONG])
def test_blocks_and_order_of_frames_do_not_matter(rng, block):
    displacements = moving(rng, LONG, 200)
    one = eigenfaces(performance_of(displacements), count=5)
    other = eigenfaces(performance_of(rng.permutation(displacements), block), count=5)
    np.testing.assert_allclose(one.variances, other.variances, rtol=1e-5)
    # parted from its neighbours by a quarter of its own, an axis turns by single precision's rounding alone
    np.testing.assert_allclose(np.einsum("kc,kc->k", one.rows, other.rows), 1.0, atol=1e-5)


def test_axes_point_the_way_of_the_mean(rng):
    displacements = moving(rng, 50, 40)
    found = eigenfaces(performance_of(displacements), count=4)
    along = found.rows @ found.mean.ravel()
    assert (along[np.abs(along) > 1e-2 * np.linalg.norm(found.mean)] > 0).all()


def test_frames_are_not_held_in_memory(rng):
    frames, points = 4000, 1000
    shapes = rng.normal(size=(6, 3 * points)).astype(np.float32)
    weights = rng.normal(size=(frames, 6)).astype(np.float32) * 1e-3

    def blocks():
        for first in range(0, frames, 64):
            yield (weights[first : first + 64] @ shapes).reshape(-1, points, 3)

    made = Performance(np.zeros((points, 3)), NO_TRIANGLES, blocks, np.arange(frames) / 30, "made")
    tracemalloc.start()
    found = eigenfaces(made)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(found) == 6
    # 48 MB of frames; 256 of them gathered and 58 directions in double, a few times each
    assert peak < 24e6


def test_frames_that_are_not_finite_are_named(rng):
    displacements = moving(rng, 200, 10)
    displacements[[7, 130], 3, 1] = np.nan
    displacements[131, 0, 0] = np.inf
    with pytest.raises(InputError, match=r"3 of 200 frames: 7, 130, 131"):
        eigenfaces(performance_of(displacements))


def test_many_broken_frames_are_counted(rng):
    displacements = moving(rng, 200, 10)
    displacements[50:] = np.nan
    with pytest.raises(InputError, match=r"150 of 200 frames: 50, .* and 140 more"):
        eigenfaces(performance_of(displacements))


def test_fewer_frames_than_axes_are_refused(rng):
    with pytest.raises(InputError, match=r"take has 12 frames; expected at least 13 for 12 eigenfaces"):
        eigenfaces(performance_of(moving(rng, 12, 10)), count=12)
    assert len(eigenfaces(performance_of(moving(rng, 12, 10)), count=11)) == 11


def test_a_performance_that_does_not_move_is_refused():
    with pytest.raises(InputError, match="does not move"):
        eigenfaces(performance_of(np.full((20, 10, 3), 0.25, np.float32)))


def test_frames_of_another_topology_are_refused(rng):
    made = performance_of(moving(rng, 20, 11))
    other = Performance(made.neutral[:10], NO_TRIANGLES, made.blocks, made.time_s, "take")
    with pytest.raises(InputError, match="11 points; expected 10"):
        eigenfaces(other)


def test_noise_that_no_number_of_axes_covers_is_refused(rng, monkeypatch):
    monkeypatch.setattr("headcap.expressions.principal.MOST", 100)
    noise = rng.normal(size=(LONG, 200, 3)).astype(np.float32)
    with pytest.raises(InputError, match=r"100 eigenfaces cover .* of the variance; expected 99.9"):
        eigenfaces(performance_of(noise), coverage=0.999)


@pytest.mark.parametrize(("frames", "points"), [(60, 40), (LONG, 200)])
def test_directions_of_rounding_are_no_axes(rng, frames, points):
    displacements = moving(rng, frames, points, modes=3)
    assert len(eigenfaces(performance_of(displacements), count=20)) == 3
