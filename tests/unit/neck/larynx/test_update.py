"""Laws of eq. 14 to 19: sums over bins stand for all frames, and the update is the least of its energy."""

import numpy as np
import pytest

from headcap.neck.larynx.base_shape import Throat
from headcap.neck.larynx.update import LarynxUpdateSettings, SlideSums, update_larynx

SETTINGS = LarynxUpdateSettings()


@pytest.fixture(scope="module")
def frames(spoken):
    one = spoken[0]
    throats = one.subject.meshes[:, one.person.larynx.vertices].astype(float)
    return one, throats, one.tau_m, one.alpha


def _sums(larynx, throats, tau, alpha) -> SlideSums:
    sums = SlideSums.over(larynx, tau.min(), tau.max(), 0.25e-3)
    for first in range(0, len(tau), 70):
        sums.add(throats[first : first + 70], tau[first : first + 70], alpha[first : first + 70])
    return sums


def test_sums_are_those_of_all_frames(frames):
    one, throats, tau, alpha = frames
    larynx = one.person.larynx
    sums = _sums(larynx, throats, tau, alpha)
    shown = np.array([a @ larynx.weights_m.ravel() for a in sums.matrices()])
    weights = larynx.weights_at(tau)[0] * alpha[:, None]
    assert sums.frames == len(tau)
    assert np.allclose(sums.total, throats.sum(0))
    # linear between bins a quarter millimetre apart: (0.25 mm)^2 / 8 of a second derivative of 5 mm / (7 mm)^2 per frame
    bound = 1.6 * 0.25e-3**2 / 8 * 5e-3 / 0.007**2 * len(tau)
    assert np.abs(sums.linear @ shown - weights.sum(0)).max() < bound
    squares = sums.own @ shown**2 + 2 * sums.mixed[:-1] @ (shown[:-1] * shown[1:])
    assert np.abs(squares - (weights**2).sum(0)).max() < 2 * bound * weights.max()
    moment = np.einsum("bk,bki->ki", shown, sums.moment)
    assert np.abs(moment - np.einsum("fk,fki->ki", weights, throats)).max() < bound * np.abs(throats).max()


def _energy(one, throats, tau, alpha, throat, base, larynx, before) -> float:
    left = throats - base - larynx.offset(tau, alpha).values
    stay = SETTINGS.base_stay * ((base - before[0]) ** 2).sum()
    stay += SETTINGS.weights_stay * ((larynx.weights_m - before[1].weights_m) ** 2).sum()
    terms = SETTINGS.laplacian * throat.roughness(base) + SETTINGS.boundary * throat.border_error(base)
    return float((left**2).sum()) + len(tau) * (terms + SETTINGS.regularisation * stay)


def test_the_update_is_the_least_of_equation_14(frames, model, rng):
    one, throats, tau, alpha = frames
    throat = Throat.of(one.subject.neutral, model.triangles, one.person.larynx)
    before = (
        one.person.base[one.person.larynx.vertices] + rng.normal(0, 3e-4, (len(one.person.larynx.vertices), 3)),
        (one.person.larynx.with_weights(0.8 * one.person.larynx.weights_m)),
    )
    sums = _sums(before[1], throats, tau, alpha)
    base, larynx = update_larynx(sums, throat, before[0], SETTINGS)
    arguments = one, throats, tau, alpha, throat
    least = _energy(*arguments, base, larynx, before)
    assert least < _energy(*arguments, *before, before)
    for _ in range(4):
        step = rng.normal(0, 1e-5, base.shape)
        nudge = larynx.with_weights(larynx.weights_m + 1e-5 * rng.normal(size=larynx.weights_m.shape))
        assert _energy(*arguments, base + step, larynx, before) > least
        assert _energy(*arguments, base, nudge, before) > least


def test_the_update_finds_the_true_larynx_from_true_slides(frames, model):
    one, _, tau, alpha = frames
    truth, base_truth = one.person.larynx, one.person.base[one.person.larynx.vertices]
    throats = base_truth + truth.offset(tau, alpha).values
    larynx = truth.with_weights(0.5 * truth.weights_m, np.array([0.0, 0.2, 1.0]))
    throat, base = Throat.of(one.subject.neutral, model.triangles, larynx), base_truth
    for _ in range(12):
        base, larynx = update_larynx(_sums(larynx, throats, tau, alpha), throat, base, SETTINGS)
    left = throats - base - larynx.offset(tau, alpha).values
    # the start leaves half of the larynx
    assert np.sqrt((left**2).mean()) < 0.05 * np.sqrt(((throats - base_truth) ** 2).mean())
    assert np.corrcoef(larynx.weights_at(0.0)[0], truth.weights_at(0.0)[0])[0, 1] > 0.98
    assert larynx.direction @ truth.direction > np.cos(np.radians(5))
