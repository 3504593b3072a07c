"""Fitting tracked meshes at the base head's 13 thousand vertices, one core: pose and expression, everything, and landmarks.

Limit: 100 frames per second, for pose and expression as for larynx and speech with them. The peer takes expression and pose in
turn with the head model's own functions, one frame after the other over the same vertices: a pose step
(`HeadModel.pose_derivative`), then all expressions, until both settle.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from run import measure, write

from headcap.geometry.rotations import rotation_matrices
from headcap.heads import HeadCoefficients, HeadModel, procedural_model
from headcap.neck import NeckModel, NeckPerson, build_chart, larynx_map
from headcap.neck.fitting.compensation import FitSettings, SequenceFitter, compensate
from headcap.neck.fitting.sequence import SequenceFitSettings, fit_sequence
from headcap.neck.fitting.temporal import TemporalPrior
from headcap.neck.landmarks.fitting import fit_landmarks
from headcap.neck.landmarks.landmarks import LandmarkPoints, Landmarks

FRAMES, PEER_FRAMES, PEER_STEPS = 400, 2, 12
RATE_HZ = 60.0


def run(out_path: Path) -> None:
    """Measure a take of 60 frames per second with noise of a fifth of a millimetre; check that the pose is found."""
    random = np.random.default_rng(3)
    model = _person(random)
    truth = _performance(random)
    meshes = model.evaluate(truth) + random.normal(0, 2e-4, (FRAMES, *model.vertices.shape)).astype(np.float32)
    fitter = SequenceFitter(model)
    ours = lambda: [block.psi for block in fitter.blocks(meshes)]  # noqa: E731
    ours()  # compiles
    took = measure(ours, repeats=3)
    whole = measure(lambda: compensate(model, meshes, out=np.empty_like(meshes)), repeats=3)
    found = compensate(model, meshes)
    error_deg = float(np.degrees(np.abs(found.theta - truth.pose)).max())
    if error_deg > 0.5:
        raise AssertionError(f"the pose is off by {error_deg:.3g} degrees")
    theirs: list[np.ndarray] = []
    peer = measure(lambda: theirs.append(_in_turn(model, meshes[:PEER_FRAMES], truth)))
    write(
        out_path,
        ours=_per_frame(took, FRAMES) | {"name": "pose and expression", "vertices": len(model.vertices), "expressions": 100},
        peer=_per_frame(peer, PEER_FRAMES) | {"name": f"pose and expression in turn, {PEER_STEPS} times"},
        figures={
            "frames_per_second": FRAMES / took["cpu_seconds"],
            "frames_per_second_with_compensated_meshes": FRAMES / whole["cpu_seconds"],
            "ms_prepare_person": 1e3 * measure(lambda: SequenceFitter(model, FitSettings()), repeats=3)["cpu_seconds"],
            "pose_error_deg": error_deg,
            "peer_pose_error_deg": float(np.degrees(np.abs(theirs[-1] - truth.pose[:PEER_FRAMES])).max()),
            "psi_error_rms": float(np.sqrt(np.mean((found.psi - truth.expression) ** 2))),
        }
        | _everything(model, truth, random)
        | _landmarks(model, truth, random),
    )


def _everything(model: HeadModel, truth: HeadCoefficients, random: np.random.Generator) -> dict[str, float]:
    """Pose, expression, larynx and 20 speech blendshapes, with the neck's error, and with a temporal prior as well."""
    neck, person = _neck(model, random)
    t = np.arange(FRAMES) / RATE_HZ
    tau, phi = 5e-3 * np.sin(9 * t), 0.02 * np.sin(np.outer(t, np.arange(5, 25)))
    spoken = replace(truth, speech=phi)
    meshes = neck.evaluate(person, spoken, tau, 1.0) + random.normal(0, 2e-4, (FRAMES, *model.vertices.shape)).astype(np.float32)
    fits = []
    plain = measure(lambda: fits.append(fit_sequence(neck, person, meshes)), repeats=3)
    steady = SequenceFitSettings(temporal=TemporalPrior())
    smooth = measure(lambda: fit_sequence(neck, person, meshes, settings=steady), repeats=3)
    correlation = float(np.corrcoef(fits[-1].tau_m, tau)[0, 1])
    if correlation < 0.95:
        raise AssertionError(f"slides correlate with the truth by {correlation:.3f}")
    return {
        "frames_per_second_everything": FRAMES / plain["cpu_seconds"],
        "frames_per_second_everything_smoothed": FRAMES / smooth["cpu_seconds"],
        "larynx_correlation": correlation,
    }


