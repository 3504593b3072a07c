"""Shape coefficients beta of a person from a neutral mesh, a mesh sequence or sparse 3D points (section 3.3: T_0 as FLAME's).

Every step is an exact least-squares minimum; beta has unit variance over people (how shape bases are scaled), which is its prior.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.linalg import cho_factor, cho_solve

from headcap.errors import InputError
from headcap.geometry.rotations import cross_matrices, rotation_matrices
from headcap.geometry.transforms import fit_rigid, invert, rigid, transform
from headcap.heads import HeadCoefficients, HeadModel
from headcap.neck.fitting.chosen_vertices import model_of_vertices
from headcap.neck.fitting.compensation import check_topology
from headcap.neck.fitting.pose import PoseEstimator, Poses, PoseSettings
from headcap.neck.fitting.pose_kernel import PARAMETERS, unposed_residuals
from headcap.neck.fitting.speech import checked_mask

_UNSTEADY = ("larynx", "eyes", "mouth_interior")
"""What neither shape nor expression moves, or no camera sees."""


class IdentitySettings(BaseModel):
    """Fitting shape coefficients."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    noise_mm: float = Field(1.0, gt=0, description="Standard deviation of what shape and expression leave of a vertex (ridge)")
    rounds: int = Field(10, ge=1, description="Most rounds of shape and placement, or of shape and pose over a sequence")
    settled: float = Field(1e-3, gt=0, description="A round that changes no coefficient by more is the last")
    most_frames: int = Field(60, ge=1, description="Frames of a sequence that are used, evenly spaced")
    pose: PoseSettings = Field(default_factory=PoseSettings)


@dataclass(frozen=True, eq=False)
class IdentityFit:
    """A person's shape."""

    beta: NDArray[np.float64]
    """(s,)."""
    identity: NDArray[np.float64]
    """T = mean + S beta, (n, 3) metres in the model's frame."""
    placement: NDArray[np.float64]
    """world_from_head (4, 4) of a neutral mesh or points; (f, 4, 4) of the frames used of a sequence."""
    error_mm: float
    """Mean distance of the vertices or points that were told."""
    energy: tuple[float, ...]
    """|distance|^2 / noise^2 + |beta|^2 after each round, for a neutral mesh or points; it never rises. Empty for a sequence."""


def fit_identity(
    model: HeadModel, mesh: NDArray, settings: IdentitySettings | None = None, seen: NDArray[np.bool_] | None = None
) -> IdentityFit:
    """Shape and rigid placement of a neutral mesh (n, 3) in metres, anywhere in the room; `seen` (n,) masks what tells.

    Vertices that are not finite tell nothing. Raises `InputError` for another topology, fewer than 10 vertices that tell, or a
    model without a shape basis.
    """
    check_topology(model, np.asarray(mesh)[None])
    told = np.isfinite(mesh).all(axis=1)
    mask = checked_mask(seen, len(told))
    chosen = np.flatnonzero(told if mask is None else told & mask)
    return fit_identity_to_points(model, chosen, np.asarray(mesh, float)[chosen], settings)


def fit_identity_to_points(
    model: HeadModel, vertices: NDArray, points: NDArray, settings: IdentitySettings | None = None
) -> IdentityFit:
    """Shape and rigid placement of a neutral head whose vertices (k,) lie at points (k, 3) metres in the room.

    A round solves for beta together with small turns and shifts, whose tangents would otherwise be taken for shape, then for the
    placement alone (Kabsch) and for beta alone (ridge). Points that are not finite tell nothing. Raises `InputError` for fewer
    than 10 points, or 10 that lie in a line, or a model without a shape basis.
    """
    settings = settings or IdentitySettings()
    fine = np.isfinite(points).all(axis=1)
    vertices, points = np.asarray(vertices)[fine], np.asarray(points, float)[fine]
    _check(model, points)
    mean = np.asarray(model.vertices[vertices], float)
    basis = np.asarray(model.shape_basis[:, vertices], float).reshape(len(model.shape_basis), mean.size)
    noise, beta = 1e-3 * settings.noise_mm, np.zeros(len(model.shape_basis))
    factor = cho_factor(basis @ basis.T + noise**2 * np.eye(len(basis)))
    placement, energy = fit_rigid(mean, points), []
    for _ in range(settings.rounds):
        trial, placed = _joint_step(mean, basis, points, placement, beta, noise)
        placed = fit_rigid(mean + _shown(basis, trial), points)
        found = cho_solve(factor, basis @ (transform(invert(placed), points) - mean).ravel())
        value = _energy(mean, basis, points, placed, found, noise)
        if energy and not value <= energy[-1]:
            break
        change, beta, placement = np.abs(found - beta).max(), found, placed
        energy.append(value)
        if change < settings.settled:
            break
    left = transform(placement, mean + _shown(basis, beta)) - points
    error = 1e3 * float(np.linalg.norm(left, axis=1).mean())
    return IdentityFit(beta, np.asarray(model.identity(beta), float), placement, error, tuple(energy))


