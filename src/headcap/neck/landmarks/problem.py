"""The least-squares problem of landmarks over time: residuals, analytic derivatives, priors, and its banded solution."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded

from headcap.geometry.rotations import rotation_derivatives, rotation_matrices
from headcap.geometry.transforms import rigid
from headcap.heads import HeadCoefficients, HeadModel
from headcap.neck.fitting.chosen_vertices import model_of_vertices
from headcap.neck.fitting.temporal import second_differences
from headcap.neck.frame_blocks import in_blocks
from headcap.neck.landmarks.landmarks import Landmarks

if TYPE_CHECKING:
    from headcap.neck.landmarks.fitting import LandmarkSettings

BLOCK = 256
"""Frames whose derivatives are held at once."""


@dataclass(eq=False)
class State:
    """Unknowns: one row per frame, beta for all."""

    turn: NDArray[np.float64]
    """(f, 3) rotation vector of the trunk, against the reference placement."""
    shift: NDArray[np.float64]
    """(f, 3) metres."""
    neck: NDArray[np.float64]
    jaw: NDArray[np.float64]
    psi: NDArray[np.float64]
    """(f, e)."""
    beta: NDArray[np.float64]
    """(s,)."""

    @classmethod
    def at_rest(cls, frames: int, expressions: int, shapes: int) -> State:
        """All zero."""
        return cls(*(np.zeros((frames, 3)) for _ in range(4)), np.zeros((frames, expressions)), np.zeros(shapes))

    @property
    def rows(self) -> NDArray[np.float64]:
        """(f, 12 + e)."""
        return np.concatenate([self.turn, self.shift, self.neck, self.jaw, self.psi], axis=1)

    @classmethod
    def of_rows(cls, rows: NDArray, beta: NDArray) -> State:
        """The inverse of `rows`."""
        return cls(*(rows[:, 3 * k : 3 * k + 3].copy() for k in range(4)), rows[:, 12:].copy(), beta)

    def frames(self, chosen: slice) -> State:
        """Some frames."""
        own = (getattr(self, entry.name) for entry in fields(self))
        return State(*(values if values.ndim == 1 else values[chosen] for values in own))


class LandmarkProblem:
    """Energy, its derivatives and distances of a state."""

    def __init__(self, head: HeadModel, landmarks: Landmarks, reference: NDArray, settings: LandmarkSettings) -> None:
        """`reference` (4, 4) is the placement about which the trunk moves."""
        self.landmarks, self.reference = landmarks, reference
        points, self._still = landmarks.points, settings.trunk == "still"
        self._part = model_of_vertices(head.astype(np.float64), points.corners.ravel())
        self._noise = settings.noise_px if landmarks.flat else 1e-3 * settings.noise_mm
        self._robust, self._identity = settings.robust_sigmas, settings.identity
        self._expressions = min(settings.expressions, len(head.expression_basis))
        self._expression_rows = self._carried(self._part.expression_basis[: self._expressions])
        turns = np.radians([settings.trunk_deg] * 3), np.radians([settings.neck_deg] * 3), np.radians(settings.jaw_deg)
        spreads = (turns[0], np.full(3, 1e-3 * settings.trunk_mm), turns[1], turns[2], np.ones(self._expressions))
        self.precision = 1.0 / np.concatenate(spreads) ** 2
        if self._still:  # one placement for all frames: what spread it has is of no matter
            self.precision[:6] = 1e-6
        self._rough, self._steady = None, None
        if settings.temporal is not None and len(landmarks) > 2:
            own, count = settings.temporal, self._expressions
            rates = [own.trunk_rad_s2] * 3 + [own.trunk_m_s2] * 3 + [own.neck_rad_s2] * 3 + [own.jaw_rad_s2] * 3
            self._rough = second_differences(landmarks.time_s)
            self._steady = np.array(rates + [own.expression_s2] * count) ** -2.0
            if self._still:
                self._steady[:6] = 0.0

    @property
    def own(self) -> slice:
        """Which columns of a state's rows are each frame's own; those before them are all frames'."""
        return slice(6 if self._still else 0, None)

    def placement(self, state: State) -> NDArray[np.float64]:
        """world_from_head (f, 4, 4)."""
        return self.reference @ rigid(rotation_matrices(state.turn), state.shift)

    def distances(self, state: State) -> NDArray[np.float64]:
        """(f, k) metres or pixels."""
        parts = [self._left(state.frames(chosen), chosen)[0] for chosen in in_blocks(len(state.turn), BLOCK)]
        return np.concatenate([np.linalg.norm(part, axis=2) for part in parts])

    def energy(self, state: State) -> float:
        """Landmarks, priors and accelerations; infinite where a landmark would lie behind the camera."""
        total = 0.0
        for chosen in in_blocks(len(state.turn), BLOCK):
            left = self._left(state.frames(chosen), chosen)[0]
            if np.isnan(left[self.landmarks.visible[chosen]]).any():
                return np.inf
            length = np.linalg.norm(np.nan_to_num(left), axis=2) / self._noise
            far = length > self._robust
            total += float(np.where(far, self._robust * (2 * length - self._robust), length**2).sum())
        rows = state.rows
        first = 1 if self._still else len(rows)
        total += float((rows[:first, :6] ** 2 @ self.precision[:6]).sum() + (rows[:, 6:] ** 2 @ self.precision[6:]).sum())
        if self._rough is not None:
            total += float((self._bent(rows) ** 2 @ self._steady).sum())
        return total + float(state.beta @ state.beta)

    def normal(self, state: State) -> Normal:
        """The linearised problem at a state."""
        f, q, s = len(state.turn), 12 + self._expressions, len(state.beta) if self._identity else 0
        blocks, cross, right = np.zeros((f, q, q)), np.zeros((f, q, s)), np.zeros((f, q))
        shared, shared_right = np.eye(s), -state.beta[:s].copy()
        for chosen in in_blocks(f, BLOCK):
            left, rows, by_beta = self._left(state.frames(chosen), chosen, slopes=True)
            seen = self.landmarks.visible[chosen]
            left, rows = np.where(seen[..., None], left, 0.0), np.where(seen[..., None, None], rows, 0.0)
            length = np.linalg.norm(left, axis=2) / self._noise
            weight = np.where(length > self._robust, self._robust / np.maximum(length, 1e-30), 1.0) / self._noise**2
            weighted = rows * weight[..., None, None]
            blocks[chosen] = np.einsum("fkdp,fkdq->fpq", weighted, rows, optimize=True)
            right[chosen] = np.einsum("fkdp,fkd->fp", weighted, left, optimize=True)
            if s:
                by_beta = np.where(seen[..., None, None], by_beta, 0.0)
                cross[chosen] = np.einsum("fkdp,fkds->fps", weighted, by_beta, optimize=True)
                heavy = by_beta * weight[..., None, None]
                shared += np.einsum("fkds,fkdt->st", heavy, by_beta, optimize=True)
                shared_right += np.einsum("fkds,fkd->s", heavy, left, optimize=True)
        return self._with_priors(state, blocks, cross, right, shared, shared_right)

    def _with_priors(self, state: State, blocks, cross, right, shared, shared_right) -> Normal:
        rows, own = state.rows, self.own
        first = own.start
        blocks[:, range(first, blocks.shape[1]), range(first, blocks.shape[1])] += self.precision[first:]
        right[:, first:] -= rows[:, first:] * self.precision[first:]
        rough = None
        if self._rough is not None:
            bent = self._bent(rows) * self._steady
            for k in range(3):
                right[k : len(right) - 2 + k] -= self._rough[:, k, None] * bent
            rough = self._rough
        if first:
            # the trunk's six stand beside beta: the same for all frames
            trunk, trunk_right = blocks[:, :first, :first].sum(axis=0), right[:, :first].sum(axis=0)
            trunk[np.diag_indices(first)] += self.precision[:first]
            trunk_right -= rows[0, :first] * self.precision[:first]
            mixed = cross[:, :first].sum(axis=0)
            shared = np.block([[trunk, mixed], [mixed.T, shared]])
            shared_right = np.r_[trunk_right, shared_right]
            cross = np.concatenate([blocks[:, first:, :first], cross[:, first:]], axis=2)
            blocks, right = blocks[:, first:, first:], right[:, first:]
        steady = None if self._steady is None else self._steady[first:]
        return Normal(blocks, cross, right, shared, shared_right, rough, steady, first)

    def _bent(self, rows: NDArray) -> NDArray[np.float64]:
        """(f - 2, q) accelerations."""
        return sum(self._rough[:, k, None] * rows[k : len(rows) - 2 + k] for k in range(3))

    def _left(self, state: State, chosen: slice, *, slopes: bool = False) -> tuple[NDArray, NDArray | None, NDArray | None]:
        """Seen minus shown (b, k, d), and the shown's derivatives (b, k, d, 12 + e) and by beta (b, k, d, s)."""
        theta = np.stack([state.neck, state.jaw], axis=1)
        given = HeadCoefficients(state.beta if len(state.beta) else None, self._padded(state.psi), theta)
        still = self._gathered(self._part.evaluate(given)[:, : self._part.vertices.shape[0] - 2])
        turn, turned = rotation_derivatives(state.turn)
        world = (np.einsum("fij,fkj->fki", turn, still) + state.shift[:, None]) @ self.reference[:3, :3].T + self.reference[:3, 3]
        rows = by_beta = None
        if slopes:
            outer = self.reference[:3, :3] @ turn
            rows, by_beta = self._slopes(given, state, still, outer, turned)
        seen = self.landmarks.seen[chosen]
        if not self.landmarks.flat:
            return seen - world, rows, by_beta
        camera = self.landmarks.camera
        pixels = camera.project(world)[0]
        if slopes:
            flat = camera.project_with_jacobian(world.reshape(-1, 3))[1].reshape(*world.shape[:2], 2, 3)
            rows, by_beta = flat @ rows, None if by_beta is None else flat @ by_beta
        return seen - pixels, rows, by_beta

    def _slopes(self, given: HeadCoefficients, state: State, still: NDArray, outer: NDArray, turned: NDArray):
        """World points' derivatives (b, k, 3, 12 + e), and by beta."""
        b, k = still.shape[:2]
        count, part = self._part.vertices.shape[0] - 2, self._part
        rows = np.empty((b, k, 3, 12 + self._expressions))
        rows[..., :3] = np.einsum("ij,fajl,fkl->fkia", self.reference[:3, :3], turned, still, optimize=True)
        rows[..., 3:6] = self.reference[:3, :3]
        by_pose = self._gathered(part.pose_derivative(given, vertices=np.arange(count)), trailing=2)
        rows[..., 6:12] = np.einsum("fij,fkjp->fkip", outer, by_pose, optimize=True)
        joints = part.joints(part.identity(given.shape))
        blended = outer[:, None] @ part.vertex_transforms(joints, given.pose)[:, :count, :, :3]
        blended = blended.reshape(b, k, 3, 3, 3)
        rows[..., 12:] = np.einsum("fkcij,kcje->fkie", blended, self._expression_rows, optimize=True)
        return rows, self._by_beta(given, blended, outer) if self._identity else None

    def _by_beta(self, given: HeadCoefficients, blended: NDArray, outer: NDArray) -> NDArray[np.float64]:
        """(b, k, 3, s): vertices move with the shape, and so do the joints about which they turn."""
        part, points = self._part, self.landmarks.points
        own = np.einsum("fkcij,kcjs->fkis", blended, self._carried(part.shape_basis), optimize=True)
        joints = np.moveaxis(part.shape_basis[:, -2:], 0, -1)
        turns = rotation_matrices(given.pose)
        neck = (np.eye(3) - turns[:, 0]) @ joints[0]
        jaw = neck + turns[:, 0] @ (np.eye(3) - turns[:, 1]) @ joints[1]
        weights = part.skinning_weights[:-2].reshape(*points.shares.shape, 3)
        weights = np.einsum("kc,kcb->kb", points.shares, weights)
        moved = np.einsum("k,fis->fkis", weights[:, 1], outer @ neck) + np.einsum("k,fis->fkis", weights[:, 2], outer @ jaw)
        return own + moved

    def _carried(self, basis: NDArray) -> NDArray[np.float64]:
        """(k, 3 corners, 3, b) of a basis (b, n, 3), each corner by its share."""
        points = self.landmarks.points
        corners = basis[:, : points.corners.size].reshape(len(basis), *points.corners.shape, 3)
        return np.einsum("bkcx,kc->kcxb", corners, points.shares)

    def _gathered(self, values: NDArray, trailing: int = 1) -> NDArray[np.float64]:
        """Values (b, 3 k, ...) of corners as those of landmarks (b, k, ...)."""
        shares = self.landmarks.points.shares
        values = values.reshape(len(values), *shares.shape, *values.shape[-trailing:])
        return np.einsum("fkc...,kc->fk...", values, shares)

    def _padded(self, psi: NDArray) -> NDArray | None:
        return psi if psi.shape[1] else None


