"""Rigid placement, neck and jaw of tracked meshes by Gauss-Newton, with the expression solved for at the same time (eq. 4, 5).

Pose and expression alike can open a mouth. Solving for one with the other held creeps; here each step eliminates the expression
coefficients from the linearised problem, so that the pose is found as if every expression had been tried with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.spatial.transform import Rotation

from headcap.errors import InputError
from headcap.heads import JOINTS, HeadModel
from headcap.neck.fitting.pose_kernel import PARAMETERS, moved, unposed_residuals

_RIGID_SHARE = 0.9
"""A vertex that follows one bone by this share tells where that bone is."""
_UNSTEADY = ("larynx", "eyes", "mouth_interior")
"""Where the skin moves by what is neither pose nor expression, or where no camera sees it."""
_LAST_CHOICE = "front_neck"
"""Speech stirs it: asked only for a bone that is told by too little else."""
_LOST_SIGMAS = 5.0
_FLAT = 1e-5
"""Relative fall of the energy that ends the search: what is left to gain is far below the noise."""


class PoseSettings(BaseModel):
    """Estimating pose."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    vertices_per_bone: int = Field(120, ge=10, description="Vertices that each of trunk, head and jaw are told by")
    noise_mm: float = Field(1.0, gt=0, description="Standard deviation of what neither pose nor expression explains")
    robust_sigmas: float = Field(3.0, gt=0, description="Residuals beyond count linearly (Huber)")
    iterations: int = Field(50, ge=1, description="Most Gauss-Newton steps per frame")
    settled: float = Field(1e-5, gt=0, description="Steps below this (radians, metres) end the search")


@dataclass(frozen=True, eq=False)
class Poses:
    """Placement, neck and jaw of frames."""

    turns: NDArray[np.float64]
    """(f, 3, 3, 3) rotations of placement, neck, jaw."""
    shift: NDArray[np.float64]
    """(f, 3) of the placement, metres."""

    @property
    def theta(self) -> NDArray[np.float64]:
        """theta (f, 2, 3), rotation vectors of neck and jaw, radians."""
        turns = self.turns[:, 1:].reshape(-1, 3, 3)
        vectors = Rotation.from_matrix(turns).as_rotvec() if len(turns) else np.zeros((0, 3))
        return vectors.reshape(-1, len(JOINTS), 3)

    @property
    def placement(self) -> NDArray[np.float64]:
        """world_from_head (f, 4, 4)."""
        out = np.tile(np.eye(4), (len(self.turns), 1, 1))
        out[:, :3, :3], out[:, :3, 3] = self.turns[:, 0], self.shift
        return out


