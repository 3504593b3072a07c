"""Sequences in any order of stages: truth comes back, held curves stay, the temporal prior does what it states."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.geometry.transforms import from_vector
from headcap.heads import HeadCoefficients, procedural_model
from headcap.neck import NeckModel
from headcap.neck.fitting.compensation import FitSettings
from headcap.neck.fitting.identity import IdentitySettings
from headcap.neck.fitting.sequence import SequenceFit, SequenceFitSettings, fit_sequence
from headcap.neck.fitting.temporal import TemporalPrior
from headcap.neck.subjects import JoinedMeshes

FRAMES, RATE_HZ, NOISE_M = 100, 60.0, 1e-4
EXACT = SequenceFitSettings(fit=FitSettings(noise_mm=0.05))


def truth(model: NeckModel, still: bool = False) -> dict[str, np.ndarray]:
    """A head that turns, grimaces and speaks, or one that does not stir."""
    t = np.arange(FRAMES) / RATE_HZ * (0 if still else 1)
    theta = np.stack(
        [
            np.stack([0.15 * np.sin(5 * t), 0.25 * np.sin(4 * t), 0 * t], -1),
            np.stack([0.1 * np.sin(9 * t) ** 2, 0 * t, 0 * t], -1),
        ],
        1,
    )
    placement = from_vector(np.stack([0 * t, 1.2 + 0.1 * t, 0 * t, 0.1 * t, 0.3 + 0 * t, 0 * t], -1))
    psi = np.sin(np.outer(t, [6.0, 9.0, 13.0]))
    count = len(model.head.speech_basis)
    phi = 2e-2 * np.sin(np.outer(t, 5.0 + np.arange(count)))
    return {
        "theta": theta,
        "placement": placement,
        "psi": psi,
        "tau": 6e-3 * np.sin(8 * t),
        "alpha": 1 + 0.1 * np.cos(7 * t),
        "phi": phi,
    }


def meshes_of(model: NeckModel, person, true: dict, seed: int = 1) -> np.ndarray:
    """With a tracker's noise, independent from frame to frame."""
    posed = HeadCoefficients(None, true["psi"], true["theta"], true["phi"], true["placement"])
    meshes = model.evaluate(person, posed, true["tau"], true["alpha"])
    return (meshes + np.random.default_rng(seed).normal(0, NOISE_M, meshes.shape)).astype(np.float32)


@pytest.fixture(scope="module")
def person(trained):
    return trained.model.person("s1")


@pytest.fixture(scope="module")
def moving(trained, person):
    true = truth(trained.model)
    return true, meshes_of(trained.model, person, true)


@pytest.fixture(scope="module")
def fit(trained, person, moving) -> SequenceFit:
    return fit_sequence(trained.model, person, moving[1], settings=EXACT)


def test_everything_comes_back(fit, moving):
    true = moving[0]
    # speech moves the jaw's and the trunk's vertices by up to 0.5 mm, at a lever of 0.1 m; noise adds a tenth of that
    assert np.abs(fit.theta - true["theta"]).max() < 5e-3
    assert np.abs(fit.placement - true["placement"]).max() < 5e-3
    # which a unit of psi, a millimetre over the face, takes for a tenth of itself at most
    assert np.abs(fit.psi - true["psi"]).max() < 0.1
    assert np.corrcoef(fit.tau_m, true["tau"])[0, 1] > 0.99
    # noise of 0.1 mm on each axis is 0.16 mm in length
    assert fit.error_mm.mean() < 0.18
    assert fit.skipped == 0


def test_each_stage_that_is_left_out_rests_and_costs(trained, person, moving, fit):
    before = fit.error_mm.mean()
    for order in (("pose", "expression", "larynx"), ("pose", "expression", "speech"), ("pose", "larynx", "speech"), ("pose",)):
        left = fit_sequence(trained.model, person, moving[1], order, settings=EXACT)
        assert left.error_mm.mean() > 1.05 * before
        for stage, values in (("expression", left.psi), ("speech", left.phi), ("larynx", left.tau_m)):
            assert values.any() == (stage in order)
        assert ((left.alpha == 1.0).all()) == ("larynx" not in order)


@pytest.mark.parametrize(
    "order",
    [
        ("pose", "expression", "larynx", "speech", "pose", "expression"),
        ("pose", "larynx", "expression", "larynx", "speech"),
        ("pose", "expression", "speech", "larynx", "speech", "larynx"),
    ],
)
def test_any_order_may_be_asked_for_and_comes_near(trained, person, moving, fit, order):
    other = fit_sequence(trained.model, person, moving[1], order, settings=EXACT)
    alone = fit_sequence(trained.model, person, moving[1], ("pose",), settings=EXACT)
    # stages that others have spoilt for a while are not undone, only improved on
    assert other.error_mm.mean() < 0.7 * alone.error_mm.mean()
    assert np.corrcoef(other.tau_m, moving[0]["tau"])[0, 1] > 0.9


def test_another_pass_never_costs(trained, person, moving, fit):
    twice = fit_sequence(trained.model, person, moving[1], ("pose", "expression", "larynx", "speech") * 2, settings=EXACT)
    assert twice.error_mm.mean() < fit.error_mm.mean() + 1e-3


