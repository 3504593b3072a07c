"""The hard parts of a subject: eyeballs and teeth, each a little mesh of its own that moves as a body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.synthetic.anatomy import Places
from headcap.synthetic.texture import EYE, LOOK_COLUMNS, TOOTH

_EYE_SHARE = 0.965
"""The eyeball is this much smaller than the sphere the lids were modelled on: their thickness."""
_ARCH_DEPTH_M, _ARCH_HALF_WIDTH_M, _ARCH_BEND_M = 0.0085, 0.021, 0.013


@dataclass(frozen=True)
class Part:
    """One hard part at rest."""

    points: NDArray[np.float64]
    """(n, 3) metres."""
    triangles: NDArray[np.int32]
    material: int
    look: NDArray[np.float32]
    """(n, 7) columns `texture.LOOK_COLUMNS`; places count from the part's own middle."""
    jaw: float
    """1 where it turns with the jaw."""


def eyeball(centre_m: NDArray, radius_m: float) -> Part:
    """An eyeball that looks along z, finest at the pupil."""
    ball, triangles = _sphere(24, 48)
    return Part(centre_m + ball_radius(radius_m) * ball, triangles, EYE, _look(1000 * ball_radius(radius_m) * ball), 0.0)


def ball_radius(lid_radius_m: float) -> float:
    """Radius of the eyeball behind lids that were modelled on a sphere of another."""
    return _EYE_SHARE * lid_radius_m


def teeth(places: Places, *, upper: bool) -> Part:
    """A row of teeth behind the lips: a curved band, rooted in the mouth's wall; it shows once the mouth opens."""
    x = np.linspace(-1, 1, 57)
    edge, root = (-0.0005, 0.0085) if upper else (-0.0022, -0.0100)
    inwards = 0.0 if upper else 0.0018  # the lower row bites behind the upper one
    rows = []
    for share in np.linspace(0, 1, 9):
        bulge = 0.0012 * np.sin(np.pi * min(share + 0.25, 1.0))
        gap = 0.0004 * (np.abs(np.sin(np.pi * 4.0 * x)) < 0.12)
        depth = _ARCH_DEPTH_M + inwards - bulge + gap + _ARCH_BEND_M * x**2
        height = np.full(len(x), edge + share * (root - edge)) + (0.0004 * x**2 if upper else 0)
        rows.append(np.stack([_ARCH_HALF_WIDTH_M * x, height, -depth], axis=1))
    grid = np.array(rows if not upper else rows[::-1])  # from the top row down, so that the front faces outwards
    index = np.arange(grid[..., 0].size).reshape(grid.shape[:2])
    a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel()
    triangles = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)]).astype(np.int32)
    offset = grid.reshape(-1, 3)
    return Part(places.mouth + offset, triangles, TOOTH, _look(1000 * offset), 0.0 if upper else 1.0)


def _look(places_mm: NDArray) -> NDArray[np.float32]:
    look = np.zeros((len(places_mm), len(LOOK_COLUMNS)), np.float32)
    look[:, :3] = places_mm
    return look


def _sphere(rows: int, columns: int) -> tuple[NDArray, NDArray[np.int32]]:
    """Unit sphere with its poles on the z axis; counter-clockwise seen from outside."""
    polar = np.linspace(0, np.pi, rows + 1)[1:-1]
    turn = np.arange(columns) * 2 * np.pi / columns
    ring = np.stack([np.outer(np.sin(polar), np.cos(turn)), np.outer(np.sin(polar), np.sin(turn))], axis=-1)
    body = np.concatenate([ring, np.broadcast_to(np.cos(polar)[:, None, None], (*ring.shape[:2], 1))], axis=-1).reshape(-1, 3)
    points = np.concatenate([[[0, 0, 1.0]], body, [[0, 0, -1.0]]])
    index = 1 + np.arange(len(body)).reshape(len(polar), columns)
    after = np.roll(index, -1, axis=1)
    a, b, c, d = index[:-1].ravel(), after[:-1].ravel(), index[1:].ravel(), after[1:].ravel()
    top = np.stack([np.zeros(columns, int), index[0], after[0]], axis=1)
    bottom = np.stack([np.full(columns, len(points) - 1), after[-1], index[-1]], axis=1)
    return points, np.concatenate([top, np.stack([a, c, b], 1), np.stack([b, c, d], 1), bottom]).astype(np.int32)