def fit_identity_to_sequence(
    model: HeadModel, meshes: NDArray, settings: IdentitySettings | None = None, seen: NDArray[np.bool_] | None = None
) -> IdentityFit:
    """Shape of a person from meshes (f, n, 3) in which they move and grimace; read by frames, `seen` (n,) masks what tells.

    Rounds of two steps: pose, placement and expression of each frame under the shape so far (`PoseEstimator`), then beta by
    least squares at rest together with every frame's expression and its small change of pose and placement, all of which are
    eliminated in closed form: what is common to all frames is shape as far as poses and expressions, each with its own prior, do
    not explain it better. The larynx, the eyes and the mouth's inside tell nothing. Frames that are not finite are left out.
    Raises `InputError` for another topology, no finite frame, or a model without a shape basis.
    """
    settings = settings or IdentitySettings()
    check_topology(model, meshes)
    frames = _evenly(meshes, settings.most_frames)
    _check(model, np.asarray(model.vertices, float))
    told = _telling(model, checked_mask(seen, len(model.vertices)))
    part, noise = model_of_vertices(model, told), 1e-3 * settings.noise_mm
    solver, beta = _ShapeSolver(model, told, noise), np.zeros(len(model.shape_basis))
    for _ in range(settings.rounds):
        own = model.personal(model.identity(beta))
        estimator = PoseEstimator(own, settings.pose, seen)
        poses = estimator.estimate(frames[:, estimator.vertices])[0]
        found = solver.solve(frames[:, told], np.asarray(own.joints(), float), poses)
        change, beta = np.abs(found - beta).max(), found
        if change < settings.settled:
            break
    posed = HeadCoefficients(beta, solver.psi(frames[:, told], part, poses, beta), poses.theta, placement=poses.placement)
    left = part.evaluate(posed)[:, : len(told)] - frames[:, told]
    error = 1e3 * float(np.linalg.norm(left, axis=-1).mean())
    return IdentityFit(beta, np.asarray(model.identity(beta), float), poses.placement, error, ())


class _ShapeSolver:
    """beta of posed heads (f, k, 3): one linear problem in which each frame's psi and tangents of its pose are eliminated."""

    def __init__(self, model: HeadModel, told: NDArray, noise: float) -> None:
        self._mean = np.asarray(model.vertices[told], float)
        bases = (model.shape_basis, model.expression_basis)
        self._shape, self._expression = (np.asarray(b[:, told], float).reshape(len(b), self._mean.size) for b in bases)
        self._weights = np.ascontiguousarray(model.skinning_weights[told], np.float64)
        correctives = model.pose_basis[:, told] if model.pose_basis.any() else np.zeros((0, len(told), 3))
        self._correctives = np.ascontiguousarray(correctives.transpose(1, 0, 2), np.float64)
        self._noise, e = noise, len(self._expression)
        self._known = np.zeros((e + PARAMETERS, e + PARAMETERS))
        self._known[:e, :e] = self._expression @ self._expression.T + noise**2 * np.eye(e)
        self._cross = np.concatenate([self._expression @ self._shape.T, np.zeros((PARAMETERS, len(self._shape)))])

    def solve(self, meshes: NDArray, joints: NDArray, poses: Poses) -> NDArray[np.float64]:
        """(s,); the joints stay where the shape so far has them."""
        e = len(self._expression)
        own = self._shape @ self._shape.T
        matrix, right = self._noise**2 * np.eye(len(own)), np.zeros(len(own))
        residual, jacobian = np.empty_like(self._mean), np.empty((self._mean.size, PARAMETERS))
        for mesh, turns, shift in zip(meshes, poses.turns, poses.shift, strict=True):
            arrays = (self._mean, self._correctives, self._weights, joints, turns, shift)
            unposed_residuals(np.ascontiguousarray(mesh), *arrays, residual, jacobian)
            away, gram, cross = residual.ravel(), self._known.copy(), self._cross.copy()
            gram[e:, :e] = jacobian.T @ self._expression.T
            gram[:e, e:], gram[e:, e:] = gram[e:, :e].T, jacobian.T @ jacobian
            cross[e:] = jacobian.T @ self._shape.T
            gram[np.diag_indices(len(gram))] += 1e-9 * np.trace(gram) / len(gram)
            solved = cho_solve(cho_factor(gram), np.c_[cross, np.r_[self._expression @ away, jacobian.T @ away]])
            matrix += own - cross.T @ solved[:, :-1]
            right += self._shape @ away - cross.T @ solved[:, -1]
        return cho_solve(cho_factor(matrix), right)

    def psi(self, meshes: NDArray, part: HeadModel, poses: Poses, beta: NDArray) -> NDArray[np.float64]:
        """(f, e) by ridge, the poses given."""
        identity, count, e = part.identity(beta), meshes.shape[1], len(self._expression)
        padded = np.zeros((len(meshes), len(part.vertices), 3))
        padded[:, :count] = meshes
        away = part.unskinned(padded, part.joints(identity), poses.theta, poses.placement)
        away = away - part.rest(HeadCoefficients(beta, pose=poses.theta))
        products = self._expression @ np.asarray(away[:, :count], float).reshape(len(meshes), -1).T
        return np.linalg.solve(self._known[:e, :e], products).T


