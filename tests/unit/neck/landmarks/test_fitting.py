"""Landmarks drive the head: derivatives, pose and expression from 3D and from a picture, gaps, outliers, and the neck."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.geometry.transforms import from_vector, invert, transform
from headcap.heads import HeadCoefficients, procedural_model
from headcap.neck.landmarks.fitting import LandmarkMotion, LandmarkSettings, fit_landmarks
from headcap.neck.landmarks.landmarks import LandmarkPoints, Landmarks
from headcap.neck.landmarks.problem import LandmarkProblem, State
from headcap.synthetic.mesh_takes import mesh_subject

FRAMES, RATE_HZ = 60, 30.0
PLACED = from_vector(np.array([0.3, 2.4, -0.2, 0.4, 1.3, 0.2]))
SIDES = ("mouth_corner", "eye_inner", "eye_outer", "nose_wing", "cheekbone", "jaw_angle", "ear_lobe")
MIDDLE = ("chin", "menton", "nose_tip", "nose_bridge", "glabella", "subnasale", "mouth_lower", "mouth_upper", "lip_lower_bottom")
FACE = (*MIDDLE, *(f"{name}_{side}" for name in SIDES for side in ("left", "right")))


@pytest.fixture(scope="module")
def head():
    model = procedural_model(6, 8, np.float64)
    correctives = 0.3 * np.tensordot(np.random.default_rng(1).normal(size=(18, 6)), model.shape_basis, axes=1)
    return replace(model, pose_basis=correctives)


@pytest.fixture(scope="module")
def points(head):
    return LandmarkPoints.named(head, FACE)


def performance(trunk_moves: bool = False) -> HeadCoefficients:
    """Nods, turns, a jaw and expressions, half a second each."""
    t = np.arange(FRAMES) / RATE_HZ
    theta = np.zeros((FRAMES, 2, 3))
    theta[:, 0, 0], theta[:, 0, 1] = 0.2 * np.sin(4 * t), 0.4 * np.sin(3 * t)
    theta[:, 1, 0] = 0.12 * (1 - np.cos(9 * t))
    psi = 0.8 * np.sin(np.outer(t, 3.0 + np.arange(8)) + np.arange(8))
    sway = from_vector(np.stack([0 * t, 0 * t, 0 * t, 0.03 * np.sin(2 * t), 0.01 * t, 0.02 * np.cos(2 * t)], axis=1))
    placement = PLACED @ sway if trunk_moves else np.tile(PLACED, (FRAMES, 1, 1))
    return HeadCoefficients(None, psi, theta, None, placement)


def camera() -> Camera:
    """A metre before the face, a wide lens with distortion."""
    matrix = np.array([[1500.0, 0, 959.5], [0, 1490.0, 539.5], [0, 0, 1]])
    camera_from_head = np.array([[1.0, 0, 0, 0.05], [0, -1, 0, -0.02], [0, 0, -1, 1.0], [0, 0, 0, 1]])
    return Camera("front", 1920, 1080, matrix, np.array([-0.12, 0.03, 1e-3, -5e-4, 0.0]), camera_from_head @ invert(PLACED))


def observed(head, points, posed, noise_m: float, seed: int = 0) -> Landmarks:
    true = points.at(head.evaluate(posed))
    return Landmarks(points, np.arange(len(true)) / RATE_HZ, true + np.random.default_rng(seed).normal(0, noise_m, true.shape))


def pictured(head, points, posed, noise_px: float) -> Landmarks:
    pixels = camera().project(points.at(head.evaluate(posed)))[0]
    pixels += np.random.default_rng(0).normal(0, noise_px, pixels.shape)
    return Landmarks(points, np.arange(len(pixels)) / RATE_HZ, pixels, camera())


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("trunk", ["moving", "still"])
def test_the_gradient_is_that_of_the_energy(head, rng, flat, trunk):
    triangles = rng.integers(0, len(head.triangles), 6)
    somewhere = LandmarkPoints.of_triangles(head, triangles, rng.dirichlet(np.ones(3), 6))
    mixed = LandmarkPoints.joined([LandmarkPoints.named(head, FACE[:9]), somewhere])
    posed = performance().frames(slice(5))
    seen = (pictured if flat else observed)(head, mixed, posed, 2.0 if flat else 0.002)
    holed = seen.seen.copy()
    holed[1, 3], holed[2] = np.nan, np.nan
    # with so small a noise many landmarks lie in Huber's linear part
    settings = LandmarkSettings(expressions=5, identity=True, trunk=trunk, noise_mm=1.5)
    problem = LandmarkProblem(head, replace(seen, seen=holed), PLACED, settings)
    rows = rng.normal(0, 0.05, (5, 12 + 5))
    if trunk == "still":
        rows[:, :6] = rows[:1, :6]
    beta = rng.normal(0, 0.3, 6)
    normal = problem.normal(State.of_rows(rows, beta))
    for _ in range(6):
        step, by_beta = rng.normal(size=rows.shape), rng.normal(size=6)
        if trunk == "still":
            step[:, :6] = step[:1, :6]
        ahead, behind = (problem.energy(State.of_rows(rows + e * step, beta + e * by_beta)) for e in (1e-6, -1e-6))
        told = (normal.right * step[:, normal.trunk :]).sum() + normal.shared_right @ np.r_[step[0, : normal.trunk], by_beta]
        assert (ahead - behind) / 2e-6 == pytest.approx(-2 * told, rel=2e-4, abs=1e-3)


def test_a_step_solves_the_linearised_problem(head, points, rng):
    problem = LandmarkProblem(
        head, observed(head, points, performance().frames(slice(8)), 0.001), PLACED, LandmarkSettings(identity=True)
    )
    state = State.at_rest(8, 8, 6)
    normal = problem.normal(state)
    f, q, s = normal.cross.shape
    whole = np.zeros((f * q + s, f * q + s))
    for t in range(f):
        whole[t * q : t * q + q, t * q : t * q + q] = normal.blocks[t]
    bend = np.zeros((f - 2, f))
    for t in range(f - 2):
        bend[t, t : t + 3] = normal.rough[t]
    whole[: f * q, : f * q] += np.kron(bend.T @ bend, np.diag(normal.steady))
    whole[: f * q, f * q :] = normal.cross.reshape(f * q, s)
    whole[f * q :, : f * q] = whole[: f * q, f * q :].T
    whole[f * q :, f * q :] = normal.shared
    wanted = np.linalg.solve(whole, np.r_[normal.right.ravel(), normal.shared_right])
    moved = normal.moved(state, 0.0)
    assert np.allclose(moved.rows.ravel(), wanted[: f * q], rtol=1e-5, atol=1e-8)
    assert np.allclose(moved.beta, wanted[f * q :], rtol=1e-5, atol=1e-8)


def test_3d_landmarks_give_pose_expression_and_the_neck_follows(head, points):
    posed = performance()
    fit = fit_landmarks(head, observed(head, points, posed, 3e-4), LandmarkSettings(noise_mm=0.3, trunk="still"))
    # 23 landmarks, 0.3 mm, levers of 0.1 m: a few milliradians, as expressions move 1 mm per unit and blur it
    assert np.sqrt(((fit.theta - posed.pose) ** 2).mean()) < 8e-3
    assert np.abs(fit.placement - posed.placement).max() < 0.02
    assert (np.diff(fit.energy) <= 0).all()
    true = head.evaluate(posed)
    found = head.evaluate(HeadCoefficients(None, fit.psi, fit.theta, None, fit.placement))
    still = head.evaluate(HeadCoefficients(placement=PLACED))
    neck = head.regions["neck"]
    error = np.linalg.norm(found - true, axis=2)[:, neck].mean()
    assert error < 0.1 * np.linalg.norm(still - true, axis=2)[:, neck].mean()
    assert np.nanmean(fit.distance) < 1.0e-3
    assert fit.beta is None
    assert fit.told.all()


def test_a_moving_trunk_is_told_from_a_turning_neck(head, points):
    posed = performance(trunk_moves=True)
    fit = fit_landmarks(head, observed(head, points, posed, 3e-4), LandmarkSettings(noise_mm=0.3))
    joint = head.joints()[0]
    where = transform_all(fit.placement, joint) - transform_all(posed.placement, joint)
    # the neck's joint shows only by what turns about it
    assert np.abs(where).max() < 0.012
    turned = np.degrees(np.abs(fit.theta[:, 0] - posed.pose[:, 0]))
    assert turned.mean() < 2.5


def transform_all(placement: np.ndarray, point: np.ndarray) -> np.ndarray:
    return np.array([transform(one, point) for one in placement])


def test_a_picture_gives_the_pose_too(head, points):
    posed = performance()
    fit = fit_landmarks(head, pictured(head, points, posed, 0.7), LandmarkSettings(noise_px=0.7, trunk="still"))
    # a pixel is 0.7 mm at a metre; depth is told by perspective alone
    assert np.degrees(np.abs(fit.theta[:, 0] - posed.pose[:, 0])).mean() < 1.5
    assert np.degrees(np.abs(fit.theta[:, 1, 0] - posed.pose[:, 1, 0])).mean() < 2.0
    true, found = (head.evaluate(c) for c in (posed, HeadCoefficients(None, fit.psi, fit.theta, None, fit.placement)))
    pixels = np.linalg.norm(camera().project(true)[0] - camera().project(found)[0], axis=2)
    assert pixels[:, head.regions["face"]].mean() < 2.0
    still = camera().project(head.evaluate(HeadCoefficients(placement=PLACED)))[0]
    neck = head.regions["neck"]
    assert pixels[:, neck].mean() < 0.25 * np.linalg.norm(camera().project(true)[0] - still, axis=2)[:, neck].mean()


def test_outliers_and_gaps_are_borne(head, points):
    posed = performance()
    seen = observed(head, points, posed, 3e-4)
    spoilt = seen.seen.copy()
    random = np.random.default_rng(5)
    spoilt[random.random(spoilt.shape[:2]) < 0.1] = np.nan
    spoilt[random.random(spoilt.shape[:2]) < 0.04] += [0.0, 0.05, 0.02]
    spoilt[20:24] = np.nan
    settings = LandmarkSettings(noise_mm=0.3, trunk="still")
    fit = fit_landmarks(head, replace(seen, seen=spoilt), settings)
    assert not fit.told[20:24].any()
    assert np.sqrt(((fit.theta - posed.pose)[:, 0] ** 2).mean()) < 0.015
    alone = fit_landmarks(head, replace(seen, seen=spoilt), settings.model_copy(update={"temporal": None}))
    assert np.isnan(alone.theta[20:24]).all()
    assert np.isfinite(np.delete(alone.theta, np.s_[20:24], 0)).all()
    curves = alone.curves("version", "somebody")
    assert len(curves) == FRAMES
    assert np.abs(curves.channels["neck"][20:24] - posed.pose[20:24, 0]).max() < 0.05


def test_the_temporal_prior_calms_a_still_head(head, points):
    still = HeadCoefficients(None, np.zeros((FRAMES, 8)), np.zeros((FRAMES, 2, 3)), None, np.tile(PLACED, (FRAMES, 1, 1)))
    seen = observed(head, points, still, 1e-3)
    calm = fit_landmarks(head, seen, LandmarkSettings(temporal=LandmarkMotion(neck_rad_s2=10, jaw_rad_s2=10, expression_s2=30)))
    plain = fit_landmarks(head, seen, LandmarkSettings(temporal=None))
    for before, after in ((plain.theta, calm.theta), (plain.psi, calm.psi)):
        assert np.diff(after, axis=0).std() < 0.25 * np.diff(before, axis=0).std()


def test_a_strangers_shape_is_told_by_many_frames(head, points):
    beta = np.array([1.2, -0.8, 0.5, 0.9, -0.6, 0.3])
    posed = replace(performance(), shape=beta)
    seen = observed(head, points, posed, 3e-4)
    fit = fit_landmarks(head, seen, LandmarkSettings(noise_mm=0.3, identity=True, trunk="still"))
    face = head.regions["face"]
    away = np.linalg.norm(head.identity(fit.beta) - head.identity(beta), axis=1)[face].mean()
    assert away < 0.5 * np.linalg.norm(head.identity(beta) - head.vertices, axis=1)[face].mean()
    plain = fit_landmarks(head, seen, LandmarkSettings(noise_mm=0.3, trunk="still"))
    # what is left is noise: one for each coordinate seen
    assert fit.energy[-1] < seen.seen.size < plain.energy[-1] / 1.2


def test_the_neck_of_a_rehearsed_person_follows_their_face(head):
    """Whose neck has seven joints and muscles, in no model's class."""
    person = mesh_subject(4)
    meshes = person.take("pose", 45, 10.0).meshes
    own = head.personal(person.neutral_m)
    points = LandmarkPoints.named(own, FACE)
    seen = points.at(meshes.astype(float)) + np.random.default_rng(0).normal(0, 5e-4, (45, len(points), 3))
    fit = fit_landmarks(own, Landmarks(points, np.arange(45) / 10.0, seen))
    found = own.evaluate(HeadCoefficients(None, fit.psi, fit.theta, None, fit.placement))
    neck = own.regions["neck"]
    error, still = (np.linalg.norm(other - meshes, axis=2)[:, neck].mean() for other in (found, own.vertices))
    assert error < 0.6 * still


