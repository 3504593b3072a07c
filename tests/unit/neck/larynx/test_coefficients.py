"""Laws of eq. 12 and 13: slides and scales are recovered, whatever other motion is named, and nothing raises the error."""

import numpy as np

from headcap.neck.larynx.coefficients import Nuisance, SlideSettings, slide_and_scale

SETTINGS = SlideSettings()
TAU, ALPHA = np.linspace(-0.012, 0.018, 13), np.linspace(0.6, 1.4, 13)


def test_exact_offsets_give_slide_and_scale_back(larynx):
    tau, alpha = slide_and_scale(larynx.offset(TAU, ALPHA).values, larynx, SETTINGS)
    # a parabola through correlations half a millimetre apart misses the peak of a bump some 7 mm wide by its fourth derivative,
    # (0.5 / 7)^2 / 8 of the step
    assert np.abs(tau - TAU).max() < 0.5e-3 * 0.02
    assert np.abs(alpha - ALPHA).max() < 0.005


def test_named_motion_does_not_matter(larynx, rng):
    exact = larynx.offset(TAU, ALPHA).values
    basis = np.linalg.qr(rng.normal(size=(3 * len(larynx.vertices), 4)))[0].T
    noisy = exact + (rng.normal(0, 0.05, (len(TAU), 4)) @ basis).reshape(exact.shape)
    throat = basis.reshape(4, -1, 3) @ larynx.direction
    nuisance = [Nuisance(throat, offsets.reshape(len(TAU), -1) @ basis.T) for offsets in (exact, noisy)]
    plain, other = (slide_and_scale(o, larynx, SETTINGS, n) for o, n in zip((exact, noisy), nuisance, strict=True))
    # the motion is projected out exactly: only rounding differs
    assert np.abs(plain[0] - other[0]).max() < 1e-9
    assert np.abs(plain[1] - other[1]).max() < 1e-6
    # without its name the same motion misleads
    assert np.abs(slide_and_scale(noisy, larynx, SETTINGS)[1] - ALPHA).max() > 0.02


def test_an_earlier_slide_is_kept_where_it_is_better(larynx):
    offsets = larynx.offset(TAU, ALPHA).values
    coarse = SlideSettings(step_mm=6.0)
    assert np.abs(slide_and_scale(offsets, larynx, coarse)[0] - TAU).max() > 1e-5
    tau, alpha = slide_and_scale(offsets, larynx, coarse, before=TAU)
    assert np.allclose(tau, TAU)
    assert np.allclose(alpha, ALPHA)


def test_a_hollow_is_no_larynx(larynx):
    tau, alpha = slide_and_scale(-larynx.offset(TAU, ALPHA).values, larynx, SETTINGS)
    assert (alpha >= 0).all()
    left = np.linalg.norm(-larynx.offset(TAU, ALPHA).values - larynx.offset(tau, alpha).values)
    assert left <= np.linalg.norm(larynx.offset(TAU, ALPHA).values) * (1 + 1e-12)