def test_what_is_held_stays_and_helps(trained, person, moving):
    true, meshes = moving
    held = {"theta": true["theta"], "placement": true["placement"], "phi": true["phi"]}
    fit = fit_sequence(trained.model, person, meshes, ("expression", "larynx"), held, EXACT)
    assert np.array_equal(fit.theta, true["theta"])
    assert np.array_equal(fit.phi, true["phi"])
    # with phi known the larynx is told by hundreds of vertices 5 mm high: a twentieth of a millimetre
    assert np.abs(fit.tau_m - true["tau"]).max() < 0.2e-3
    held = {name: true[name] for name in ("theta", "placement", "psi", "tau", "alpha")}
    fit = fit_sequence(trained.model, person, meshes, ("speech",), held, EXACT)
    # N is orthonormal: noise of 0.1 mm on each coordinate
    assert np.abs(fit.phi - true["phi"]).max() < 5 * NOISE_M
    held = {"psi": true["psi"], "tau": true["tau"], "alpha": true["alpha"]}
    fit = fit_sequence(trained.model, person, meshes, ("pose", "speech"), held, EXACT)
    assert np.abs(fit.theta - true["theta"]).max() < 5e-3
    # speech is only fitted after the pose that it has turned a little
    assert fit.error_mm.mean() < 0.2


def test_jitter_of_a_still_head_falls_and_a_shake_stays(trained, person, moving):
    still = meshes_of(trained.model, person, truth(trained.model, still=True))
    steady = EXACT.model_copy(update={"temporal": TemporalPrior()})
    plain, calm = (fit_sequence(trained.model, person, still, settings=s) for s in (EXACT, steady))
    for name in ("theta", "psi", "phi", "tau_m", "alpha"):
        before, after = getattr(plain, name), getattr(calm, name)
        assert np.sqrt((after - after.mean(0)) ** 2).mean() < 0.7 * np.sqrt((before - before.mean(0)) ** 2).mean(), name
    true = moving[0] | {"theta": 0 * moving[0]["theta"]}
    true["theta"][:, 0, 1] = 0.2 * np.sin(2 * np.pi * 3.0 * np.arange(FRAMES) / RATE_HZ)
    shaken = fit_sequence(trained.model, person, meshes_of(trained.model, person, true), settings=steady)
    lost = np.abs(shaken.theta[:, 0, 1] - true["theta"][:, 0, 1])[10:-10].max() / 0.2
    # (3 / 8)^4 = 2 % of a shake at 3 Hz, and what noise leaves
    assert lost < 0.03


def test_missing_frames_are_counted_and_filled_where_a_prior_says_how(trained, person, moving, fit):
    true, meshes = moving
    holed = meshes.copy()
    holed[40:43] = np.nan
    plain = fit_sequence(trained.model, person, holed, settings=EXACT)
    assert plain.skipped == 3
    assert np.isnan(plain.theta[41]).all()
    assert np.isnan(plain.error_mm[41])
    assert np.allclose(plain.tau_m[50:], fit.tau_m[50:], atol=1e-4)
    curves = plain.curves(trained.model.version)
    assert len(curves) == FRAMES
    filled = fit_sequence(trained.model, person, holed, settings=EXACT.model_copy(update={"temporal": TemporalPrior()}))
    assert np.abs(filled.theta[40:43] - true["theta"][40:43]).max() < 0.01
    assert np.isnan(filled.error_mm[41])
    with pytest.raises(InputError, match="is finite"):
        fit_sequence(trained.model, person, np.full_like(meshes[:5], np.nan))


def test_meshes_may_lie_in_files(trained, person, moving, fit):
    parts = JoinedMeshes([moving[1][:30], moving[1][30:31], moving[1][31:]], moving[1].shape[1])
    other = fit_sequence(trained.model, person, parts, settings=EXACT)
    assert np.array_equal(other.phi, fit.phi)


def test_a_stranger_is_fitted_from_the_sequence(trained, moving):
    many = procedural_model(6, 3, np.float64)
    basis = trained.model.head.speech_basis
    model = NeckModel(replace(many, speech_basis=basis.astype(np.float64)), trained.model.people)
    beta = np.array([1.0, -0.5, 0.3, 0.8, -1.2, 0.4])
    identity = many.identity(beta)
    true = moving[0]
    posed = HeadCoefficients(None, true["psi"], true["theta"], None, true["placement"])
    meshes = many.personal(identity).evaluate(posed)
    meshes += np.random.default_rng(2).normal(0, NOISE_M, meshes.shape)
    few = EXACT.model_copy(update={"identity": IdentitySettings(most_frames=12, rounds=3)})
    fit = fit_sequence(model, None, meshes, ("identity", "pose", "expression"), settings=few)
    assert np.abs(fit.beta - beta).max() < 0.3
    assert fit.error_mm.mean() < 0.3
    told = fit_sequence(model, None, meshes, ("pose", "expression"), {"beta": beta}, EXACT)
    assert told.error_mm.mean() < 0.18


@pytest.mark.parametrize(
    ("order", "held", "told"),
    [
        (("pose", "walk"), {}, "walk"),
        (("pose",), {"zeta": 1}, "zeta"),
        (("pose",), {"theta": 1}, "held and the pose stage"),
        (("larynx",), {"theta": 1}, "theta held alone"),
        (("pose", "identity"), {}, "identity"),
        (("pose",), {"psi": np.zeros((3, 3))}, "held psi"),
        (("pose",), {"phi": np.full((FRAMES, 8), np.nan)}, "held phi"),
    ],
)
def test_what_does_not_go_together_is_refused(trained, person, moving, order, held, told):
    with pytest.raises(InputError, match=told):
        fit_sequence(trained.model, person, moving[1], order, held)


def test_nobody_is_refused(trained, moving):
    with pytest.raises(InputError, match="no person"):
        fit_sequence(trained.model, None, moving[1])