def test_what_cannot_be_fitted_is_refused(head, points):
    seen = observed(head, points, performance().frames(slice(3)), 0.0)
    few = seen.seen.copy()
    few[:, 3:] = np.nan
    with pytest.raises(InputError, match="at most 3 landmarks"):
        fit_landmarks(head, replace(seen, seen=few))
    with pytest.raises(InputError, match="no shape basis"):
        fit_landmarks(head.personal(head.vertices), seen, LandmarkSettings(identity=True))
    with pytest.raises(InputError, match="without a camera"):
        replace(seen, seen=seen.seen[..., :2])
    with pytest.raises(InputError, match="landmarks of shape"):
        replace(seen, seen=seen.seen[:2])
    with pytest.raises(InputError, match="rising"):
        replace(seen, time_s=np.zeros(3))
    with pytest.raises(InputError, match="'nostril'"):
        LandmarkPoints.named(head, ["chin", "nostril"])
    with pytest.raises(InputError, match="vertex 99999"):
        LandmarkPoints.of_vertices(head, [99999])
    with pytest.raises(InputError, match="in triangle"):
        LandmarkPoints.of_triangles(head, [999999], [[1, 0, 0]])
    with pytest.raises(InputError, match="barycentric"):
        LandmarkPoints.of_triangles(head, [5], [[1, 1, 0]])