def _landmarks(model: HeadModel, truth: HeadCoefficients, random: np.random.Generator) -> dict[str, float]:
    """33 landmarks in 3D, 30 expression coefficients, tied over time."""
    points = LandmarkPoints.named(model, sorted(model.landmarks))
    seen = points.at(model.evaluate(truth).astype(float)) + random.normal(0, 5e-4, (FRAMES, len(points), 3))
    given = Landmarks(points, np.arange(FRAMES) / RATE_HZ, seen)
    took = measure(lambda: fit_landmarks(model, given), repeats=2)
    return {"frames_per_second_landmarks": FRAMES / took["cpu_seconds"]}


def _neck(model: HeadModel, random: np.random.Generator) -> tuple[NeckModel, NeckPerson]:
    """A larynx 5 mm high and smooth orthonormal speech blendshapes of the neck."""
    empty = larynx_map(model, build_chart(model), np.array([0.0, -0.2, 1.0]))
    larynx = empty.fitted(5e-3 * np.exp(-0.5 * (empty.uv_m**2).sum(axis=1) / 0.008**2))
    away = model.vertices[model.regions["neck"]].mean(axis=0) - model.vertices
    bulges = np.exp(-0.5 * (away**2).sum(axis=1) / 0.05**2)[:, None] * np.sin(40 * random.normal(size=(20, 1, 3)) * away)
    basis = np.linalg.qr(bulges.reshape(20, -1).T)[0].T.reshape(20, -1, 3)
    head = replace(model, speech_basis=basis.astype(np.float32))
    person = NeckPerson("somebody", np.asarray(model.vertices, float), larynx)
    return NeckModel(head, (person,)), person


def _person(random: np.random.Generator) -> HeadModel:
    model = procedural_model()
    correctives = np.tensordot(random.normal(0, 0.5, (18, 20)), model.shape_basis[:20], 1).astype(np.float32)
    return replace(model.personal(model.identity(0.7 * random.normal(size=30))), pose_basis=correctives)


def _performance(random: np.random.Generator) -> HeadCoefficients:
    """Turns of the head, a jaw and expressions that change twice a second."""
    t = np.arange(FRAMES) / RATE_HZ
    neck = np.stack([0.2 * np.sin(3 * t), 0.5 * np.sin(2 * t), 0.1 * np.sin(t)], axis=-1)
    jaw = np.stack([0.2 * np.sin(9 * t) ** 2, 0.02 * np.sin(5 * t), 0 * t], axis=-1)
    placement = np.tile(np.eye(4), (FRAMES, 1, 1))
    placement[:, :3, :3] = rotation_matrices(0.1 * np.sin(np.stack([t, 2 * t, 3 * t], axis=-1)))
    psi = np.sin(2 * np.pi * (0.5 * t[:, None] + random.random(100))) * random.normal(0, 0.7, 100)
    return HeadCoefficients(
        expression=psi * np.clip(2 * t, 0, 1)[:, None], pose=np.stack([neck, jaw], axis=1), placement=placement
    )


def _in_turn(model: HeadModel, meshes: np.ndarray, truth: HeadCoefficients) -> np.ndarray:
    """theta (f, 2, 3) by turns, the placement given; starts at rest."""
    basis = model.expression_basis.reshape(len(model.expression_basis), -1)
    inverse = np.linalg.pinv(basis.T)
    out = []
    for mesh, placement in zip(meshes, truth.placement, strict=False):
        pose, psi = np.zeros((2, 3)), np.zeros(len(basis))
        for _ in range(PEER_STEPS):
            now = HeadCoefficients(expression=psi, pose=pose, placement=placement)
            slope = model.pose_derivative(now).reshape(-1, 6)
            pose = pose + np.linalg.lstsq(slope, (mesh - model.evaluate(now)).ravel(), rcond=None)[0].reshape(2, 3)
            rest = model.unskinned(mesh, model.joints(), pose, placement) - model.rest(HeadCoefficients(pose=pose))
            psi = inverse @ rest.ravel()
        out.append(pose)
    return np.stack(out)


def _per_frame(took: dict[str, float], frames: int) -> dict[str, float]:
    return {key: value / frames for key, value in took.items()}
