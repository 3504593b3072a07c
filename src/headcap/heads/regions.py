"""Masks the neck model needs on top of what a source names: front neck, larynx region L, its border B, the rest N, lips."""

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.meshes.topology import boundary_mask, grow, vertex_adjacency

FRONT_AZIMUTH_DEG = 75.0
"""How far around the neck, from straight ahead, its front reaches."""
FRONT_DOWN_M = 0.080
"""How far below the prominence the front of the neck goes: to the collar bones, where a model has a chest."""
LARYNX_HALF_WIDTH_M, LARYNX_UP_M, LARYNX_DOWN_M = 0.036, 0.038, 0.048
"""L about the prominence: the bump's half width or height (about 20 mm) and the way it slides (a swallow lifts it by 20 to 25 mm
at most until it meets the jaw's underside; it sinks by half that), with a margin in which the offset fades."""


def with_neck_regions(
    vertices: NDArray, triangles: NDArray, regions: dict[str, NDArray], larynx: NDArray, neck_joint: NDArray
) -> dict[str, NDArray[np.bool_]]:
    """The regions (n,) and front_neck, larynx (L), larynx_boundary (B), non_larynx (N), of a head at rest (n, 3).

    `larynx` (3,) is the prominence on the skin, `neck_joint` (3,) the middle of the neck. Paper, section 5.2: L is all skin the
    sliding larynx reaches; B, its vertices with a neighbour outside; N, the neck without L. Raises `InputError` where the head
    has no neck there.
    """
    n = len(vertices)
    azimuth = np.degrees(np.arctan2(np.abs(vertices[:, 0]), vertices[:, 2] - neck_joint[2]))
    front = regions["neck"] & (azimuth < FRONT_AZIMUTH_DEG)
    throat = throat_direction(vertices, front, larynx)
    along = (vertices - larynx) @ throat
    front &= along > -FRONT_DOWN_M
    adjacency = vertex_adjacency(triangles, n)
    # two rings stay between L and the border of the patch, so that the border never moves
    inner = front & ~grow(~front | boundary_mask(triangles, n), adjacency, 2)
    across = vertices[:, 0] - larynx[0]
    half = np.where(along > 0, LARYNX_UP_M, LARYNX_DOWN_M)
    inside = inner & ((across / LARYNX_HALF_WIDTH_M) ** 4 + (along / half) ** 4 < 1.0)
    if inside.sum() < 50:
        raise InputError(
            f"{int(inside.sum())} vertices of the front of the neck lie about the larynx",
            expected="50 at least",
            remedy="The head needs a neck below the chin; check its units (metres) and axes (y up, z out of the face).",
        )
    border = inside & grow(~inside, adjacency, 1)
    return regions | {
        "front_neck": front,
        "larynx": inside,
        "larynx_boundary": border,
        "non_larynx": regions["neck"] & ~inside,
    }


def throat_direction(vertices: NDArray, front_neck: NDArray[np.bool_], larynx: NDArray) -> NDArray[np.float64]:
    """Unit vector (3,) up along the throat, in the midplane, fitted to the midline within 35 mm of the larynx (3,)."""
    away = vertices[front_neck] - larynx
    near = away[(np.abs(away[:, 0]) < 0.008) & (np.abs(away[:, 1]) < 0.035)]
    if len(near) < 4:
        return np.array([0.0, 1.0, 0.0])
    slope = np.polyfit(near[:, 1], near[:, 2], 1)[0]
    return np.array([0.0, 1.0, slope]) / np.hypot(1.0, slope)


def with_lip_regions(regions: dict[str, NDArray]) -> dict[str, NDArray[np.bool_]]:
    """The regions and lips_outer (what is seen with the mouth shut) and lips_inner (what is rolled in), both lips together."""
    n = len(regions["face"])
    empty = np.zeros(n, bool)
    inner = regions.get("lips_inner_upper", empty) | regions.get("lips_inner_lower", empty)
    outer = regions.get("lips_upper", empty) | regions.get("lips_lower", empty)
    return regions | {"lips_outer": outer, "lips_inner": inner}
