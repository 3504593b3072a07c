from dataclasses import replace

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.speech.moments import moments_of, pooled
from headcap.speech.ridge import (
    IMPROVED,
    PAPER_LARYNX,
    PAPER_SPEECH,
    RidgeForm,
    cross_validated,
    few_coordinates,
    fit,
    fold_errors,
    held_out,
    left_out_maps,
)
from headcap.speech.settings import RidgeSettings

FORMS = [RidgeForm(bias, standardise, "common") for bias in (False, True) for standardise in (False, True)]


@pytest.fixture
def takes(rng):
    """Four takes (x, y) of one linear law with noise, inputs of unlike scales far from zero."""
    scales, truth = rng.uniform(0.1, 10, 12), rng.normal(0, 1, (12, 3))
    found = []
    for frames in (300, 150, 220, 90):
        x = scales * (rng.normal(0, 1, (frames, 12)) + 3)
        found.append((x, x / scales @ truth + 5 + rng.normal(0, 2.0, (frames, 3))))
    return found


def _moments(takes):
    return [moments_of([take]) for take in takes]


def _direct(x, y, form, penalty):
    """Eq. 25 by augmented least squares: rows sqrt(lambda) I below the inputs."""
    mean_x, mean_y = (x.mean(0), y.mean(0)) if form.bias else (0.0, 0.0)
    power = ((x - mean_x) ** 2).sum(0)
    scale = np.sqrt(power / len(x)) if form.standardise else np.ones(x.shape[1])
    z = (x - mean_x) / scale
    penalty = penalty * (z**2).sum() / x.shape[1]
    stacked = np.vstack([z, np.sqrt(penalty) * np.eye(x.shape[1])])
    weights = np.linalg.lstsq(stacked, np.vstack([y - mean_y, np.zeros((x.shape[1], y.shape[1]))]), rcond=None)[0]
    weights = weights / scale[:, None]
    return weights, mean_y - mean_x @ weights if form.bias else np.zeros(y.shape[1])


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("penalty", [1e-4, 1.0, 30.0])
def test_the_fit_minimises_equation_25(takes, form, penalty):
    found = fit(pooled(_moments(takes)), form, penalty)
    weights, bias = _direct(*(np.concatenate(part) for part in zip(*takes, strict=True)), form, penalty)
    np.testing.assert_allclose(found.weights, weights, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(found.bias, bias, rtol=1e-7, atol=1e-7)


@pytest.mark.parametrize("form", [PAPER_SPEECH, PAPER_LARYNX])
def test_fewer_frames_than_inputs_minimise_it_too(rng, form):
    """Three takes of ten frames with 60 inputs, of which one never varies and two are equal: another way of solving."""
    takes = [(rng.normal(0, 1, (10, 60)) + 2, rng.normal(0, 1, (10, 3))) for _ in range(3)]
    for x, _ in takes:
        x[:, 7], x[:, 9] = 4.0, x[:, 8]
    parts = _moments(takes)
    (within,), back = few_coordinates([parts], form)
    assert within[0].inputs == 30
    found = back(cross_validated(within, form))
    for one, output in zip(found.penalties, range(3), strict=True):
        direct = fit(pooled(parts), form, one)
        np.testing.assert_allclose(found.weights[:, output], direct.weights[:, output], rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(found.bias[output], direct.bias[output], rtol=1e-6, atol=1e-9)
    # and the penalties are those of errors on takes left out, as found without any shortcut
    settings = RidgeSettings()
    penalties = np.array(settings.penalties)
    errors = np.zeros((len(penalties), 3))
    for k, (x, y) in enumerate(takes):
        for row, penalty in zip(errors, penalties, strict=True):
            others = fit(pooled([part for j, part in enumerate(parts) if j != k]), form, penalty)
            row += ((others(x) - y) ** 2).sum(axis=0)
    if form is PAPER_SPEECH:  # one for all; the mean is none of its regressions, which have no bias
        np.testing.assert_array_equal(found.penalties, penalties[errors.sum(axis=1).argmin()])
    else:
        of_mean = sum(((y - np.concatenate([o for j, (_, o) in enumerate(takes) if j != k]).mean(0)) ** 2).sum(0)
                      for k, (_, y) in enumerate(takes))  # fmt: skip
        expected = np.where(errors.min(axis=0) <= of_mean, penalties[errors.argmin(axis=0)], np.inf)
        np.testing.assert_array_equal(found.penalties, expected)


@pytest.mark.parametrize("form", FORMS)
def test_what_inputs_do_not_tell_is_predicted_by_its_mean(takes, rng, form):
    """The first output follows the inputs; the second does so in two takes and against them in the two others."""
    signs = (1, -1, 1, -1)
    deviations = [y[:, :1] - y[:, :1].mean() for _, y in takes]
    parts = [
        moments_of([(x[:90], np.hstack([y[:90, :1], 5 + sign * off[:90] + 0.1 * rng.normal(size=(90, 1))]))])
        for (x, y), sign, off in zip(takes, signs, deviations, strict=True)
    ]
    found = cross_validated(parts, form)
    if form.bias:
        own = cross_validated(parts, replace(form, penalty="own"))
        assert not own.weights[:, 1].any()
        assert np.isfinite(own.penalties[0])
        assert np.isinf(own.penalties[1])
        assert own.bias[1] == pytest.approx(own.mean[1])
    else:
        assert np.isfinite(found.penalties).all()


@pytest.mark.parametrize("form", FORMS)
def test_left_out_maps_know_nothing_of_what_they_leave_out(takes, form):
    """Of three people with takes of their own: the map that leaves one out is the cross-validated map of the two others."""
    a, b, c, d = _moments(takes)
    found = left_out_maps([[a, b], [c], [d]], form)
    for k, others in enumerate(([c, d], [pooled([a, b]), d], [pooled([a, b]), c])):
        alone = cross_validated(others, form)
        np.testing.assert_array_equal(found[k].penalties, alone.penalties)
        np.testing.assert_allclose(found[k].weights, alone.weights, rtol=1e-9)
    # of two, the other's takes choose the penalty
    np.testing.assert_array_equal(left_out_maps([[a, b], [c, d]], form)[0].weights, cross_validated([c, d], form).weights)
    with pytest.raises(InputError, match="1 take for"):
        left_out_maps([[a, b], [c]], form)


def test_blocks_and_skipped_frames_do_not_matter(takes, rng):
    x, y = (np.concatenate(part) for part in zip(*takes, strict=True))
    x, y = x + 1e4, y.copy()  # far from zero, where sums of squares would lose half their digits
    x[5, 2], y[[17, 400], 1] = np.nan, np.inf
    cuts = np.sort(rng.integers(0, len(x), 9))
    blocks = moments_of(zip(np.split(x, cuts), np.split(y, cuts), strict=True))
    good = np.isfinite(x).all(1) & np.isfinite(y).all(1)
    rows = np.hstack([x, y])[good]
    assert (blocks.frames, blocks.skipped) == (len(x) - 3, 3)
    np.testing.assert_allclose(blocks.mean, rows.mean(0), rtol=1e-12)
    np.testing.assert_allclose(blocks.scatter, (rows - rows.mean(0)).T @ (rows - rows.mean(0)), rtol=1e-9, atol=1e-7)


@pytest.mark.parametrize("form", FORMS)
def test_errors_come_from_moments_as_from_frames(takes, form):
    penalties = np.array([0.01, 1.0])
    errors = fold_errors(_moments(takes), form, penalties)
    for k, (x, y) in enumerate(takes):
        rest = [np.concatenate(part) for part in zip(*(takes[:k] + takes[k + 1 :]), strict=True)]
        for p, penalty in enumerate(penalties):
            weights, bias = _direct(*rest, form, penalty)
            np.testing.assert_allclose(errors[k, p], ((y - x @ weights - bias) ** 2).sum(0), rtol=1e-7)
        np.testing.assert_allclose(errors[k, -1], ((y - rest[1].mean(0)) ** 2).sum(0), rtol=1e-9)


def test_each_output_takes_the_penalty_that_errs_least_and_a_common_one_the_least_sum(takes):
    moments, settings = _moments(takes), RidgeSettings()
    curve = fold_errors(moments, RidgeForm(True, True, "own"), np.array(settings.penalties)).sum(axis=0)[:-1]
    own = cross_validated(moments, RidgeForm(True, True, "own"), settings).penalties
    common = cross_validated(moments, RidgeForm(True, True, "common"), settings).penalties
    np.testing.assert_array_equal(own, np.array(settings.penalties)[curve.argmin(0)])
    np.testing.assert_array_equal(common, settings.penalties[curve.sum(1).argmin()])


def test_outputs_that_lean_on_each_other_agree_more(rng):
    x = [rng.normal(0, 1, (60, 20)) for _ in range(4)]
    law = rng.normal(0, 0.3, (20, 12))
    takes = [moments_of([(part, part @ law + rng.normal(0, 2, (60, 12)))]) for part in x]
    spread = {kind: np.log10(cross_validated(takes, RidgeForm(True, True, kind)).penalties).std() for kind in ("own", "leaning")}
    assert spread["leaning"] < spread["own"]


def test_the_paper_has_a_bias_for_the_larynx_alone(takes):
    assert (cross_validated(_moments(takes), PAPER_SPEECH).bias == 0).all()
    assert (np.abs(cross_validated(_moments(takes), PAPER_LARYNX).bias) > 0.1).all()


def test_errors_on_held_out_takes_never_saw_them(takes):
    moments = _moments(takes)
    found = held_out(moments, IMPROVED)
    for k in range(len(takes)):
        others = moments[:k] + moments[k + 1 :]
        alone = cross_validated(others, IMPROVED)
        np.testing.assert_array_equal(found.penalties[k], alone.penalties)
        np.testing.assert_allclose(found.squared_error[k], moments[k].squared_error(alone.weights, alone.bias))
        x, y = takes[k]
        np.testing.assert_allclose(found.squared_error[k], ((alone(x) - y) ** 2).sum(0), rtol=1e-8)
    # the law explains 12 units of variance of 16 in the mean output
    assert 0.5 < found.r_squared.mean() < 0.95


def test_inputs_that_never_vary_get_no_weight(takes):
    with_constant = [(np.column_stack([x, np.zeros(len(x)), np.full(len(x), 7.0)]), y) for x, y in takes]
    for form in FORMS:
        found = fit(pooled(_moments(with_constant)), form, 0.1)
        assert np.isfinite(found.weights).all()
        assert (found.weights[12] == 0).all()
        if form.bias:
            assert (found.weights[13] == 0).all()


def test_too_few_takes_or_frames_are_told(takes):
    with pytest.raises(InputError, match="1 take for cross-validation"):
        cross_validated(_moments(takes[:1]), IMPROVED)
    with pytest.raises(InputError, match="2 takes for errors on held-out takes"):
        held_out(_moments(takes[:2]), IMPROVED)
    with pytest.raises(InputError, match="4 frames without a whole set of numbers"):
        moments_of([(np.full((4, 2), np.nan), np.zeros(4))])
