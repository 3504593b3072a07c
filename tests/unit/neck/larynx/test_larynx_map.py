"""Laws of the sliding larynx (eq. 1, 2): it slides as it is, scales, never leaves its region, and its derivatives are exact."""

import dataclasses
import time

import numpy as np
import pytest

from headcap.artifacts import ArtifactError, save_arrays
from headcap.errors import InputError
from headcap.heads import HeadCoefficients
from headcap.meshes.subdivision import subdivide_butterfly
from headcap.neck import LarynxMap, LarynxSettings, larynx_map

from ..conftest import bump_m

SLIDES_M = (-0.02, -0.00731, -0.0005, 0.0, 0.0005, 0.004, 0.0123, 0.02)


@pytest.mark.parametrize("tau", SLIDES_M)
def test_its_content_translates(larynx, tau):
    values, slopes = larynx.weights_at(tau)
    moved = larynx.uv_m - [0.0, tau]
    # linear across: pitch^2 / 8 of a second derivative, at most 5 mm / (7 mm)^2 times 1.5; cubic along is far below
    bound = 1e-6 / 8 * 5e-3 / 0.007**2 * 1.5
    assert np.abs(values - larynx.window * bump_m(moved)).max() < bound
    step = 1e-6
    push = np.array([0.0, step])
    truth = (bump_m(moved - push) - bump_m(moved + push)) / (2 * step)
    # linear across and third-order along, of a slope of 5 mm / 7 mm
    assert np.abs(slopes - larynx.window * truth).max() < 0.015


@pytest.mark.parametrize("tau", SLIDES_M)
def test_derivatives_are_those_of_finite_differences(larynx, tau):
    alpha, step = 1.3, 1e-7
    offset, by_tau, by_alpha = larynx.offset_with_derivatives(tau, alpha)
    # between pixels W is cubic in tau, at them only its second derivative jumps: central differences err by a step of it,
    # (5 mm / 49 mm^2) alpha step, and by rounding
    numeric = (larynx.offset(tau + step, alpha).values - larynx.offset(tau - step, alpha).values) / (2 * step)
    assert np.abs(by_tau - numeric).max() < 0.11e3 * alpha * step + 1e-17 / step
    numeric = (larynx.offset(tau, alpha + 0.5).values - larynx.offset(tau, alpha - 0.5).values) / 1.0
    assert np.abs(by_alpha - numeric).max() < 1e-17
    assert np.allclose(offset.values, alpha * by_alpha, atol=1e-18)


def test_equation_2_written_out(larynx):
    offset = larynx.offset(0.006, 0.8)
    weights, _ = larynx.weights_at(0.006)
    assert np.allclose(offset.values, 0.8 * weights[:, None] * np.array([0.0, -0.3, 0.95]) / np.hypot(0.3, 0.95), atol=1e-18)


def test_nothing_leaves_the_region_whatever_the_map_and_the_slide(model, larynx, rng):
    wild = larynx.with_weights(rng.normal(0, 0.01, larynx.weights_m.shape))
    taus = rng.uniform(-0.1, 0.1, 20)
    moved = model.rest(HeadCoefficients(), wild.offset(taus, 2.0)) - model.vertices
    still = ~model.regions["larynx"] | model.regions["larynx_boundary"]
    assert (moved[:, still] == 0).all()
    assert np.abs(moved[:, ~still]).max() > 0


def test_far_away_it_is_gone(larynx):
    for tau in (-1.0, 1.0):
        values, slopes = larynx.weights_at(tau)
        assert (values == 0).all()
        assert (slopes == 0).all()


def test_batches_are_rows_of_singles(larynx, rng):
    taus, alphas = rng.uniform(-0.02, 0.02, (3, 1)), rng.uniform(0.5, 1.5, 4)
    offset, by_tau, by_alpha = larynx.offset_with_derivatives(taus, alphas)
    assert offset.values.shape == (3, 4, len(larynx.vertices), 3)
    alone = larynx.offset_with_derivatives(taus[1, 0], alphas[2])
    assert np.array_equal(offset.values[1, 2], alone[0].values)
    assert np.array_equal(by_tau[1, 2], alone[1])
    assert np.array_equal(by_alpha[1, 2], alone[2])


