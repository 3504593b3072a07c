"""The energy of one frame: dense photometric term, sparse features, priors; and its normal equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.lips.monocular import photometric
from headcap.lips.monocular.harmonics import harmonics, shading, shading_slopes
from headcap.lips.monocular.photometric import Chain, Level, Normal, PhotoSums, View
from headcap.lips.monocular.settings import MonocularSettings
from headcap.lips.monocular.surface import FIRST_EXPRESSION, JAW, Estimate, FaceSurface, Slopes

_MEDIAN_OF_LENGTH = 1.5382
"""Median length of three independent standard normal numbers."""
_FEATURE_FAR = 3.0**2
"""Squared distance, in standard deviations, at which a feature has lost three quarters of its say."""


@dataclass(frozen=True, eq=False)
class Appearance:
    """Light, and what the skin looks like under it."""

    light: NDArray[np.float64]
    """(3, 9) radiance of the channels, in the camera's axes; the skin's mean colour is in it."""
    albedo: tuple[NDArray[np.float64], ...]
    """(n, 3) per resolution, finest first, as a picture of that resolution shows it; 1 for the mean skin."""
    trust: NDArray[np.float64]
    """(n,) 0 to 1: how well the albedo is known; 0 leaves a vertex out."""

    def colours(self, level: int, normals: NDArray) -> NDArray[np.float64]:
        """Rendered colours (n, 3) of vertices with unit normals (n, 3)."""
        return self.albedo[level] * shading(normals, self.light)


@dataclass(frozen=True, eq=False)
class Features:
    """Sparse helpers: k vertices of a surface and where a picture shows them."""

    vertices: NDArray[np.int64]
    pixels: NDArray[np.float64]
    """(k, 2)."""
    noise_px: float
    """Standard deviation along each axis."""
    camera: Camera
    """That the pixels belong to, in its own axes: of the picture's full resolution, or of another."""


@dataclass(frozen=True, eq=False)
class Prior:
    """Independent normal priors of jaw, expression, shape and focal length: a sum of pulls towards given places."""

    precision: NDArray[np.float64]
    """(unknowns,) zero for the rigid motion."""
    pull: NDArray[np.float64]
    """(unknowns,) precision times centre."""

    @classmethod
    def of(cls, surface: FaceSurface, settings: MonocularSettings) -> Prior:
        """Zero mean; expression and shape have unit variance."""
        precision = np.zeros(surface.unknowns)
        precision[JAW] = np.radians(settings.jaw_deg) ** -2.0
        precision[FIRST_EXPRESSION:-1] = 1.0
        precision[-1] = settings.focal_spread**-2
        return cls(precision, np.zeros(surface.unknowns))

    def near(self, surface: FaceSurface, before: Estimate, settings: MonocularSettings, steps: float = 1.0) -> Prior:
        """This prior and that of a frame's change from the one before, `steps` usual intervals ago: a random walk."""
        step = np.zeros(surface.unknowns)
        step[JAW] = np.radians(settings.jaw_step_deg) ** -2.0 / steps
        step[surface.expression_columns] = settings.expression_step**-2 / steps
        return Prior(self.precision + step, self.pull + step * before.coordinates)

    def energy(self, estimate: Estimate) -> float:
        """Twice the negative logarithm, up to a constant."""
        place = estimate.coordinates
        return float(place**2 @ self.precision - 2.0 * place @ self.pull)

    def right(self, estimate: Estimate) -> NDArray[np.float64]:
        """Minus half the gradient (unknowns,)."""
        return self.pull - self.precision * estimate.coordinates


@dataclass(frozen=True, eq=False)
class Look:
    """A surface as one resolution sees it."""

    vertices: NDArray[np.float64]
    normals: NDArray[np.float64]
    """(n, 3) in the camera's axes."""
    level: Level
    view: View
    colours: NDArray[np.float64]
    """(n, 3) rendered."""
    photo: PhotoSums
    weight: float
    """Of a squared intensity against the priors: 1 / (noise^2 times the pixels that err together)."""


