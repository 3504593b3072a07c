"""Minimising a frame's energy: damped Gauss-Newton steps of geometry and light together, albedo in turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from headcap.lips.monocular.harmonics import shading, solve_light
from headcap.lips.monocular.photometric import Normal, observed
from headcap.lips.monocular.problem import Appearance, FrameProblem, Look
from headcap.lips.monocular.settings import MonocularSettings
from headcap.lips.monocular.surface import RIGID, Estimate, Slopes

_HALVINGS = 3


@dataclass(frozen=True, eq=False)
class Fit:
    """Where the steps on one resolution ended."""

    estimate: Estimate
    appearance: Appearance
    look: Look
    energy: float
    steps: int = 0


def descend(
    problem: FrameProblem, estimate: Estimate, appearance: Appearance, level: int, free: NDArray[np.bool_], slopes: Slopes
) -> Fit:
    """Damped Gauss-Newton steps of the free unknowns (unknowns,) and the light on one resolution.

    The matrix is built once and the gradient at each step: the lumped matrix is an upper bound, so it keeps its worth. A step
    that does not lower the energy is halved. The noise is measured where the steps begin, and stays. Light is held near where
    it began, by a share of what the picture says about it.
    """
    slopes = _chosen(slopes, free)
    look = problem.look(estimate, appearance, level)
    frame = _Frame(problem, level, look.photo.scale / problem.settings.robust_sigmas, look.photo.pixels, appearance.light)
    normal = problem.normal(look, appearance, level, slopes)
    frame.held = problem.settings.light_stiffness * max(np.trace(normal.light) / len(normal.light), 1e-12)
    _damp(normal.geometry, slopes)
    fit = Fit(estimate, appearance, look, frame.energy(look, estimate, appearance))
    while fit.steps < problem.settings.iterations:
        better = frame.lower(fit, *_step(frame, fit, normal, slopes))
        if better is None:
            break
        way, fit = _way_px(fit.look, better.look), better
        if way < problem.settings.step_px:
            break
    return fit


@dataclass(eq=False)
class _Frame:
    """What stays during the steps on one resolution."""

    problem: FrameProblem
    level: int
    noise: float
    pixels: float
    light: NDArray
    """Where the light began."""
    held: float = 0.0
    """How firmly it is held there."""

    def energy(self, look: Look, estimate: Estimate, appearance: Appearance) -> float:
        """The problem's energy, and what the light's change costs."""
        changed = float(((appearance.light - self.light) ** 2).sum())
        return self.problem.energy(look, estimate, self.pixels) + self.held * changed

    def lower(self, fit: Fit, step: NDArray, light_step: NDArray) -> Fit | None:
        """The first of the step's halvings that lowers the energy, None where none does."""
        for _ in range(_HALVINGS):
            ahead = self.problem.surface.moved(fit.estimate, step)
            lit = replace(fit.appearance, light=fit.appearance.light + light_step)
            look = self.problem.look(ahead, lit, self.level, self.noise)
            value = self.energy(look, ahead, lit)
            if value < fit.energy and look.photo.pixels > 0.5 * self.pixels:
                return Fit(ahead, lit, look, value, fit.steps + 1)
            step, light_step = 0.5 * step, 0.5 * light_step
        return None


def _step(frame: _Frame, fit: Fit, normal: Normal, slopes: Slopes) -> tuple[NDArray, NDArray]:
    """Step of all unknowns (unknowns,), and of the light (3, 9)."""
    p = len(slopes.columns)
    sparse, sparse_right = frame.problem.sparse_normal(fit.estimate, fit.look.vertices, slopes)
    geometry, light = frame.problem.right(fit.look, fit.appearance, frame.level, slopes)
    matrix = np.block([[normal.geometry + sparse, normal.mixed], [normal.mixed.T, normal.light]])
    matrix[range(p, len(matrix)), range(p, len(matrix))] += frame.held
    right = np.r_[geometry + sparse_right, light + frame.held * (frame.light - fit.appearance.light).ravel()]
    solved, step = np.linalg.solve(matrix, right), np.zeros(frame.problem.surface.unknowns)
    step[slopes.columns] = solved[:p]
    return step, solved[p:].reshape(frame.light.shape)


def _chosen(slopes: Slopes, free: NDArray[np.bool_]) -> Slopes:
    chosen = np.flatnonzero(free[slopes.columns])
    return Slopes(slopes.columns[chosen], slopes.vertices[chosen], slopes.normals[chosen])


def _damp(matrix: NDArray, slopes: Slopes) -> None:
    """Let no step turn the head by a radian or shift it by a metre, whatever a picture without contrast says; in place."""
    diagonal = np.einsum("pp->p", matrix)
    diagonal += np.where(slopes.columns < RIGID.stop, 1.0, 1e-6 * diagonal)


def _way_px(before: Look, after: Look) -> float:
    """Root mean square way of the skin in view."""
    seen = before.photo.sums[:, 0] > 0
    return float(np.sqrt(((after.view.pixels - before.view.pixels)[seen] ** 2).sum(axis=1).mean())) if seen.any() else 0.0


def descend_sparse(
    problem: FrameProblem, estimate: Estimate, free: NDArray[np.bool_], steps: int, slopes: Slopes | None = None
) -> Estimate:
    """Gauss-Newton steps on features and priors alone; `slopes` of a place nearby save their own at each step."""
    surface = problem.surface
    shape, focal = bool(free[surface.shape_columns].any()), bool(free[-1])
    energy = problem.sparse_energy(estimate, surface.in_camera(estimate))
    for _ in range(steps):
        here = slopes or surface.slopes(estimate, shape=shape, focal=focal, normals=False)
        here = _chosen(here, free)
        matrix, right = problem.sparse_normal(estimate, surface.in_camera(estimate), here)
        _damp(matrix, here)
        step = np.zeros(surface.unknowns)
        step[here.columns] = np.linalg.solve(matrix, right)
        ahead = surface.moved(estimate, step)
        value = problem.sparse_energy(ahead, surface.in_camera(ahead))
        if not value < energy:
            break
        estimate, energy = ahead, value
    return estimate


def relight(look: Look, appearance: Appearance, level: int, settings: MonocularSettings) -> Appearance:
    """Light that explains the picture with this geometry and albedo; robust weights as the look has them."""
    seen, weight = observed(look.photo, look.colours)
    light = solve_light(look.normals, appearance.albedo[level], seen, weight, appearance.light, settings.light_stiffness)
    return Appearance(light, appearance.albedo, appearance.trust)


def paint(looks: Sequence[Look], appearance: Appearance, expected: NDArray, settings: MonocularSettings) -> Appearance:
    """Albedo of each resolution from its look, finest first, drawn to `expected` (n, 3) where little is seen.

    Trust is the share of a vertex's pixels, at the finest resolution, that agree with what is expected of them.
    """
    albedo = []
    for look in looks:
        bright = np.maximum(shading(look.normals, appearance.light), 1e-3)
        seen, weight = observed(look.photo, look.colours)
        held = settings.albedo_stiffness
        top = weight[:, None] * bright * seen + held * bright**2 * expected
        albedo.append(top / (weight[:, None] * bright**2 + held * bright**2))
    sums = looks[0].photo.sums
    return Appearance(appearance.light, tuple(albedo), sums[:, 0] / np.maximum(sums[:, 15], 1e-9))
