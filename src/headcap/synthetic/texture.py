"""The look of the subject's skin as a solid texture: colour is a function of the place on the resting body.

A solid texture needs no seams and no resolution: where the picture is coarse, fine grain fades out and the edges of
tattoos are widened to a sample's footprint, which is the filtering a sensor's pixel would do.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

# materials of triangles
SKIN, EYE, MOUTH, TOOTH = 0, 1, 2, 3
# columns of a surface's look, per vertex
LOOK_COLUMNS = ("x_mm", "y_mm", "z_mm", "tattoo", "lips", "tone", "freckles")

_COARSE_STEP_MM, _COARSE_CELLS = 1.3, 96
_FINE_STEP_MM, _FINE_CELLS = 0.45, 128
_TATTOO_WAVELENGTH_MM = 10.0


@dataclass(frozen=True)
class Grain:
    """Periodic noise volumes of unit variance, float32."""

    coarse: NDArray[np.float32]
    """(96, 96, 96), 1.3 mm apart, one band of wavelengths about 10 mm: the shapes of tattoos."""
    fine: NDArray[np.float32]
    """(128, 128, 128), 0.45 mm apart, wavelengths from 1.2 to 8 mm: freckles and pores."""


@lru_cache(maxsize=2)
def make_grain(seed: int) -> Grain:
    """Noise volumes of a subject."""
    random = np.random.default_rng([seed, 77])
    band = lambda k: np.exp(-0.5 * (np.log(np.maximum(k, 1e-6) * _TATTOO_WAVELENGTH_MM) / 0.28) ** 2)  # noqa: E731
    pink = lambda k: np.where((k > 1 / 8) & (k < 1 / 1.2), np.maximum(k, 1e-6) ** -1.7, 0.0)  # noqa: E731
    return Grain(
        _filtered_noise(random, _COARSE_CELLS, _COARSE_STEP_MM, band), _filtered_noise(random, _FINE_CELLS, _FINE_STEP_MM, pink)
    )


def _filtered_noise(random: np.random.Generator, cells: int, step_mm: float, gain) -> NDArray[np.float32]:
    import scipy.fft

    spectrum = scipy.fft.rfftn(random.standard_normal((cells, cells, cells)).astype(np.float32))
    k = np.fft.fftfreq(cells, step_mm)
    radius = np.sqrt(k[:, None, None] ** 2 + k[None, :, None] ** 2 + np.fft.rfftfreq(cells, step_mm)[None, None] ** 2)
    noise = scipy.fft.irfftn(spectrum * gain(radius).astype(np.float32), (cells, cells, cells))
    return np.ascontiguousarray(noise / noise.std(), np.float32)


def smooth_noise(points_m: NDArray, random: np.random.Generator, wavelength_m: float, terms: int = 24) -> NDArray[np.float64]:
    """Smooth noise (n,) of about unit variance at points (n, 3): a sum of plane waves in random directions."""
    directions = random.normal(size=(terms, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    frequency = 2 * np.pi / wavelength_m * random.uniform(0.7, 1.4, terms)
    phase = random.uniform(0, 2 * np.pi, terms)
    return np.cos(points_m @ (directions * frequency[:, None]).T + phase).sum(1) * np.sqrt(2 / terms)


def colours(look: NDArray, material: NDArray, grain: Grain, footprint_mm: float) -> NDArray[np.float32]:
    """Linear RGB albedo (n, 3) at points with look (n, 7) and material (n,), filtered to a footprint."""
    out = np.empty((len(look), 3), np.float32)
    _colours(np.ascontiguousarray(look, np.float32), material, grain.coarse, grain.fine, np.float32(footprint_mm), out)
    return out


@njit(cache=True)
def _colours(look, material, coarse, fine, footprint_mm, out):
    for k in range(len(look)):
        row = look[k]
        out[k, 0], out[k, 1], out[k, 2] = albedo(
            material[k], row[0], row[1], row[2], row[3], row[4], row[5], row[6], coarse, fine, footprint_mm
        )


@njit(cache=True, fastmath=True, inline="always")
def _floor(x):
    whole = int(x)
    return whole - 1 if x < whole else whole


@njit(cache=True, fastmath=True, inline="always")
def _wrapped(whole, n):
    """A whole number modulo n, unsigned: by a product with 1 / n, which takes a fraction of a division's time."""
    whole -= n * int(whole * (1.0 / n))
    # the product is cut off towards zero, and can miss by a period where n divides the number
    return np.uint64(whole + n if whole < 0 else whole - n if whole >= n else whole)


@njit(cache=True, inline="always")
def _after(i, n):
    return i + np.uint64(1) if i + np.uint64(1) < n else np.uint64(0)