@pytest.mark.parametrize("tau", SLIDES_M)
def test_the_sampling_matrix_is_the_kernel(larynx, tau):
    matrix = larynx.sampling_matrix(tau)
    assert np.abs(matrix @ larynx.weights_m.ravel() - larynx.weights_at(tau)[0]).max() < 1e-17
    # taps sum to one wherever the image reaches; beyond it all is zero
    v = larynx.uv_m[:, 1] - tau - larynx.origin_m[1]
    within = (v > 0.002) & (v < larynx.pitch_m * (len(larynx.weights_m) - 3))
    assert within.sum() > 300
    assert np.allclose(matrix.sum(axis=1)[within], larynx.window[within])


def test_a_map_fitted_to_vertices_gives_their_values_and_predicts_slides(model, larynx):
    fitted = larynx.fitted(larynx.weights_at(0.0)[0])
    inside = larynx.window > 0.99
    at_rest = np.abs(fitted.weights_at(0.0)[0] - larynx.weights_at(0.0)[0])
    assert at_rest[inside].max() < 0.05e-3
    # between the vertices, about 3 mm apart, the plate knows the bump to a few hundredths of a millimetre
    for tau in (-0.005, 0.002, 0.0073):
        error = np.abs(fitted.weights_at(tau)[0] - larynx.weights_at(tau)[0])[inside]
        assert np.sqrt((error**2).mean()) < 0.04e-3
        assert error.max() < 0.3e-3


def test_finer_pixels_show_the_bump_better(model, chart):
    errors = []
    for pitch in (3.0, 1.5, 0.75):
        empty = larynx_map(model, chart, np.array([0, 0, 1.0]), LarynxSettings(pitch_mm=pitch))
        rows, columns = empty.weights_m.shape
        u, v = np.meshgrid(np.arange(columns), np.arange(rows))
        filled = empty.with_weights(bump_m(empty.origin_m + empty.pitch_m * np.stack([u, v], axis=-1)))
        errors.append(np.abs(filled.weights_at(0.004)[0] - filled.window * bump_m(filled.uv_m - [0, 0.004])).max())
    # linear across the slide: second order
    assert errors[1] < 0.35 * errors[0]
    assert errors[2] < 0.35 * errors[1]


def test_window_is_zero_on_the_border_and_one_inside(model, larynx):
    border = model.regions["larynx_boundary"][larynx.vertices]
    assert (larynx.window[border] == 0).all()
    assert (larynx.window[~border] > 0).all()
    assert larynx.window.max() == 1.0
    assert (larynx.window == 1.0).mean() > 0.5


def test_a_file_brings_the_map_back(model, larynx, tmp_path):
    larynx.save(tmp_path / "larynx.npz")
    again = LarynxMap.load(tmp_path / "larynx.npz")
    again.check(model)
    for entry in dataclasses.fields(larynx):
        assert np.array_equal(getattr(again, entry.name), getattr(larynx, entry.name)), entry.name
    save_arrays(tmp_path / "other.npz", "head_model", 1, {})
    with pytest.raises(ArtifactError, match=r"expected headcap\.larynx_map/1"):
        LarynxMap.load(tmp_path / "other.npz")


def test_what_does_not_fit_is_refused(model, chart, larynx):
    step = subdivide_butterfly(model.triangles, len(model.vertices), model.regions["larynx"][model.triangles].all(axis=1))
    finer = model.subdivided(step)
    with pytest.raises(InputError, match="the head model the map was made for"):
        larynx.check(finer)
    with pytest.raises(InputError, match="a chart of this model's front neck"):
        larynx_map(finer, chart, np.array([0, 0, 1.0]))
    with pytest.raises(InputError, match="not finite"):
        larynx.offset(np.array([0.0, np.nan]))
    with pytest.raises(InputError, match="not finite"):
        larynx.with_weights(np.full(larynx.weights_m.shape, np.nan))
    with pytest.raises(InputError, match="direction"):
        larynx_map(model, chart, np.zeros(3))


def test_three_thousand_vertices_with_derivatives_in_microseconds(larynx, rng):
    """The limit is 50 us of one core; a test on a busy machine may take thrice that, not more."""
    k = 3000
    uv = rng.uniform(larynx.uv_m.min(0), larynx.uv_m.max(0), (k, 2))
    many = dataclasses.replace(larynx, vertices=np.arange(k), uv_m=uv, window=np.ones(k))
    taus = rng.uniform(-0.02, 0.02, 50)
    many.offset_with_derivatives(taus, 1.0)
    took = []
    for _ in range(5):
        start = time.process_time()
        many.offset_with_derivatives(taus, 1.0)
        took.append((time.process_time() - start) / 50)
    assert min(took) < 150e-6
