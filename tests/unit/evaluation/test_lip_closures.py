"""Closures of lips: found where they are, not found where they are not, and never by more than chance where there is nothing."""

import numpy as np
import pytest
from scipy.stats import binom

from headcap.evaluation.lip_closures import (
    WITHIN_S,
    ClosureTest,
    chance_of_as_many,
    chance_of_such_ranks,
    check_closures,
    gap_minima,
    shut_below,
)

TIME_S = np.arange(150) / 25
SPOKEN_S = (0.5, 5.5)
CLOSED_S = np.array([1.0, 2.2, 3.32, 4.6])


def talking(closed_s=CLOSED_S):
    """Lips that open with each syllable and shut at some moments."""
    gap = 6 + 1.5 * np.cos(2 * np.pi * 3.1 * TIME_S)
    for moment in closed_s:
        gap -= (gap - 0.3) * np.exp(-0.5 * ((TIME_S - moment) / 0.05) ** 2)
    return gap


def test_minima_are_told_between_wider_frames():
    gap = np.full(40, 5.0)
    gap[[10, 11, 20]] = [1.0, 1.0, 2.0]
    gap[22] = 1.5  # a lower one, less than a basin away
    gap[0] = 0.0  # a fall that nothing was seen before
    assert gap_minima(TIME_S[:40], gap).tolist() == [10, 22]
    gap[[9, 12]] = np.nan
    assert gap_minima(TIME_S[:40], gap).tolist() == [10, 22]
    assert len(gap_minima(TIME_S[:40], np.full(40, 3.0))) == 0
    assert len(gap_minima(TIME_S[:40], np.full(40, np.nan))) == 0


def test_closures_that_are_there_are_shown():
    test = check_closures(TIME_S, talking(), CLOSED_S, SPOKEN_S)
    assert test.shown.all()
    assert test.seen.all()
    # a closure reaches to the neighbouring frame at most, 0.02 s away: exp(-0.08) of the way to 0.3 mm
    assert (test.least < 0.3 + 7.2 * (1 - np.exp(-0.08))).all()
    # moments with as small a gap near lie within two windows of a closure: 4 x 0.32 of 5 s, ties half
    assert (test.rank < 4 * 4 * WITHIN_S / 5 / 2 + 0.05).all()
    assert 0.5 * test.expected < 4 * len(CLOSED_S) * 2 * WITHIN_S / 5


def test_lips_that_shut_at_other_times_show_nothing():
    """As a tracker does that lags: what it is held against does not follow it."""
    test = check_closures(TIME_S, talking(CLOSED_S + 0.3), CLOSED_S, SPOKEN_S)
    assert not test.shown.any()
    # nothing that moments at random would not have as well
    assert chance_of_such_ranks(test.rank) > 0.2


def test_chance_is_the_share_of_moments_that_would_pass(rng):
    gap = talking()
    moments = rng.uniform(*SPOKEN_S, 4000)
    at_random, test = (check_closures(TIME_S, gap, closed, SPOKEN_S) for closed in (moments, CLOSED_S))
    assert at_random.chance == test.chance
    # binomial spread of 4000 moments, four standard deviations
    spread = np.sqrt(test.chance * (1 - test.chance) / len(moments))
    assert abs(at_random.shown.mean() - test.chance) < 4 * spread + 0.004
    assert at_random.rank.mean() == pytest.approx(0.5, abs=4 / np.sqrt(12 * len(moments)) + 0.004)


def test_noise_is_shown_no_oftener_than_by_chance(rng):
    noise = ((rng.normal(size=len(TIME_S)), rng.uniform(*SPOKEN_S, 4)) for _ in range(60))
    tests = [check_closures(TIME_S, gap, moments, SPOKEN_S) for gap, moments in noise]
    shown, expected = sum(test.shown.sum() for test in tests), sum(test.expected for test in tests)
    spread = np.sqrt(sum(test.expected * (1 - test.chance) for test in tests))
    assert abs(shown - expected) < 3.5 * spread


def test_frames_without_an_answer_show_nothing():
    gap = talking()
    gap[np.abs(TIME_S - CLOSED_S[1]) <= WITHIN_S + 0.01] = np.nan
    test = check_closures(TIME_S, gap, CLOSED_S, SPOKEN_S)
    assert test.seen.tolist() == test.shown.tolist() == [True, False, True, True]
    assert np.isnan([test.least[1], test.rank[1]]).all()
    nothing = check_closures(TIME_S, np.full(len(TIME_S), np.nan), CLOSED_S, SPOKEN_S)
    assert not nothing.shown.any()
    assert nothing.chance == 0


def test_a_minimum_that_is_not_shut_is_none():
    gap = talking()
    near = np.abs(TIME_S - CLOSED_S[0]) < 0.1
    # half open, though narrower than before and after: the range begins above the three that are left
    gap[near] = np.maximum(gap[near], 0.5 * gap.max() + (TIME_S[near] - CLOSED_S[0]) ** 2)
    assert shut_below(TIME_S, gap, SPOKEN_S) < 0.5 * gap.max()
    assert check_closures(TIME_S, gap, CLOSED_S, SPOKEN_S).shown.tolist() == [False, True, True, True]


def some(shown, closures, chance):
    flags = np.arange(closures) < shown
    return ClosureTest(np.arange(closures), flags | True, flags, np.zeros(closures), np.zeros(closures), chance)


def test_the_chance_of_as_many_is_the_binomial_tail():
    assert chance_of_as_many([some(4, 6, 0.3)]) == pytest.approx(binom.sf(3, 6, 0.3), rel=1e-12)
    # however they are parted into clips, and with another chance in each
    assert chance_of_as_many([some(4, 4, 0.3), some(0, 2, 0.3)]) == pytest.approx(binom.sf(3, 6, 0.3), rel=1e-12)
    assert chance_of_as_many([some(1, 1, 0.5), some(1, 1, 0.2)]) == pytest.approx(0.1, rel=1e-12)
    assert chance_of_as_many([some(0, 5, 0.4)]) == pytest.approx(1.0)


def test_the_chance_of_low_ranks_is_that_of_sums_of_uniform_numbers(rng):
    assert chance_of_such_ranks([0.2]) == pytest.approx(0.2)
    assert chance_of_such_ranks([0.3, 0.3]) == pytest.approx(0.6**2 / 2)
    assert chance_of_such_ranks([0.5, np.nan, 0.5, 0.5]) == pytest.approx(0.5)
    assert chance_of_such_ranks([np.nan]) == 1.0
    drawn = rng.uniform(size=(40_000, 9)).mean(axis=1)
    exact = chance_of_such_ranks(np.full(9, 0.4))
    assert (drawn < 0.4).mean() == pytest.approx(exact, abs=4 * np.sqrt(exact / 40_000))
    # where the exact sum ends the normal distribution goes on
    assert chance_of_such_ranks(np.full(17, 0.4)) == pytest.approx(chance_of_such_ranks(np.full(16, 0.4)), rel=0.2)