@njit(cache=True, fastmath=True)
def lattice(volume, x, y, z):
    """Trilinear value of a periodic volume at lattice coordinates."""
    n = volume.shape[0]
    fx, fy, fz = _floor(x), _floor(y), _floor(z)
    tx, ty, tz = np.float32(x - fx), np.float32(y - fy), np.float32(z - fz)
    i, j, k = _wrapped(fx, n), _wrapped(fy, n), _wrapped(fz, n)
    i1, j1, k1 = _after(i, n), _after(j, n), _after(k, n)
    a = volume[i, j, k] + tz * (volume[i, j, k1] - volume[i, j, k])
    b = volume[i, j1, k] + tz * (volume[i, j1, k1] - volume[i, j1, k])
    c = volume[i1, j, k] + tz * (volume[i1, j, k1] - volume[i1, j, k])
    d = volume[i1, j1, k] + tz * (volume[i1, j1, k1] - volume[i1, j1, k])
    a += ty * (b - a)
    c += ty * (d - c)
    return a + tx * (c - a)


@njit(cache=True, fastmath=True)
def albedo(material, x, y, z, tattoo, lips, tone, freckles, coarse, fine, footprint):
    """Linear RGB at a place of the resting body (mm); for an eye x, y, z count from its centre."""
    if material == 1:
        return _eye(x, y, z, footprint)
    if material == 3:
        # the gaps between teeth are dark, their roots yellower
        gap = np.float32(1.0) - np.float32(0.5) * max(np.float32(0.0), np.float32(1.0) - abs(np.float32(np.sin(x * 0.6))) * 5)
        return np.float32(0.60) * gap, np.float32(0.54) * gap, np.float32(0.43) * gap
    fade = np.float32(1.0) / (np.float32(1.0) + (footprint / np.float32(1.1)) ** 2)
    grain = lattice(fine, x / 0.45, y / 0.45, z / 0.45) * fade
    if material == 2:
        shade = np.float32(1.0) + np.float32(0.10) * grain
        return np.float32(0.30) * shade, np.float32(0.09) * shade, np.float32(0.08) * shade
    shade = np.float32(1.0) + tone * np.float32(0.03) - (np.float32(0.018) + np.float32(0.075) * freckles) * grain
    r, g, b = np.float32(0.60) * shade, np.float32(0.37) * shade, np.float32(0.28) * shade
    g *= np.float32(1.0) - np.float32(0.018) * tone
    b *= np.float32(1.0) - np.float32(0.014) * tone
    if lips > 0:
        lines = np.float32(1.0) + np.float32(0.10) * grain
        r += lips * (np.float32(0.47) * lines - r)
        g += lips * (np.float32(0.17) * lines - g)
        b += lips * (np.float32(0.16) * lines - b)
    if tattoo > 0.01:
        value = lattice(coarse, x / 1.3 + 11.0, y / 1.3, z / 1.3)
        # the noise climbs by about 2 pi / 10 per millimetre where it crosses the threshold
        width = np.float32(0.63) * max(np.float32(0.3), footprint)
        ink = min(max((value - np.float32(0.35)) / width + np.float32(0.5), np.float32(0.0)), np.float32(1.0))
        ink = np.float32(0.82) * ink * ink * (3 - 2 * ink) * min(tattoo * np.float32(1.5), np.float32(1.0))
        r += ink * (np.float32(0.05) - r)
        g += ink * (np.float32(0.055) - g)
        b += ink * (np.float32(0.065) - b)
    return r, g, b


@njit(cache=True, fastmath=True)
def _eye(x, y, z, footprint):
    from_axis = np.sqrt(x * x + y * y) if z > 0 else np.float32(99.0)
    angle = np.arctan2(y, x)
    width = max(np.float32(0.35), footprint)
    iris = min(max((np.float32(5.9) - from_axis) / width + np.float32(0.5), np.float32(0.0)), np.float32(1.0))
    pupil = min(max((np.float32(2.1) - from_axis) / width + np.float32(0.5), np.float32(0.0)), np.float32(1.0))
    fibres = np.float32(1.0) + np.float32(0.25) * np.float32(np.sin(23 * angle) * np.sin(7 * angle + 1))
    r, g, b = np.float32(0.66), np.float32(0.62), np.float32(0.58)
    r += iris * (np.float32(0.16) * fibres - r)
    g += iris * (np.float32(0.12) * fibres - g)
    b += iris * (np.float32(0.07) * fibres - b)
    dark = np.float32(1.0) - np.float32(0.93) * pupil
    return r * dark, g * dark, b * dark
