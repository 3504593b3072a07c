"""Head motion, gaps and swapped labels of markers, against the truth they were made from."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.expressions.markers import MarkerSettings, MarkerTake
from headcap.expressions.markers.gaps import fill_gaps
from headcap.expressions.markers.head import head_motion, rigid_markers
from headcap.expressions.markers.swaps import find_swaps, refuse_swaps
from headcap.geometry.transforms import invert

SETTINGS = MarkerSettings()


def with_gaps(take, gaps):
    positions = take.positions_m.copy()
    for marker, first, last in gaps:
        positions[first : last + 1, marker] = np.nan
    return replace(take, positions_m=positions)


def test_the_heads_motion_is_that_of_the_rigid_markers_through_their_gaps(person):
    take = with_gaps(person.take, [(0, 10, 40), (3, 30, 60), (5, 90, 119)])
    motion, residual_mm = head_motion(take, np.arange(7), 0, SETTINGS)
    true = person.capture_from_head[0] @ invert(person.capture_from_head)
    found = np.einsum("fij,fkj->fki", motion[:, :3, :3], person.take.positions_m[:, 7:]) + motion[:, None, :3, 3]
    wanted = np.einsum("fij,fkj->fki", true[:, :3, :3], person.take.positions_m[:, 7:]) + true[:, None, :3, 3]
    # noise of a few markers at arm's length of the face, and of the neutral frame they are anchored to
    assert np.sqrt(((found - wanted) ** 2).sum(axis=2).mean()) < 3 * person.noise_m
    # 6 of 21 degrees of freedom go into the fit; a residual has three coordinates
    assert residual_mm == pytest.approx(1e3 * person.noise_m * np.sqrt(3 * 15 / 21), rel=0.2)


def test_rigid_markers_are_found_by_their_distances(person):
    found = [person.take.names[k] for k in rigid_markers(person.take, None, SETTINGS)]
    assert set(person.rigid) <= set(found)
    moving = np.linalg.norm(person.displacements[:, person.face], axis=2).max(axis=0) > 0.004
    assert not {f"m{k}" for k in np.flatnonzero(moving)} & set(found)
    assert list(rigid_markers(person.take, person.rigid, SETTINGS)) == list(range(7))


def test_rigid_markers_that_are_none_or_too_few_are_refused(person):
    lip = int(np.linalg.norm(person.displacements[:, person.face], axis=2).max(axis=0).argmax())
    wrong = person.take.numbers([*person.rigid[:5], f"m{lip}"])
    with pytest.raises(InputError, match=rf"rigid marker m{lip} lies \d+\.\d mm rms off"):
        head_motion(person.take, wrong, 0, SETTINGS)
    with pytest.raises(InputError, match="no marker nobody"):
        rigid_markers(person.take, ["nobody"], SETTINGS)
    with pytest.raises(InputError, match="2 markers named as rigid"):
        rigid_markers(person.take, person.rigid[:2], SETTINGS)
    gone = with_gaps(person.take, [(k, 20, 22) for k in range(5)])
    with pytest.raises(InputError, match="less than three rigid markers, or three in a line, in frames 20 to 22"):
        head_motion(gone, np.arange(7), 0, SETTINGS)


def head_take(person, noise=True):
    positions = person.head_positions[:, 7:]
    if noise:
        positions = positions + person.noise_m * np.random.default_rng(4).normal(size=positions.shape)
    return MarkerTake(person.take.names[7:], positions, person.take.time_s, "synthetic")


def test_short_gaps_are_filled_to_twice_the_noise_and_nothing_else_changes(person):
    take, random = head_take(person), np.random.default_rng(6)
    starts = random.integers(10, 90, size=66)
    gapped = with_gaps(take, [(k, start, start + 11) for k, start in enumerate(starts)])
    filled, count = fill_gaps(gapped, SETTINGS)
    missing = ~gapped.seen
    assert count == missing.sum() == 12 * 66
    np.testing.assert_array_equal(filled[~missing], take.positions_m[~missing])
    error_m = np.sqrt(((filled - head_take(person, noise=False).positions_m)[missing] ** 2).sum(axis=-1).mean())
    # so much ridge that neighbours foretell nothing
    in_time = fill_gaps(gapped, MarkerSettings(ridge=1e9))[0]
    time_m = np.sqrt(((in_time - head_take(person, noise=False).positions_m)[missing] ** 2).sum(axis=-1).mean())
    assert error_m < 2 * np.sqrt(3) * person.noise_m
    # what the neighbours tell is worth it: speech moves by millimetres within a gap of 0.2 s
    assert error_m < 0.2 * time_m


def test_a_linear_motion_is_carried_over_any_gap_at_ends_too(rng):
    shared = rng.normal(size=(200, 2))
    shapes = 0.003 * rng.normal(size=(2, 9, 3))
    positions = 0.1 * rng.normal(size=(9, 3)) + np.einsum("fs,skc->fkc", shared, shapes)
    take = MarkerTake(tuple("abcdefghi"), positions, np.arange(200) / 60, "made")
    gapped = with_gaps(take, [(0, 0, 9), (1, 50, 64), (2, 190, 199)])
    filled, _ = fill_gaps(gapped, MarkerSettings(ridge=1e-10))
    np.testing.assert_allclose(filled, positions, atol=1e-7)


def test_with_few_frames_the_cubic_in_time_is_left(rng):
    times = np.arange(12) / 60
    line = times[:, None, None] * rng.normal(size=(2, 3)) + [[0.0, 0, 0], [0.1, 0, 0]]
    take = MarkerTake(("a", "b"), line, times, "made")
    filled, _ = fill_gaps(with_gaps(take, [(0, 5, 7)]), SETTINGS)
    np.testing.assert_allclose(filled, take.positions_m, atol=1e-12)


def test_long_gaps_are_refused_with_names_and_frames_and_the_limit_itself_is_not(person):
    take = head_take(person)
    longest = round(SETTINGS.longest_gap_s * person.rate_hz)
    fill_gaps(with_gaps(take, [(4, 30, 30 + longest - 1)]), SETTINGS)
    with pytest.raises(InputError, match=rf"gaps longer than 0\.25 s: m4 in frames 30 to {30 + longest}; m9 in frames 60 to 80"):
        fill_gaps(with_gaps(take, [(4, 30, 30 + longest), (9, 60, 80), (11, 3, 5)]), SETTINGS)


def test_swapped_labels_are_found_named_and_refused(person):
    assert not find_swaps(person.take)
    names = person.take.names
    apart = np.linalg.norm(person.take.positions_m[0][:, None] - person.take.positions_m[0][None], axis=2)
    np.fill_diagonal(apart, np.inf)
    # the nearest pair of the face is the hardest
    first, second = (int(k) for k in np.unravel_index(apart[7:, 7:].argmin(), (66, 66)))
    first, second = sorted((first + 7, second + 7))
    positions = person.take.positions_m.copy()
    positions[50:80, [first, second]] = positions[50:80, [second, first]]
    swapped = replace(person.take, positions_m=positions)
    assert [(swap.first, swap.second, swap.frame) for swap in find_swaps(swapped)] == [
        (names[first], names[second], 50),
        (names[first], names[second], 80),
    ]
    with pytest.raises(InputError, match=f"swap labels: {names[first]} and {names[second]} at frame 50; .* at frame 80"):
        refuse_swaps(swapped)


def test_swaps_are_found_across_a_gap_and_where_one_takes_the_place_of_an_unseen_one(person):
    positions = person.take.positions_m.copy()
    positions[60:, [20, 33]] = positions[60:, [33, 20]]
    positions[57:60, [20, 33]] = np.nan
    assert [(s.first, s.second, s.frame) for s in find_swaps(replace(person.take, positions_m=positions))] == [("m13", "m26", 60)]
    stolen = person.take.positions_m.copy()
    stolen[60:, 20], stolen[60:, 33] = stolen[60:, 33], np.nan
    assert [(s.first, s.second, s.frame) for s in find_swaps(replace(person.take, positions_m=stolen))] == [("m13", "m26", 60)]