def _joint_step(
    mean: NDArray, basis: NDArray, points: NDArray, placement: NDArray, beta: NDArray, noise: float
) -> tuple[NDArray, NDArray]:
    """beta (s,) and placement (4, 4) of the problem linearised about a placement."""
    shown = mean + _shown(basis, beta)
    local = transform(invert(placement), points)
    tangents = np.concatenate([-cross_matrices(shown), np.broadcast_to(np.eye(3), (len(mean), 3, 3))], axis=2).reshape(-1, 6)
    rows = np.concatenate([basis, tangents.T])
    matrix = rows @ rows.T + noise**2 * np.diag(np.r_[np.ones(len(basis)), np.zeros(6)])
    solved = np.linalg.lstsq(matrix, rows @ (local - mean).ravel(), rcond=None)[0]
    turn, shift = solved[-6:-3], solved[-3:]
    return solved[: len(basis)], placement @ rigid(rotation_matrices(turn), shift)


def _shown(basis: NDArray, beta: NDArray) -> NDArray:
    return (beta @ basis).reshape(-1, 3)


def _energy(mean: NDArray, basis: NDArray, points: NDArray, placement: NDArray, beta: NDArray, noise: float) -> float:
    left = transform(placement, mean + _shown(basis, beta)) - points
    return float((left**2).sum() / noise**2 + beta @ beta)


def _telling(model: HeadModel, seen: NDArray[np.bool_] | None) -> NDArray[np.int64]:
    told = np.ones(len(model.vertices), bool) if seen is None else seen.copy()
    for name in _UNSTEADY:
        told &= ~model.regions.get(name, np.zeros_like(told))
    return np.flatnonzero(told)


def _evenly(meshes: NDArray, most: int) -> NDArray[np.float64]:
    """Finite frames (f, n, 3), evenly spaced."""
    chosen = np.unique(np.linspace(0, len(meshes) - 1, min(len(meshes), most)).round().astype(np.int64))
    frames = np.asarray(meshes[chosen], float)
    frames = frames[np.isfinite(frames).all(axis=(1, 2))]
    if not len(frames):
        raise InputError(
            f"none of {len(chosen)} meshes is finite",
            expected="at least one tracked frame",
            remedy="Check the tracker's report of this take.",
        )
    return frames


def _check(model: HeadModel, points: NDArray) -> None:
    if len(model.shape_basis) == 0:
        raise InputError(
            f"head model {model.name} has no shape basis", expected="a model of many people", remedy="Load the base model."
        )
    if len(points) < LEAST_POINTS or np.linalg.matrix_rank(points - points.mean(axis=0), tol=1e-3) < 2:
        raise InputError(
            f"{len(points)} points that tell the shape of a head",
            expected=f"at least {LEAST_POINTS} finite ones, not in a line",
            remedy="Give more landmarks, or a mesh.",
        )


LEAST_POINTS = 10
"""Fewer points than this hardly tell more than a placement."""