class PoseEstimator:
    """Finds pose and expression of one person's meshes from a few hundred vertices, frame after frame.

    The energy of a frame is sum_v 2 rho(|e_v| / sigma) + |psi|^2 with e = unskinned(mesh) - T_0 - B_P(theta) - B_E(psi), rho
    Huber's function: what remains is measured at rest. Robust weights enter as modified residuals (Huber 1981, 7.8), which leave
    the matrix of the expressions the same for all frames. Steps that raise the energy are damped (Levenberg-Marquardt).
    """

    def __init__(self, model: HeadModel, settings: PoseSettings | None = None, seen: NDArray[np.bool_] | None = None) -> None:
        """Of a personal model (its `vertices` are the neutral head), from the vertices (n,) that are seen.

        Raises `InputError` where a bone has too few vertices.
        """
        self.settings = settings or PoseSettings()
        self.vertices = telling_vertices(model, self.settings.vertices_per_bone, seen)
        chosen = self.vertices
        self._rest = self._now = np.ascontiguousarray(model.vertices[chosen], np.float64)
        self._joints = np.ascontiguousarray(model.joints(), np.float64)
        self._weights = np.ascontiguousarray(model.skinning_weights[chosen], np.float64)
        correctives = model.pose_basis[:, chosen] if model.pose_basis.any() else np.zeros((0, len(chosen), 3))
        self._correctives = np.ascontiguousarray(correctives.transpose(1, 0, 2), np.float64)
        self._scale = 1e-3 * self.settings.noise_mm
        basis = model.expression_basis[:, chosen].reshape(len(model.expression_basis), 3 * len(chosen))
        self._basis = np.ascontiguousarray(basis, np.float64) / self._scale
        self._factor = cho_factor(self._basis @ self._basis.T + np.eye(len(basis)), lower=True)
        self._whitened = solve_triangular(self._factor[0], self._basis, lower=True) if len(basis) else self._basis
        self._jacobian = np.empty((3 * len(chosen), PARAMETERS))
        self._residual = np.empty((len(chosen), 3))

    def estimate(
        self, observed: NDArray, start: tuple[Poses, NDArray] | None = None, shown: NDArray | None = None
    ) -> tuple[Poses, NDArray[np.float64], NDArray[np.float64]]:
        """Poses (f), psi (f, e) and energies (f,) of the telling vertices (f, k, 3) of frames in order of time.

        The first frame begins at the last one of `start` (poses and psi of frames before), or by rigid alignment. `shown`
        (f, k, 3) are displacements at rest that are known already, metres.
        """
        f = len(observed)
        turns, shift, psi = np.empty((f, 3, 3, 3)), np.empty((f, 3)), np.empty((f, len(self._basis)))
        energy = np.empty(f)
        warm = None if start is None else (start[0].turns[-1], start[0].shift[-1], start[1][-1])
        for k, frame in enumerate(np.ascontiguousarray(observed, np.float64)):
            self._now = self._rest if shown is None else self._rest + shown[k]
            found = self._search(frame, *(warm or self._aligned(frame)))
            if warm is not None and found[3] > self._lost:
                found = min(found, self._search(frame, *self._aligned(frame)), key=lambda entry: entry[3])
            turns[k], shift[k], psi[k], energy[k] = found
            warm = found[:3]
        return Poses(turns, shift), psi, energy

    def trace(self, observed: NDArray) -> list[float]:
        """Energies of one frame (k, 3) step by step, from rigid alignment on."""
        energies: list[float] = []
        observed, self._now = np.ascontiguousarray(observed, np.float64), self._rest
        self._search(observed, *self._aligned(observed), energies)
        return energies

    @property
    def _lost(self) -> float:
        return len(self.vertices) * _LOST_SIGMAS**2

    def _aligned(self, observed: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Everything moved rigidly, neck and jaw at rest, no expression."""
        centre, own = observed.mean(axis=0), self._now.mean(axis=0)
        turn = Rotation.align_vectors(observed - centre, self._now - own)[0].as_matrix()
        return np.stack([turn, np.eye(3), np.eye(3)]), centre - turn @ own, np.zeros(len(self._basis))

    def _search(
        self, observed: NDArray, turns: NDArray, shift: NDArray, psi: NDArray, energies: list[float] | None = None
    ) -> tuple[NDArray, NDArray, NDArray, float]:
        """Turns, shift, psi and energy of one frame from where it begins."""
        damping = 1e-6
        left, energy = self._evaluate(observed, turns, shift, psi, self._jacobian)
        for _ in range(self.settings.iterations):
            if energies is not None:
                energies.append(energy)
            step, change = self._step(left, psi, damping)
            trial = (*moved(turns, shift, step), psi + change)
            trial_left, trial_energy = self._evaluate(observed, *trial, self._jacobian)
            if not trial_energy <= energy:
                damping = max(1e-3, 10.0 * damping)
                left, energy = self._evaluate(observed, turns, shift, psi, self._jacobian)
                if damping > 1e6:
                    break
                continue
            (turns, shift, psi), left = trial, trial_left
            fell, energy, damping = energy - trial_energy, trial_energy, max(1e-6, 0.1 * damping)
            if np.abs(step).max() < self.settings.settled or fell <= _FLAT * energy:
                break
        return turns, shift, psi, energy

    def _evaluate(
        self, observed: NDArray, turns: NDArray, shift: NDArray, psi: NDArray, jacobian: NDArray
    ) -> tuple[NDArray[np.float64], float]:
        """Modified residuals (3 k,) in sigmas and the energy."""
        arrays = (observed, self._now, self._correctives, self._weights, self._joints, turns, shift)
        unposed_residuals(*arrays, self._residual, jacobian)
        left = (self._residual.ravel() / self._scale - psi @ self._basis).reshape(-1, 3)
        length = np.sqrt(np.einsum("vi,vi->v", left, left))
        limit = self.settings.robust_sigmas
        far = length > limit
        energy = float(np.where(far, limit * (2 * length - limit), length**2).sum() + psi @ psi)
        return (left * np.where(far, limit / np.maximum(length, 1e-30), 1.0)[:, None]).ravel(), energy

    def _step(self, left: NDArray, psi: NDArray, damping: float) -> tuple[NDArray, NDArray]:
        """Step of the pose's tangents (12,) and of psi (e,) that the linearised problem asks for."""
        jacobian = self._jacobian * (1.0 / self._scale)
        normal, right = jacobian.T @ jacobian, jacobian.T @ left
        prior = self._basis @ left - psi
        change = cho_solve(self._factor, prior) if len(psi) else prior
        if len(psi):
            carried = self._whitened @ jacobian
            normal -= carried.T @ carried
            right -= jacobian.T @ (change @ self._basis)
        normal[np.diag_indices(PARAMETERS)] += damping * np.diagonal(normal) + 1e-9 * np.trace(normal)
        step = np.linalg.solve(normal, right)
        if len(psi):
            change = change - cho_solve(self._factor, self._basis @ (jacobian @ step))
        return step, change


def telling_vertices(model: HeadModel, per_bone: int, seen: NDArray[np.bool_] | None = None) -> NDArray[np.int64]:
    """Vertices (k,) that tell where trunk, head and jaw are: spread over what follows each bone, where speech does not reach.

    Of a bone's vertices those that expressions move less come first. `seen` (n,) leaves out what no camera saw: a tracker makes
    it up, and at the nape it goes with the head. Raises `InputError` where a bone has fewer than three.
    """
    unsteady = np.zeros(len(model.vertices), bool) if seen is None else ~np.asarray(seen, bool)
    if unsteady.shape != (len(model.vertices),):
        raise InputError(
            f"a mask of seen vertices {unsteady.shape}",
            expected=f"({len(model.vertices)},), the vertices of {model.name}",
            remedy="Pass the mask of this model's template.",
        )
    for name in _UNSTEADY:
        unsteady = unsteady | model.regions.get(name, False)
    spread = np.sqrt((model.expression_basis.astype(np.float64) ** 2).sum(axis=(0, 2)))
    chosen = [_of_bone(model, bone, unsteady, spread, per_bone) for bone in range(len(JOINTS) + 1)]
    return np.unique(np.concatenate(chosen))


def _of_bone(model: HeadModel, bone: int, unsteady: NDArray, spread: NDArray, count: int) -> NDArray[np.int64]:
    share = model.skinning_weights[:, bone]
    follows = np.flatnonzero((share > _RIGID_SHARE) & ~unsteady)
    if len(follows) < 3:
        raise InputError(
            f"head model {model.name}: {len(follows)} vertices follow the {('trunk', *JOINTS)[bone]} alone and are seen",
            expected=f"at least 3 with a skinning weight above {_RIGID_SHARE}",
            remedy="Check the model's skinning weights and the mask of what was seen.",
        )
    calm = follows[~model.regions[_LAST_CHOICE][follows]] if _LAST_CHOICE in model.regions else follows
    follows = calm if len(calm) >= count else follows
    steady = follows[np.argsort(spread[follows], kind="stable")[: max(2 * count, len(follows) // 2)]]
    return steady[_spread_out(model.vertices[steady], min(count, len(steady)))]


def _spread_out(points: NDArray, count: int) -> NDArray[np.int64]:
    """Indices (count,) of points, each farthest from those before it."""
    chosen = np.zeros(count, np.int64)
    distance = ((points - points[0]) ** 2).sum(axis=1)
    for k in range(1, count):
        chosen[k] = distance.argmax()
        distance = np.minimum(distance, ((points - points[chosen[k]]) ** 2).sum(axis=1))
    return chosen
