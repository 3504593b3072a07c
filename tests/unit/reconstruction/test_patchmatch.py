"""Hypotheses: random numbers, warps, acceptance of random changes."""

import numpy as np

from headcap.reconstruction import patchmatch, windows
from headcap.reconstruction.settings import ReconstructSettings
from headcap.reconstruction.views import build_level, choose_sources, pair_geometry, pinhole_views, subject_centre

SETTINGS = ReconstructSettings()


def _scene(ball, *, level=0, view=0):
    views = pinhole_views(ball.rig, ball.images, None, SETTINGS)
    stacked = build_level(views, level, 0.6)
    sources = choose_sources(ball.rig, subject_centre(ball.rig), SETTINGS.matching)[view]
    m, t = pair_geometry([v.camera for v in views], stacked.matrices, view, sources)
    return stacked, sources, m, t


def _warp(m):
    """The warp of a cell at (100.5, 120.5) by a homography that does not depend on depth."""
    warp = np.empty((1, 12), np.float32)
    windows.aim(m[None], np.zeros((1, 3)), 100.5, 120.5, warp)
    return warp


def test_random_numbers_fill_the_interval():
    state = np.array([5], np.uint64)
    drawn = np.array([patchmatch.next_random(state) for _ in range(4000)])
    assert drawn.min() >= -1
    assert drawn.max() < 1
    # mean and variance of a uniform draw over [-1, 1), to 5 standard errors
    assert abs(drawn.mean()) < 5 * (1 / 3 / 4000) ** 0.5
    assert abs(drawn.var() - 1 / 3) < 5 * (4 / 45 / 4000) ** 0.5


def test_warp_of_a_plane_is_the_projection_of_its_points(ball):
    _, sources, m, t = _scene(ball)
    rng = np.random.default_rng(3)
    views = pinhole_views(ball.rig, ball.images, None, SETTINGS)
    own = views[0].camera
    u, v, w = rng.uniform(20, 180, 50), rng.uniform(20, 180, 50), rng.uniform(1.2, 1.5, 50)
    rays = np.stack([u, v, np.ones(50)], 1) @ np.linalg.inv(own.matrix).T
    world = (rays / w[:, None] - own.camera_from_world[:3, 3]) @ own.camera_from_world[:3, :3]
    for k, source in enumerate(sources):
        warped = np.stack([u, v, np.ones(50)], 1) @ m[k].T + w[:, None] * t[k]
        np.testing.assert_allclose(warped[:, :2] / warped[:, 2:], views[source].camera.project(world)[0], atol=1e-8)


def test_correlation_is_perfect_with_itself(ball):
    stacked, _, _, _ = _scene(ball)
    du, dv = windows.window_offsets(2, 8)
    patch = np.empty(64, np.float32)
    energy = windows.load_patch(stacked.images[0], 100.5, 120.5, du, dv, patch)
    height, width = stacked.images.shape[1:]
    cost = windows.correlate(
        stacked.images.reshape(-1), 0, width, width, height, _warp(np.eye(3)), 0,
        np.float32(1), np.float32(0), np.float32(0), du, dv, patch, energy,
    )  # fmt: skip
    assert abs(cost) < 1e-4  # float32 sums of 64 squares of 8-bit levels


def test_checkered_samples_are_half_of_all_and_reach_as_far():
    every, half = (np.stack(f(2, 8)) for f in (windows.window_offsets, windows.checkered_offsets))
    assert half.shape == (2, 32)
    np.testing.assert_array_equal(half[:, [0, -1]], every[:, [0, -1]])
    assert set(zip(*half, strict=True)) < set(zip(*every, strict=True))
    assert not half.sum(1).any()  # balanced about the cell's centre
    assert windows.checkered_offsets(1, 7)[0].size == 25  # of 49: the corners' colour has one more


def test_window_leaving_the_source_never_matches(ball):
    stacked, _, _, _ = _scene(ball)
    du, dv = windows.window_offsets(2, 8)
    patch = np.empty(64, np.float32)
    energy = windows.load_patch(stacked.images[0], 100.5, 120.5, du, dv, patch)
    height, width = stacked.images.shape[1:]
    aside = np.eye(3)
    aside[0, 2] = 97.0  # 100.5 + 97 + half a window is beyond the last column
    cost = windows.correlate(
        stacked.images.reshape(-1), 0, width, width, height, _warp(aside), 0,
        np.float32(1), np.float32(0), np.float32(0), du, dv, patch, energy,
    )  # fmt: skip
    assert cost == windows.NO_MATCH


def test_random_changes_are_accepted_and_never_raise_the_cost(ball):
    stacked, sources, m, t = _scene(ball, level=1)
    active = np.ones((60, 50), bool)
    plane = np.zeros((60, 50, 3), np.float32)
    plane[..., 0] = 1 / 0.72
    cost = np.full((60, 50), windows.NO_MATCH, np.float32)
    settled = np.zeros((60, 50), np.uint8)
    limits = np.array([1 / 0.95, 1 / 0.65], np.float32)
    accepted = []
    for sweep in range(3):
        before = cost.copy()
        accepted.append(
            patchmatch.propagate(
                stacked.images, stacked.sizes, 0, sources, m, t, 2, 8, limits, 2, np.float32(0.5), 0, 3, 1.0, 1e-3,
                np.uint64(sweep + 1), sweep % 2 == 1, settled, active, plane, cost,
            )
        )  # fmt: skip
        assert (cost <= before).all()
    # a first draw improves about half of the cells; an LCG that overflows gives none or a handful
    assert accepted[0] > 0.2 * active.sum()
