"""What edge features and boosted trees are made of: sums by hand, invariance to light, leaves as the formula has them."""

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.lips.contours.boosting import BoostedTrees, grow_trees, log_loss
from headcap.lips.contours.channels import BINS, NAMES, channel_images, integral_images, opponents
from headcap.lips.contours.features import FeaturePool, draw_pool
from headcap.lips.contours.settings import BoostingSettings


@pytest.fixture(scope="module")
def picture():
    return np.random.default_rng(3).uniform(0.02, 0.6, (40, 52, 3)).astype(np.float32)


def test_features_are_differences_of_box_means(picture):
    images = channel_images(picture)
    pool, integrals = draw_pool(260, 7, seed=4), integral_images(images)
    pixels = np.array([[7, 7], [20, 15], [44, 32]])
    values = pool(integrals, pixels)
    for k in range(len(pool)):
        for i, (x, y) in enumerate(pixels):
            means = [
                images[pool.channel[k], y + top : y + bottom + 1, x + left : x + right + 1].astype(float).mean()
                for left, top, right, bottom in pool.boxes[k]
                if right >= left
            ]
            expected = means[0] - (means[1] if len(means) > 1 else 0.0)
            assert values[k, i] == pytest.approx(expected, abs=1e-5)  # kept in single precision


@pytest.mark.parametrize("patch", [4, 8, 12])
def test_the_pool_keeps_within_its_patch_and_is_the_same_each_time(patch):
    pool, again = draw_pool(300, patch, seed=1), draw_pool(300, patch, seed=1)
    assert len(pool) == 300
    assert pool.reach_px <= patch
    np.testing.assert_array_equal(pool.boxes, again.boxes)
    assert not np.array_equal(pool.boxes, draw_pool(300, patch, seed=2).boxes)
    # every kind of feature is there: gradients and lines of each colour channel, histograms of edges
    assert set(pool.channel) == set(range(len(NAMES)))


def test_channels_see_neither_exposure_nor_white_balance(picture):
    gained = picture * np.array([0.5, 1.7, 0.9], np.float32)
    np.testing.assert_allclose(channel_images(gained), channel_images(picture), atol=2e-4)
    # but what differs within the picture
    other = picture.copy()
    other[10:20, 10:30, 2] *= 1.3
    assert np.abs(opponents(other) - opponents(picture)).max() > 0.1


def test_an_edge_is_counted_by_its_direction():
    step = np.full((40, 60, 3), 0.1, np.float32)
    step[:, 30:] = 0.4
    images = channel_images(step)
    first = NAMES.index("lightness_0")
    near = images[first : first + BINS, 10:30, 28:32]
    # it brightens to the right, the first of six directions, and to no other
    assert near[0].min() > 1.0
    assert np.abs(near[1:]).max() < 1e-6
    turned = channel_images(np.ascontiguousarray(step[::-1, ::-1]))
    half = turned[first : first + BINS, ::-1, ::-1]
    np.testing.assert_allclose(np.roll(images[first : first + BINS], BINS // 2, axis=0), half, atol=1e-5)
    # shares of a gradient add up to its strength
    strength = images[NAMES.index("lightness_edge")]
    np.testing.assert_allclose(images[first : first + BINS].sum(axis=0), strength, atol=1e-5)


def test_a_leaf_is_the_newton_step_of_the_logistic_loss():
    values = np.linspace(-1, 1, 400, dtype=np.float32)[None]
    shows = values[0] > 0.25
    shows[:20] = True
    settings = BoostingSettings(
        trees=1, depth=1, learning_rate=1.0, ridge=0.0, least_curvature=0.0, row_share=1.0, feature_share=1.0
    )
    trees = grow_trees(values, shows, settings, seed=0)
    weight = np.where(shows, 0.5 / shows.mean(), 0.5 / (1 - shows.mean()))
    above = values[0] > trees.threshold[0, 0]
    # at log-odds 0 the slope is w (1/2 - y), the curvature w / 4
    for side, leaf in ((~above, trees.value[0, 0]), (above, trees.value[0, 1])):
        newton = -(weight * (0.5 - shows))[side].sum() / (0.25 * weight[side]).sum()
        assert leaf == pytest.approx(newton, rel=1e-4)
    # no other of the 63 cuts has a lower sum of squared slopes over curvature
    assert abs(trees.threshold[0, 0] - 0.25) < 2 / 64


def test_trees_learn_what_no_single_feature_tells(rng):
    values = rng.normal(size=(3, 6000)).astype(np.float32)
    shows = (values[0] > 0) ^ (values[2] > 0)
    settings = BoostingSettings(trees=30, depth=3, learning_rate=0.3, feature_share=1.0)
    trees = grow_trees(values[:, :4000], shows[:4000], settings, seed=1)
    assert log_loss(trees(values[:, 4000:]), shows[4000:]) < 0.15
    one = grow_trees(values[:1, :4000], shows[:4000], settings, seed=1)
    assert log_loss(one(values[:1, 4000:]), shows[4000:]) > 0.65  # log 2 is 0.69


def test_trees_among_fewer_features_and_more_trees(rng):
    values = rng.normal(size=(6, 3000)).astype(np.float32)
    shows = values[1] + 0.5 * values[4] ** 2 + 0.3 * rng.normal(size=3000) > 0.5
    settings = BoostingSettings(trees=10, depth=3)
    trees = grow_trees(values, shows, settings, seed=1)
    used = trees.used
    np.testing.assert_array_equal(trees.numbered(used)(values[used]), trees(values))
    more = grow_trees(values, shows, settings, seed=2, start=trees(values))
    both = trees.then(more)
    np.testing.assert_allclose(both(values), trees(values) + more(values), atol=1e-5)
    assert log_loss(both(values), shows) < log_loss(trees(values), shows)
    # a scale that loses no bit changes no answer
    doubled = grow_trees(2 * values, shows, settings, seed=1)
    np.testing.assert_array_equal(doubled(2 * values), trees(values))


def test_the_other_kind_of_sample_counts_as_much_however_rare(rng):
    values = rng.normal(size=(1, 8000)).astype(np.float32)
    shows = rng.random(8000) < 0.1
    trees = grow_trees(values, shows, BoostingSettings(trees=20, depth=1), seed=0)
    # noise tells nothing: log-odds of zero, not those of one in ten
    assert abs(trees(values).mean()) < 0.1


def test_samples_of_one_kind_are_refused():
    with pytest.raises(InputError, match="0 of them on a contour"):
        grow_trees(np.zeros((2, 10), np.float32), np.zeros(10, bool), BoostingSettings(), seed=0)


def test_a_node_that_does_not_part_sends_all_to_one_side():
    trees = BoostedTrees(np.zeros((1, 3), np.int32), np.full((1, 3), np.inf, np.float32), np.array([[1.0, 2, 3, 4]], np.float32))
    assert len(trees.used) == 0
    empty = FeaturePool(np.zeros(0, np.int32), np.zeros((0, 2, 4), np.int32))
    assert empty.reach_px == 0
    np.testing.assert_array_equal(trees(np.full((1, 2), 9.0, np.float32)), [1.0, 1.0])
