"""The temporal prior: the exact minimum of what it states, its answer to frequencies, and gaps."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from headcap.neck.fitting.temporal import TemporalPrior, second_differences, smoothed, smoothed_placements, smoothed_rotations


def test_smoothing_is_the_minimum_of_data_and_accelerations(rng):
    time_s = np.cumsum(rng.uniform(0.5, 1.5, 40)) / 60
    values, weights = rng.normal(size=(40, 3)), rng.uniform(0.1, 2.0, 40)
    prior = TemporalPrior(cutoff_hz=6.0)
    found = smoothed(values, time_s, prior, weights)
    step = np.median(np.diff(time_s))
    strength = (2 * np.sin(np.pi * 6.0 * step)) ** -4

    def energy(at):
        rows = second_differences(time_s / step)
        bent = rows[:, :1] * at[:-2] + rows[:, 1:2] * at[1:-1] + rows[:, 2:] * at[2:]
        return (weights[:, None] * (at - values) ** 2).sum() + strength * (bent**2).sum()

    for _ in range(10):
        direction = rng.normal(size=found.shape)
        slope = (energy(found + 1e-4 * direction) - energy(found - 1e-4 * direction)) / 2e-4
        assert abs(slope) < 1e-6 * energy(found) / 1e-3
        assert energy(found + 1e-2 * direction) > energy(found)


@pytest.mark.parametrize(("frequency", "rate"), [(8.0, 60.0), (2.0, 60.0), (16.0, 60.0), (4.0, 30.0)])
def test_motion_keeps_the_share_that_is_stated(frequency, rate):
    time_s = np.arange(1200) / rate
    motion = np.sin(2 * np.pi * frequency * time_s)
    found = smoothed(motion, time_s, TemporalPrior(cutoff_hz=8.0))
    inside = slice(300, 900)
    kept = (found[inside] @ motion[inside]) / (motion[inside] @ motion[inside])
    wanted = 1 / (1 + (np.sin(np.pi * frequency / rate) / np.sin(np.pi * 8.0 / rate)) ** 4)
    assert kept == pytest.approx(wanted, abs=1e-6)


def test_jitter_falls_while_a_shake_stays(rng):
    time_s = np.arange(600) / 60
    noise = rng.normal(size=600)
    prior = TemporalPrior()
    assert smoothed(noise, time_s, prior).std() < 0.6 * noise.std()
    shake = np.sin(2 * np.pi * 3.0 * time_s)
    # (3 / 8)^4 = 2 %
    assert np.abs(smoothed(shake, time_s, prior) - shake)[30:-30].max() < 0.025


def test_straight_lines_pass_and_gaps_are_bridged():
    time_s = np.arange(50) / 30
    line = np.stack([time_s, 3 - 2 * time_s], axis=1)
    weights = np.ones(50)
    weights[20:28] = weights[-3:] = 0
    holed = np.where(weights[:, None] > 0, line, np.nan)
    assert np.allclose(smoothed(holed, time_s, TemporalPrior(cutoff_hz=3.0), weights), line, atol=1e-8)
    assert np.allclose(smoothed(holed, time_s, TemporalPrior(cutoff_hz=30.0), weights), line, atol=1e-6)
    assert np.isnan(smoothed(holed, time_s, TemporalPrior(), np.zeros(50))).any()


def test_rotations_are_smoothed_alike_in_any_frame_of_the_room(rng):
    time_s = np.arange(60) / 30
    turns = Rotation.from_rotvec(0.3 * np.sin(np.outer(time_s, [3.0, 5.0, 2.0])) + 0.02 * rng.normal(size=(60, 3)))
    other = Rotation.from_rotvec([2.0, -1.5, 1.0])
    prior = TemporalPrior(cutoff_hz=4.0)
    plain, moved = (
        smoothed_rotations(turns.as_matrix(), time_s, prior),
        smoothed_rotations((other * turns).as_matrix(), time_s, prior),
    )
    assert np.allclose(other.as_matrix() @ plain, moved, atol=1e-9)
    placement = np.tile(np.eye(4), (60, 1, 1))
    placement[:, :3, :3], placement[:, :3, 3] = turns.as_matrix(), rng.normal(size=(60, 3))
    out = smoothed_placements(placement, time_s, prior)
    assert np.allclose(out[:, :3, :3] @ out[:, :3, :3].transpose(0, 2, 1), np.eye(3), atol=1e-12)
    assert np.allclose(out[:, :3, 3], smoothed(placement[:, :3, 3], time_s, prior))