class FrameProblem:
    """One frame's energy on several resolutions of its picture."""

    def __init__(
        self,
        surface: FaceSurface,
        levels: Sequence[Level],
        prior: Prior,
        settings: MonocularSettings,
        features: Sequence[Features] = (),
        most_noise: float = np.inf,
        correlated_mm: float | None = None,
    ) -> None:
        """`levels` finest first; residuals beyond `most_noise` (linear intensity) are never taken for noise.

        `correlated_mm` is how far on the skin errors of the rendering are alike (the settings' own by default).
        """
        self._most_noise = most_noise
        self._correlated_m = 1e-3 * (settings.correlated_mm if correlated_mm is None else correlated_mm)
        self.surface, self.levels = surface, tuple(levels)
        self.prior, self.settings, self.features = prior, settings, tuple(features)

    def helped_by(self, features: Features) -> FrameProblem:
        """This problem with more features."""
        return FrameProblem(
            self.surface,
            self.levels,
            self.prior,
            self.settings,
            (*self.features, features),
            self._most_noise,
            1e3 * self._correlated_m,
        )

    def look(self, estimate: Estimate, appearance: Appearance, level: int, noise: float | None = None) -> Look:
        """The surface at an estimate; without a noise (linear intensity) it is measured, see `noise_of`."""
        here = self.levels[level]
        if estimate.log_focal:
            here = replace(here, camera=estimate.camera(here.camera))
        vertices = self.surface.in_camera(estimate)
        normals = self.surface.normals(vertices)
        view = photometric.see(here, vertices, self.surface.triangles)
        colours = appearance.colours(level, normals)
        triangles, trust = self.surface.triangles, appearance.trust
        if noise is None:
            noise = self.noise_of(photometric.residual_lengths(here, view, triangles, colours, trust))
        photo = photometric.gather(here, view, triangles, colours, trust, self.settings.robust_sigmas * noise)
        pixel_m = vertices[:, 2].mean() / here.camera.matrix[0, 0]
        alike = max(1.0, np.pi * (self._correlated_m / pixel_m) ** 2)
        return Look(vertices, normals, here, view, colours, photo, 1.0 / (alike * noise**2))

    def noise_of(self, lengths: NDArray) -> float:
        """Robust standard deviation, linear intensity per channel, of residuals of lengths (k,)."""
        median = float(np.median(lengths)) if len(lengths) else 0.0
        return max(min(median / _MEDIAN_OF_LENGTH, self._most_noise), self.settings.least_noise)

    def energy(self, look: Look, estimate: Estimate, pixels: float) -> float:
        """The photometric part is the mean over seen pixels times `pixels`: skin that turns away is no gain."""
        photo = look.photo
        dense = photo.cost * photo.scale**2 * look.weight * pixels / max(photo.pixels, 1e-9)
        return dense + self.sparse_energy(estimate, look.vertices)

    def sparse_energy(self, estimate: Estimate, vertices: NDArray) -> float:
        """Features and priors alone, of vertices (n, 3) in the camera's axes."""
        total = self.prior.energy(estimate)
        for features in self.features:
            square = (self._distances(features, estimate, vertices) ** 2).sum(axis=1)
            total += float((_FEATURE_FAR * square / (_FEATURE_FAR + square)).sum())
        return total

    def normal(self, look: Look, appearance: Appearance, level: int, slopes: Slopes) -> Normal:
        """Photometric part of the Gauss-Newton matrix of the unknowns of `slopes` and the light."""
        normal = photometric.normal_matrix(look.photo, self._chain(look, appearance, level), slopes)
        return Normal(look.weight * normal.geometry, look.weight * normal.mixed, look.weight * normal.light)

    def right(self, look: Look, appearance: Appearance, level: int, slopes: Slopes) -> tuple[NDArray, NDArray]:
        """Photometric part of minus half the energy's gradient by geometry (p,) and light (27,)."""
        geometry, light = photometric.right_side(look.photo, self._chain(look, appearance, level), slopes)
        return look.weight * geometry, look.weight * light

    def sparse_normal(self, estimate: Estimate, vertices: NDArray, slopes: Slopes) -> tuple[NDArray, NDArray]:
        """Matrix (p, p) and right side (p,) of features and priors, of vertices (n, 3) in the camera's axes."""
        matrix, right = np.diag(self.prior.precision[slopes.columns]), self.prior.right(estimate)[slopes.columns]
        for features in self.features:
            left = self._distances(features, estimate, vertices)
            weight = (_FEATURE_FAR / (_FEATURE_FAR + (left**2).sum(axis=1))) ** 2
            camera = estimate.camera(features.camera)
            jacobian = camera.project_with_jacobian(vertices[features.vertices])[1] / features.noise_px
            rows = np.einsum("kdi,pki->pkd", jacobian, slopes.vertices[:, features.vertices], optimize=True)
            matrix += np.einsum("pkd,k,qkd->pq", rows, weight, rows, optimize=True)
            right += np.einsum("pkd,k,kd->p", rows, weight, left, optimize=True)
        return matrix, right

    def _chain(self, look: Look, appearance: Appearance, level: int) -> Chain:
        albedo = appearance.albedo[level][:, :, None]
        colours = albedo * shading_slopes(look.normals, appearance.light)
        pixels = look.level.camera.project_with_jacobian(look.vertices)[1]
        return Chain(pixels, colours, albedo * harmonics(look.normals)[:, None, :])

    def _distances(self, features: Features, estimate: Estimate, vertices: NDArray) -> NDArray[np.float64]:
        """Seen minus shown (k, 2) in standard deviations."""
        shown = estimate.camera(features.camera).project(vertices[features.vertices])[0]
        return (features.pixels - shown) / features.noise_px
