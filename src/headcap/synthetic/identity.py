"""What makes a subject someone: proportions, asymmetry, the bare throat, fine relief and the look of the skin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from headcap.meshes.laplacian import Factor, bilaplacian, uniform_laplacian
from headcap.meshes.normals import vertex_normals
from headcap.synthetic.anatomy import Places
from headcap.synthetic.texture import smooth_noise


def vary(points_m: NDArray, random: np.random.Generator, strength: float) -> NDArray[np.float64]:
    """Points (n, 3) of the generic head moved to another person's: named proportions, then smooth noise along all axes.

    The noise also slides material along the skin, so vertices of the generic head are no landmarks of the subject.
    """
    points = points_m.copy()
    width, depth, jaw, length, nose = random.normal(0, strength, 5)
    below = 1 / (1 + np.exp((points[:, 1] + 0.055) / 0.018))
    points[:, 0] *= 1 + 0.02 * width + 0.02 * jaw * below
    points[:, 2] *= 1 + 0.018 * depth
    points[:, 1] *= 1 + 0.015 * length
    tip = np.exp(-0.5 * ((points_m - [0, -0.032, 0.115]) ** 2).sum(1) / 0.016**2)
    points[:, 2] += 0.0018 * nose * tip
    mirrored = np.abs(points_m[:, :1]) * [[1.0, 0, 0]] + points_m * [0, 1.0, 1.0]
    side = np.tanh(points_m[:, 0] / 0.02)
    for axis, amplitude in enumerate((0.0012, 0.0022, 0.0022)):
        even = smooth_noise(mirrored, random, 0.13)
        odd = smooth_noise(points_m, random, 0.2)
        points[:, axis] += strength * amplitude * (even * (side if axis == 0 else 1) + 0.35 * odd)
    return points


def bare_throat(points_m: NDArray, triangles: NDArray, places: Places, radius_m: float = 0.034) -> NDArray[np.float64]:
    """Points (n, 3) with any larynx bump taken off: the throat becomes the thin plate that its surroundings span."""
    free = np.linalg.norm(points_m - places.larynx, axis=1) < radius_m
    energy = bilaplacian(uniform_laplacian(triangles, len(points_m)))
    inside = energy[free][:, free] + 1e-12 * sparse.eye_array(int(free.sum()))
    out = points_m.copy()
    out[free] = Factor(inside).solve(-energy[free][:, ~free] @ points_m[~free])
    return out


def add_detail(
    points_m: NDArray, triangles: NDArray, relief: NDArray, random: np.random.Generator, rms_m: float
) -> NDArray[np.float64]:
    """Points (n, 3) with fine relief of two scales along the normals, `relief` (n,) tells where and how much."""
    noise = 0.8 * smooth_noise(points_m, random, 0.011, 48) + 0.6 * smooth_noise(points_m, random, 0.006, 48)
    return points_m + rms_m * (relief * noise)[:, None] * vertex_normals(points_m, triangles)


def skin_look(
    points_m: NDArray, regions: dict[str, NDArray], places: Places, random: np.random.Generator, *, tattoos: bool
) -> NDArray[np.float32]:
    """Columns `texture.LOOK_COLUMNS` (n, 7) of skin points; `regions` hold weights (n,)."""
    tone = 0.7 * smooth_noise(points_m, random, 0.05) + 0.5 * smooth_noise(points_m, random, 0.018)
    freckles = np.clip(0.5 + 0.8 * smooth_noise(points_m, random, 0.06), 0, 1)
    lips = np.clip(regions["lips_upper"] + regions["lips_lower"], 0, 1)
    # the blood near ears, nose and cheeks
    nose = np.exp(
        -0.5 * ((points_m - [0, 0.5 * (places.mouth[1] + places.eye_left[1]), places.mouth[2] + 0.012]) ** 2).sum(1) / 0.02**2
    )
    tone = tone + 0.8 * nose + 0.7 * regions["ears"]
    ink = _tattooed(points_m, regions, places) if tattoos else np.zeros(len(points_m))
    return np.column_stack([points_m * 1000, ink, lips, tone, freckles]).astype(np.float32)


def tattoo_lips(look: NDArray, points_m: NDArray, regions: dict[str, NDArray], places: Places) -> NDArray[np.float32]:
    """The look (n, 7) with tattoos on the lips and around them as well, for lip takes."""
    away = (points_m - places.mouth) / [0.042, 0.026, 0.05]
    ink = _plateau(1.2 - np.linalg.norm(away, axis=1), 0.4) * (regions["mouth_interior"] < 0.5)
    out = look.copy()
    out[:, 3] = np.maximum(out[:, 3], ink)
    return out


def _tattooed(points_m: NDArray, regions: dict[str, NDArray], places: Places) -> NDArray[np.float64]:
    low = places.chin[1] - 0.022
    # the border between neck and jaw climbs towards the ears
    climb = low + 0.42 * np.clip(places.chin[2] - points_m[:, 2], 0, 0.09)
    neck = _plateau((climb - points_m[:, 1]) / 0.006 + 0.5, 1.0)
    cheek = np.zeros(len(points_m))
    for corner, side in ((places.mouth_left, 1), (places.mouth_right, -1)):
        middle = corner + np.array([0.026 * side, 0.008, -0.028])
        away = (points_m - middle) / [0.05, 0.024, 0.036]
        keep_off = np.clip((np.abs(points_m[:, 0]) - np.abs(corner[0]) - 0.002) / 0.006, 0, 1)
        cheek = np.maximum(cheek, _plateau(1.15 - np.linalg.norm(away, axis=1), 0.25) * keep_off)
    ink = np.maximum(neck, cheek) * (regions["ears"] < 0.5) * (regions["mouth_interior"] < 0.5)
    return np.clip(ink, 0, 1)


def _plateau(value: NDArray, width: float) -> NDArray:
    part = np.clip(value / width, 0, 1)
    return part * part * (3 - 2 * part)
