"""Coefficient curves: files, edits that undo each other, and swallows."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from headcap.artifacts import ArtifactError, save_json
from headcap.errors import InputError
from headcap.neck.animation.curves import CoefficientCurves
from headcap.neck.animation.editing import FADE_S, added, exaggerated, keyed, scaled, shifted
from headcap.neck.animation.swallowing import find_swallow, swallow
from headcap.neck.fitting.speech import SpeechFit

FRAMES = 90
SINGLE = ("tau", "alpha", "phi.1", "neck.y")
WHOLE = (*SINGLE, "phi", "jaw", "psi")


def _curves(seed: int = 0, placement: bool = True) -> CoefficientCurves:
    rng = np.random.default_rng(seed)
    walk = lambda *shape: np.cumsum(rng.normal(0, 0.1, (FRAMES, *shape)), axis=0)  # noqa: E731
    channels = {"tau": 1e-3 * walk(), "alpha": 1 + 0.1 * walk(), "phi": walk(4), "psi": walk(2), "neck": walk(3), "jaw": walk(3)}
    still = np.tile(np.eye(4), (FRAMES, 1, 1)) if placement else None
    return CoefficientCurves(np.arange(FRAMES) / 30, channels, still, "v1", "somebody")


def _assert_same(one: CoefficientCurves, other: CoefficientCurves) -> None:
    assert set(one.channels) == set(other.channels)
    for name, values in one.channels.items():
        np.testing.assert_allclose(values, other.channels[name], rtol=0, atol=1e-12 * max(np.abs(values).max(), 1))


@pytest.mark.parametrize("placement", [True, False])
def test_curves_come_back_from_their_file_bit_by_bit(tmp_path, placement):
    curves = _curves(placement=placement)
    curves.save(tmp_path / "a.json")
    read = CoefficientCurves.load(tmp_path / "a.json")
    assert (read.person, read.model_version) == ("somebody", "v1")
    assert np.array_equal(read.time_s, curves.time_s)
    for name, values in curves.channels.items():
        assert np.array_equal(read.channels[name], values)
    assert (read.placement is None) == (not placement)
    read.save(tmp_path / "b.json")
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


def test_a_model_without_expressions_travels_too(tmp_path):
    curves = CoefficientCurves(np.arange(3.0), {"psi": np.zeros((3, 0))}, model_version="v1")
    curves.save(tmp_path / "a.json")
    assert CoefficientCurves.load(tmp_path / "a.json").channels["psi"].shape == (3, 0)


@given(name=st.sampled_from(WHOLE), amount=st.floats(-5, 5), factor=st.floats(0.1, 10))
@settings(max_examples=40, deadline=None)
def test_edits_undo_each_other(name, amount, factor):
    curves = _curves()
    _assert_same(scaled(scaled(curves, name, factor), name, 1 / factor), curves)
    _assert_same(shifted(shifted(curves, name, amount), name, -amount), curves)
    _assert_same(exaggerated(exaggerated(curves, name, factor), name, 1 / factor), curves)
    _assert_same(
        shifted(scaled(curves, name, factor), name, amount * factor), scaled(shifted(curves, name, amount), name, factor)
    )


def test_an_edit_touches_its_curve_alone():
    curves = _curves()
    edited = scaled(curves, "phi.1", 2.0)
    np.testing.assert_array_equal(edited.curve("phi.1"), 2 * curves.curve("phi.1"))
    kept = edited.with_curve("phi.1", curves.curve("phi.1"))
    for name, values in curves.channels.items():
        assert np.array_equal(kept.channels[name], values)


def test_exaggeration_keeps_the_mean_and_grows_the_range():
    curves = _curves()
    edited = exaggerated(curves, "tau", 1.5)
    assert edited.curve("tau").mean() == pytest.approx(curves.curve("tau").mean())
    assert np.ptp(edited.curve("tau")) == pytest.approx(1.5 * np.ptp(curves.curve("tau")))


@given(name=st.sampled_from(SINGLE), frames=st.lists(st.integers(0, FRAMES - 1), min_size=1, max_size=6, unique=True))
@settings(max_examples=40, deadline=None)
def test_keys_are_met_fade_and_undo(name, frames):
    curves = _curves()
    time_s, values = curves.time_s, curves.curve(name)
    keys = [(time_s[frame], 0.3 + 0.1 * k) for k, frame in enumerate(frames)]
    bent = keyed(curves, name, keys)
    np.testing.assert_allclose(bent.curve(name)[frames], [value for _, value in keys], atol=1e-12)
    away = (time_s < time_s[min(frames)] - FADE_S) | (time_s > time_s[max(frames)] + FADE_S)
    assert np.array_equal(bent.curve(name)[away], values[away])
    _assert_same(keyed(bent, name, [(time, values[frame]) for (time, _), frame in zip(keys, frames, strict=True)]), curves)


def test_bends_never_overshoot_their_keys():
    flat = CoefficientCurves(np.arange(FRAMES) / 30, {"tau": np.zeros(FRAMES)})
    bent = keyed(flat, "tau", [(0.5, 0.02), (0.6, 0.005), (1.5, 0.01)]).curve("tau")
    assert bent.min() >= 0
    assert bent.max() == pytest.approx(0.02)


def test_a_swallow_rises_as_far_and_as_long_as_said():
    curves = swallow(60)
    tau, alpha = curves.curve("tau"), curves.curve("alpha")
    assert 0.020 <= tau.max() <= 0.025
    up = curves.time_s[tau > 1e-9]
    assert 0.8 < up[-1] - up[0] <= 1.0
    assert tau[0] == tau[-1] == 0
    assert alpha[0] == alpha[-1] == 1
    # alpha falls as tau rises (section 7.2, figure 9): one decreasing line
    assert np.corrcoef(tau, alpha)[0, 1] == pytest.approx(-1)
    # no jerk at the ends: the first step is a ten-thousandth of the rise, not a sixtieth
    assert np.abs(np.diff(tau, 2)).max() < 0.022 * 6 / (0.4 * 60) ** 2


def test_a_swallow_is_found_in_a_take_and_laid_into_another():
    speech = CoefficientCurves(np.arange(240) / 60, {"tau": 1e-3 * np.sin(np.arange(240) / 9), "alpha": np.ones(240)})
    mixed = added(speech, swallow(60), 1.5)
    _assert_same(added(mixed, swallow(60), 1.5, sign=-1), speech)
    found = find_swallow(mixed)
    assert found.curve("tau").max() == mixed.curve("tau").max()
    # 5 % of the height at either end of a minimum-jerk course leave out a third of each at most; 0.1 s are kept around
    assert 0.6 < found.duration_s < 1.4
    with pytest.raises(InputError, match="as in a swallow"):
        find_swallow(speech)


def test_adding_leaves_no_step_where_the_motion_ends_elsewhere():
    still = CoefficientCurves(np.arange(60) / 30, {})
    slope = CoefficientCurves(np.arange(30) / 30, {"tau": np.linspace(0.002, 0.01, 30)})
    np.testing.assert_allclose(added(still, slope, 0.5).curve("tau"), 0.0, atol=1e-15)


def test_a_takes_coefficients_become_curves_and_gaps_are_bridged(heard):
    fit = heard[0][0]
    gone = np.zeros(len(fit.time_s), bool)
    gone[10:13] = True
    speech = SpeechFit(np.where(gone, np.nan, fit.speech.tau_m), fit.speech.alpha, fit.speech.phi)
    curves = CoefficientCurves.of_take(replace(fit, speech=speech, time_s=fit.time_s + 3), "v1", "somebody")
    assert curves.time_s[0] == 0
    np.testing.assert_array_equal(curves.curve("tau")[~gone], fit.speech.tau_m[~gone])
    np.testing.assert_allclose(np.diff(curves.curve("tau")[9:14], 2), 0, atol=1e-15)
    nothing = SpeechFit(np.full(len(fit.time_s), np.nan), fit.speech.alpha, fit.speech.phi)
    with pytest.raises(InputError, match="no fitted frame"):
        CoefficientCurves.of_take(replace(fit, speech=nothing), "v1", "somebody")


def test_other_moments_lie_in_between_and_rotations_stay_rotations():
    curves = _curves()
    turn = np.tile(np.eye(4), (FRAMES, 1, 1))
    angle = np.linspace(0, 1, FRAMES)
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
    curves = replace(curves, placement=turn)
    between = curves.at(curves.time_s[:-1] + 1 / 60)
    np.testing.assert_allclose(between.curve("phi"), (curves.curve("phi")[1:] + curves.curve("phi")[:-1]) / 2)
    np.testing.assert_allclose(np.arcsin(between.placement[:, 1, 0]), (angle[1:] + angle[:-1]) / 2, atol=1e-12)
    same = curves.at(curves.time_s)
    _assert_same(same, curves)


def test_cutting_counts_from_the_cut():
    cut = _curves().cut(1.0, 2.0)
    assert (len(cut), cut.time_s[0]) == (31, 0.0)
    assert np.array_equal(cut.curve("tau"), _curves().curve("tau")[30:61])


@pytest.mark.parametrize(
    ("edit", "told"),
    [
        (lambda c: scaled(c, "tua", 2), "curve 'tua'; expected one of tau, alpha, phi, psi, neck, jaw"),
        (lambda c: scaled(c, "phi.4", 2), "'phi.4'; expected phi with 0 to 3"),
        (lambda c: scaled(c, "neck.w", 2), "neck with x, y, z"),
        (lambda c: scaled(c, "tau.0", 2), "tau with no components"),
        (lambda c: shifted(c, "tau", np.nan), "nan for tau"),
        (lambda c: keyed(c, "phi", [(0.5, 1)]), "expected one component, such as phi.0"),
        (lambda c: keyed(c, "tau", [(9.0, 1)]), "keys of tau at 9 s"),
        (lambda c: keyed(c, "tau", [(0.5, 1), (0.501, 2)]), "different frames"),
        (lambda c: added(c, swallow(30), 2.5), "room for it"),
        (lambda c: added(c, replace(c, model_version="v2"), 0.0), "curves of neck model v2"),
        (lambda c: c.cut(2.0, 1.0), "the earlier one first"),
        (lambda c: c.at(np.array([0.0, 3.5])), "curves from 0.000 to 2.967 s for moments from 0.000 to 3.500 s"),
        (lambda c: c.overlaid(c.cut(0, 1)), "with a frame's grace"),
        (lambda c: swallow(0.0), "positive number"),
        (lambda c: swallow(30, rise_m=-1.0), "metres of rise"),
    ],
)
def test_edits_that_cannot_be_are_refused(edit, told):
    with pytest.raises(InputError) as refused:
        edit(_curves())
    assert told in str(refused.value)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"channels": {"tua_m": [0.0, 0.0]}}, "curve 'tua_m'; expected one of tau_m, alpha"),
        ({"channels": {"tau_m": [0.0]}}, "curve tau is (1,); expected (2,)"),
        ({"channels": {"tau_m": [0.0, float("nan")]}}, "finite"),
        ({"channels": {"phi": [[0.0], [0.0, 1.0]]}}, "ragged"),
        ({"channels": {"neck_rad": [[0.0], [0.0]]}}, "curve neck is (2, 1)"),
        ({"channels": {"phi": [[0.0], [0.0]]}, "model_version": ""}, "without a model version"),
        ({"time_s": [1.0, 0.0]}, "rising"),
        ({"time_s": []}, "at least one frame"),
        ({"channels": [1, 2]}, "holds no whole curves"),
        ({"world_from_head": [[1.0]]}, "curve placement is (1, 1)"),
    ],
)
def test_files_that_were_edited_wrongly_are_refused_by_name(tmp_path, change, told):
    content = {"schema": "headcap.coefficient_curves/1", "person": "", "model_version": "v1", "time_s": [0.0, 0.1]}
    (tmp_path / "a.json").write_text(json.dumps({**content, "channels": {"tau_m": [0.0, 0.0]}, **change}))
    with pytest.raises((InputError, ArtifactError)) as refused:
        CoefficientCurves.load(tmp_path / "a.json")
    assert told in str(refused.value)
    assert "a.json" in str(refused.value)


def test_another_kind_of_file_is_refused(tmp_path):
    save_json(tmp_path / "a.json", "mesh_sequence", 1, {})
    with pytest.raises(ArtifactError, match=r"expected headcap\.coefficient_curves/1"):
        CoefficientCurves.load(tmp_path / "a.json")
