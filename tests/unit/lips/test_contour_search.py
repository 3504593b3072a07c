"""The search: the best of all rings and rims by enumeration, known contours found again, a shut mouth shut."""

from itertools import product

import numpy as np
import pytest

from headcap.lips.contours.finder import evened
from headcap.lips.contours.search import (
    _best_cycle,
    outward_normals,
    resample_ring,
    search_rims,
    search_ring,
    settle_ring,
)
from headcap.lips.contours.training import ring_distance

SHAPE = (90, 130)


def ellipse(middle=(65.0, 45.0), half=(40.0, 20.0), count=72):
    """From the left end (a subject's right corner) over the upper half."""
    angle = np.pi + 2 * np.pi * np.arange(count) / count
    return np.array(middle) + np.array(half) * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def ridge(*rings):
    """A map whose log-odds fall off from 4 with the distance to the nearest ring."""
    away = np.min([ring_distance(ring, *SHAPE) for ring in rings], axis=0)
    return (8 * np.exp(-0.5 * (away / 1.5) ** 2) - 4).astype(np.float32)


def test_the_cycle_is_the_best_of_all(rng):
    for _ in range(20):
        odds, stiffness = rng.normal(size=(5, 4)), 0.4
        path = _best_cycle(odds, stiffness, 2)

        def value(states, odds=odds, stiffness=stiffness):
            steps = np.diff([*states, states[0]])
            return -np.inf if np.abs(steps).max() > 2 else odds[range(5), states].sum() - stiffness * (steps**2).sum()

        best = max(product(range(4), repeat=5), key=value)
        assert value(path) == pytest.approx(value(best))


def test_a_ring_is_found_again_from_a_wrong_one():
    truth = ellipse()
    start = ellipse(half=(44.0, 16.0))
    found, odds = search_ring(ridge(truth), start, outward_normals(start, 3), 7.0, 0.5, 0.1)
    away = np.linalg.norm(found[:, None] - ellipse(count=4000), axis=2).min(axis=1)
    # offsets o = 4 cos 2t bend by 16 (2 pi / 72)^2 = 0.12 a place; stiffness 0.1 against the ridge's curvature of 3.6 leaves 0.01
    # of it, bilinear interpolation and the polygon of 72 places (40 (1 - cos(pi / 72)) = 0.04 within its ellipse) the rest
    assert away.max() < 0.15
    assert odds.min() > 3.0


def test_one_strong_spot_does_not_win_a_place():
    truth = ellipse()
    likelihood = ridge(truth)
    spot = truth[18] + [0.0, -6.0]
    likelihood[int(spot[1]) - 1 : int(spot[1]) + 2, int(spot[0]) - 1 : int(spot[0]) + 2] = 30.0
    found, _ = search_ring(likelihood, truth, outward_normals(truth, 3), 8.0, 0.5, 0.25)
    assert np.linalg.norm(found - truth, axis=1).max() < 0.5


@pytest.mark.parametrize(("shift", "size"), [((7.0, 0.0), (1.0, 1.0)), ((-5.0, 4.0), (1.12, 0.8)), ((0.0, 0.0), (0.9, 1.25))])
def test_a_ring_beside_the_mouth_is_moved_onto_it(shift, size):
    start = ellipse(half=(36.0, 18.0))
    truth = ellipse(np.array([65.0, 45.0]) + shift, np.array([36.0, 18.0]) * size)
    found = settle_ring(ridge(truth), start, 10.0)
    np.testing.assert_allclose(found, truth, atol=1e-9)  # sizes and shifts of its grid


def test_rings_are_parted_evenly_between_corners():
    ring = ellipse(count=90)
    even = resample_ring(ring, 40, 45)
    np.testing.assert_allclose(even[[0, 20]], ring[[0, 45]], atol=1e-12)
    step = np.linalg.norm(np.diff(even[:21], axis=0), axis=1)
    assert np.ptp(step) < 0.05 * step.mean()
    normals = outward_normals(even, 1)
    assert ((even - [65.0, 45.0]) * normals).sum(axis=1).min() > 0
    np.testing.assert_allclose(outward_normals(even[::-1], 1), normals[::-1], atol=1e-12)
    # corners that wandered along the ring are the outermost points again, but for what the smoothing takes off an end
    wandered = evened(np.roll(even, 3, axis=0))
    np.testing.assert_allclose(wandered[[0, 20]], ring[[0, 45]], atol=0.6)


def rims(likelihood, **changed):
    stations = np.arange(2.0, 80.0, 2.0)
    given = {
        "origin": np.array([25.0, 45.0]),
        "across": np.array([1.0, 0.0]),
        "stations": stations,
        "upper": np.zeros(len(stations)),
        "lower": np.zeros(len(stations)),
        "offsets": np.arange(-18.0, 18.5, 1.0),
        "bounds": np.tile([-18.0, 18.0], (len(stations), 1)),
        "stiffness": 0.1,
    } | changed
    return stations, search_rims(likelihood, **given)


def test_an_open_mouth_has_two_rims():
    truth = ellipse(half=(32.0, 12.0), count=400)
    stations, (upper, lower, odds) = rims(ridge(truth))
    inside = (stations > 14) & (stations < 66)
    height = 12 * np.sqrt(1 - ((stations[inside] - 40) / 32) ** 2)
    np.testing.assert_allclose(upper[inside], -height, atol=0.6)
    np.testing.assert_allclose(lower[inside], height, atol=0.6)
    known = np.isfinite(upper)
    # it begins and ends shut, near the ellipse's ends
    assert stations[known][0] == pytest.approx(8, abs=3)
    assert stations[known][-1] == pytest.approx(72, abs=3)
    for end in (0, -1):
        assert lower[known][end] - upper[known][end] == pytest.approx(0, abs=1e-9)
    assert (odds[known] > 0).mean() > 0.9


def test_a_shut_mouth_is_one_line():
    line = np.stack([np.linspace(30, 100, 50), 45 + 3 * np.sin(np.linspace(0, 3, 50))], axis=1)
    stations, (upper, lower, _) = rims(ridge(np.concatenate([line, line[::-1]])))
    known = np.isfinite(upper)
    np.testing.assert_array_equal(upper[known], lower[known])
    truth = np.interp(25 + stations[known], line[:, 0], line[:, 1]) - 45
    middle = slice(2, -2)
    np.testing.assert_allclose(upper[known][middle], truth[middle], atol=0.4)


def test_what_lies_beyond_the_outer_contour_is_no_rim():
    line = np.stack([np.linspace(30, 100, 50), np.full(50, 45.0)], axis=1)
    nose = line - np.array([0.0, 12.0])
    likelihood = ridge(np.concatenate([line, line[::-1]]), np.concatenate([nose, nose[::-1]]))
    bounds = np.tile([-8.0, 8.0], (39, 1))
    _, (upper, lower, _) = rims(likelihood, bounds=bounds)
    assert np.nanmax(np.abs([upper, lower])) < 0.5


def test_no_edge_no_rim():
    assert rims(np.full(SHAPE, -3.0, np.float32))[1] is None
