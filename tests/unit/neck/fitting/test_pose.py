"""Pose and expression of tracked meshes: exact derivatives, falling energy, truth recovered, outliers and holes borne."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.geometry.rotations import rotation_matrices
from headcap.heads import HeadCoefficients, HeadModel, procedural_model
from headcap.neck.fitting.compensation import (
    BLOCK,
    FitSettings,
    SequenceFitter,
    compensate,
    without_expressions,
)
from headcap.neck.fitting.pose import PoseEstimator, PoseSettings, telling_vertices
from headcap.neck.fitting.pose_kernel import PARAMETERS, moved, unposed_residuals
from headcap.neck.fitting.subject import posed_error_mm

FRAMES = 24


@pytest.fixture(scope="module")
def person() -> HeadModel:
    """A person with strong pose correctives; expressions of unit variance."""
    random = np.random.default_rng(5)
    model = procedural_model(20, 40)
    identity = model.identity(0.7 * random.normal(size=20))
    correctives = np.tensordot(random.normal(0, 0.5, (18, 20)), model.shape_basis, 1).astype(np.float32)
    return replace(model.personal(identity), pose_basis=correctives)


@pytest.fixture(scope="module")
def performance(person) -> HeadCoefficients:
    """Turns up to 30 degrees, an opening jaw, expressions, a body that moves."""
    random, t = np.random.default_rng(6), np.linspace(0, 1, FRAMES)
    neck = np.stack([0.3 * np.sin(5 * t), 0.5 * np.sin(4 * t), 0.1 * t], axis=-1)
    jaw = np.stack([0.25 * np.sin(6 * t) ** 2, 0.02 * t, 0 * t], axis=-1)
    placement = np.tile(np.eye(4), (FRAMES, 1, 1))
    placement[:, :3, :3] = rotation_matrices(np.stack([0.1 * t, 0.2 * t, 0.1 * np.sin(3 * t)], axis=-1))
    placement[:, :3, 3] = np.stack([0.1 * t, 1 + 0 * t, 0 * t], axis=-1)
    psi = np.sin(5 * t)[:, None] * random.normal(size=(1, 40))
    return HeadCoefficients(expression=psi, pose=np.stack([neck, jaw], axis=1), placement=placement)


@pytest.fixture(scope="module")
def meshes(person, performance) -> np.ndarray:
    return person.evaluate(performance)


def test_the_kernel_agrees_with_the_model_and_its_derivative_with_finite_differences(person, performance, meshes):
    chosen = np.arange(0, len(person.vertices), 900)
    exact = person.astype(np.float64)
    exact = replace(exact, skinning_weights=exact.skinning_weights / exact.skinning_weights.sum(axis=1, keepdims=True))
    weights, joints = np.ascontiguousarray(exact.skinning_weights[chosen]), np.ascontiguousarray(exact.joints())
    correctives = np.ascontiguousarray(exact.pose_basis[:, chosen].transpose(1, 0, 2))
    rest = np.ascontiguousarray(exact.rest(HeadCoefficients(expression=performance.expression[9]))[chosen])
    frame = exact.evaluate(performance.frames(slice(9, 10)))[0, chosen]
    turns = rotation_matrices(np.concatenate([np.zeros((1, 3)), performance.pose[9]]))
    turns[0], shift = performance.placement[9, :3, :3], performance.placement[9, :3, 3]
    residual, jacobian = np.empty((len(chosen), 3)), np.empty((3 * len(chosen), PARAMETERS))

    def at(step: np.ndarray) -> np.ndarray:
        out = np.empty_like(residual)
        unposed_residuals(frame, rest, correctives, weights, joints, *moved(turns, shift, step), out, np.empty((0, PARAMETERS)))
        return out.ravel()

    assert at(np.zeros(12)) == pytest.approx(0.0, abs=1e-12)
    # away from a perfect fit, where a linearisation that left something out would show
    far = np.random.default_rng(3).normal(0, 0.1, 12)
    turns, shift = moved(turns, shift, far)
    unposed_residuals(frame, rest, correctives, weights, joints, turns, shift, residual, jacobian)
    step = 1e-6
    slopes = np.stack([(at(-step * unit) - at(step * unit)) / (2 * step) for unit in np.eye(PARAMETERS)], axis=1)
    # central differences err by step^2 times third derivatives and by rounding over the step: 1e-9 of a metre per radian
    assert jacobian == pytest.approx(slopes, abs=2e-9)


def test_energy_falls_at_every_step(person, meshes):
    trace = PoseEstimator(person).trace(meshes[10][telling_vertices(person, PoseSettings().vertices_per_bone)])
    assert len(trace) > 4
    assert (np.diff(trace) <= 0).all()
    assert trace[-1] < 0.01 * trace[0]


def test_pose_and_expression_are_recovered(person, performance, meshes):
    found = compensate(person, meshes)
    # the ridge draws psi to zero: sigma^2 against the bases' energy; a tenth of a degree is 0.1 mm at the chin
    assert np.degrees(np.abs(found.theta - performance.pose)).max() < 0.1
    assert np.abs(found.placement[:, :3, 3] - performance.placement[:, :3, 3]).max() < 1e-4
    assert np.sqrt(np.mean((found.psi - performance.expression) ** 2)) < 0.02
    assert np.sqrt(((found.meshes - person.vertices) ** 2).mean()) < 3e-5
    assert found.skipped == 0


def test_what_is_neither_pose_nor_expression_is_left(person, performance):
    """A throat that rises stays in the compensated meshes: the face alone tells the expression."""
    rise = np.zeros((FRAMES, len(person.vertices), 3), np.float32)
    throat = person.regions["larynx"] & ~person.regions["face"]
    rise[:, throat, 2] = 0.004 * np.linspace(0, 1, FRAMES)[:, None]
    rest = person.rest(performance) + rise
    meshes = person.skinned(rest, person.joints(), performance.pose, performance.placement)
    found = compensate(person, meshes)
    assert np.abs(found.meshes - person.vertices - rise).max() < 3e-4


def test_compensated_meshes_and_coefficients_give_the_tracked_meshes_back(person, meshes):
    noisy = meshes + np.random.default_rng(1).normal(0, 2e-4, meshes.shape).astype(np.float32)
    found = compensate(person, noisy)
    back = person.rest(found.coefficients) - person.vertices + found.meshes
    again = person.skinned(back, person.joints(), found.theta, found.placement)
    assert np.abs(again - noisy).max() < 5e-6


def test_a_frame_that_jumps_and_one_torn_by_outliers_are_found(person, performance, meshes):
    estimator = PoseEstimator(person)
    observed = meshes[[2, 20]][:, estimator.vertices].copy()
    torn = np.random.default_rng(4).random(len(estimator.vertices)) < 0.1
    observed[1, torn] += 0.05
    found, _, _ = estimator.estimate(observed)
    assert np.degrees(np.abs(found.theta[1] - performance.pose[20])).max() < 1.0


def test_motion_of_the_world_is_motion_of_the_placement_alone(person, meshes):
    turn, shift = rotation_matrices(np.array([0.4, 2.5, -0.3])), np.array([1.0, -2.0, 0.5])
    here, there = compensate(person, meshes[:4]), compensate(person, (meshes[:4] @ turn.T + shift).astype(np.float32))
    assert there.theta == pytest.approx(here.theta, abs=2e-4)
    assert there.placement[:, :3, :3] == pytest.approx(turn @ here.placement[:, :3, :3], abs=2e-4)
    assert np.abs(there.meshes - here.meshes).max() < 2e-5


def test_frames_that_are_not_finite_are_skipped_and_counted(person, performance, meshes):
    holed = meshes.copy()
    holed[[0, 7], 100] = np.nan
    found = compensate(person, holed)
    assert found.skipped == 2
    assert np.isnan(found.meshes[[0, 7]]).all()
    assert np.isnan(found.theta[[0, 7]]).all()
    kept = np.setdiff1d(np.arange(FRAMES), [0, 7])
    assert np.degrees(np.abs(found.theta[kept] - performance.pose[kept])).max() < 0.1


def test_blocks_do_not_change_the_result(person, meshes, monkeypatch):
    whole = compensate(person, meshes)
    monkeypatch.setattr("headcap.neck.fitting.compensation.BLOCK", 5)
    out = np.empty_like(meshes)
    parts = compensate(person, meshes, out=out)
    assert parts.meshes is out
    assert np.abs(out - whole.meshes).max() < 1e-6


class OnDisk:
    """Meshes that count how many frames are asked for at once."""

    def __init__(self, meshes: np.ndarray, copies: int) -> None:
        self._meshes, self.most = meshes, 0
        self.shape, self.ndim = (copies * len(meshes), *meshes.shape[1:]), 3

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, frames) -> np.ndarray:
        numbers = np.arange(len(self))[frames]
        self.most = max(self.most, len(numbers))
        return self._meshes[numbers % len(self._meshes)]


def errors_mm(model: HeadModel, meshes, region: np.ndarray, settings: FitSettings | None = None) -> np.ndarray:
    """(f,) over a region, as takes of people held out are judged."""
    blocks = SequenceFitter(model, settings).blocks(meshes)
    return np.concatenate([posed_error_mm(model, block, np.flatnonzero(region)) for block in blocks])


def test_a_long_take_is_read_in_blocks_of_bounded_memory(person, meshes):
    """An hour at 60 frames per second would take 33 GB: no more than a block of it is ever there."""
    long = OnDisk(meshes, 10)
    tracemalloc.start()
    error = errors_mm(person, long, person.regions["neck"])
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert long.most <= BLOCK
    # a block, its displacements and what the model makes of it, the person's own arrays; the whole take is 37 MB
    assert peak < 8 * BLOCK * meshes[0].nbytes
    assert error[:FRAMES] == pytest.approx(error[-FRAMES:], abs=0.02)


def test_without_expressions_an_expression_remains_as_error(person, performance, meshes):
    region = person.regions["face"]
    settings = FitSettings(expression_region=None)
    with_, without = (errors_mm(m, meshes, region, settings) for m in (person, without_expressions(person)))
    assert with_.max() < 0.1
    assert without.max() > 1.0


def test_refuses_other_topologies_regions_and_takes_without_a_frame(person, meshes):
    with pytest.raises(InputError, match="meshes"):
        compensate(person, meshes[:, :-1])
    with pytest.raises(InputError, match="meshes"):
        compensate(person, meshes[0])
    with pytest.raises(InputError, match="no region tail"):
        SequenceFitter(person, FitSettings(expression_region="tail"))
    with pytest.raises(InputError, match="none of 2 meshes is finite"):
        compensate(person, np.full_like(meshes[:2], np.nan))
    loose = replace(person, skinning_weights=np.full_like(person.skinning_weights, 1 / 3))
    with pytest.raises(InputError, match="vertices follow"):
        PoseEstimator(loose)