@dataclass(eq=False)
class Normal:
    """Normal equations: blocks of frames, tied to neighbours along the diagonal, and what all frames share."""

    blocks: NDArray[np.float64]
    """(f, q, q)."""
    cross: NDArray[np.float64]
    """(f, q, s) between frames and what is shared."""
    right: NDArray[np.float64]
    """(f, q)."""
    shared: NDArray[np.float64]
    """(s, s)."""
    shared_right: NDArray[np.float64]
    rough: NDArray[np.float64] | None
    """(f - 2, 3) second differences."""
    steady: NDArray[np.float64] | None
    """(q,) what a squared second difference costs."""
    trunk: int
    """How many of what is shared are the trunk's: 0 or 6."""

    def moved(self, state: State, damping: float) -> State:
        """The state after a damped step."""
        f, _, s = self.cross.shape
        blocks, shared = self.blocks.copy(), self.shared.copy()
        diagonal = np.einsum("fqq->fq", blocks)
        diagonal += damping * diagonal + 1e-12
        shared[np.diag_indices(s)] *= 1 + damping
        sides = np.concatenate([self.right[:, :, None], self.cross], axis=2)
        solved = np.linalg.solve(blocks, sides) if self.rough is None else self._banded(blocks, sides)
        step = np.zeros(s)
        if s:
            matrix = shared - np.einsum("fqs,fqt->st", self.cross, solved[:, :, 1:], optimize=True)
            step = np.linalg.solve(matrix, self.shared_right - np.einsum("fqs,fq->s", self.cross, solved[:, :, 0]))
        own = solved[:, :, 0] - solved[:, :, 1:] @ step
        change = np.concatenate([np.broadcast_to(step[: self.trunk], (f, self.trunk)), own], axis=1)
        beta = state.beta + step[self.trunk :] if s > self.trunk else state.beta
        return State.of_rows(state.rows + change, beta)

    def _banded(self, blocks: NDArray, sides: NDArray) -> NDArray[np.float64]:
        """Solutions (f, q, m) with the ties to neighbours, by a banded Cholesky factor of 2 q + 1 diagonals."""
        f, q = blocks.shape[:2]
        band = np.zeros((2 * q + 1, f, q))
        for j in range(q):
            for i in range(j + 1):
                band[2 * q - (j - i), :, j] = blocks[:, i, j]
        for a in range(3):
            for b in range(a, 3):
                tie = (self.rough[:, a] * self.rough[:, b])[:, None] * self.steady
                band[2 * q - (b - a) * q, b : b + f - 2] += tie
        factor = cholesky_banded(band.reshape(2 * q + 1, f * q), check_finite=False)
        return cho_solve_banded((factor, False), sides.reshape(f * q, -1), check_finite=False).reshape(sides.shape)
