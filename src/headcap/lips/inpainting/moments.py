"""Which moments to take: the untattooed one, mouth a little open, and the tattooed one that is most like it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.lips.inpainting.region import LipRegion
from headcap.registration.register import lip_pairs
from headcap.registration.template import Template

LEAST_GAP_MM = 1.5
"""Between the middles of the lips, for a mouth that is a little open: a closed one hides where its lips meet."""


def slightly_open(meshes: Iterable[NDArray], template: Template, region: LipRegion) -> tuple[int, float]:
    """Which mesh (n, 3) of an untattooed take to make the texture from, and how far apart its lips are, millimetres.

    "With the mouth slightly open (to avoid occlusions)": of those whose lips part by `LEAST_GAP_MM` the one most like the neutral
    template about the mouth, or the widest open where none do. Raises `InputError` without meshes.
    """
    pairs = lip_pairs(template)
    upper, lower = pairs[len(pairs) // 2]
    wanted = _centred(template.vertices, region)
    found = [(1e3 * float(np.linalg.norm(np.subtract(mesh[upper], mesh[lower]))), _away(mesh, wanted, region)) for mesh in meshes]
    if not found:
        raise InputError("an untattooed take without frames", expected="one at least", remedy="Look at the take's tracking.")
    gap_mm, away = np.array(found).T
    opened = gap_mm >= LEAST_GAP_MM
    number = int(np.argmin(np.where(opened, away, np.inf)) if opened.any() else np.argmax(gap_mm))
    return number, float(gap_mm[number])


def most_alike(meshes: Iterable[NDArray], mesh: NDArray, region: LipRegion) -> tuple[int, float]:
    """Which of some meshes (n, 3) lies most like another about the mouth, and the distance, rms in metres, after the mean shift.

    The reference pose of the shading equalisation. Turned heads are shaded otherwise, so turns count. Raises
    `InputError` without meshes.
    """
    wanted = _centred(mesh, region)
    away = [_away(other, wanted, region) for other in meshes]
    if not away:
        raise InputError("a tattooed take without frames", expected="one at least", remedy="Look at the take's tracking.")
    return int(np.argmin(away)), float(min(away))


def most_unlike(open_meshes: Callable[[], Iterable[NDArray]], mesh: NDArray, region: LipRegion, count: int) -> list[int]:
    """Which of some meshes (n, 3), at most `count`, rising, differ most about the mouth from another and from each other.

    Farthest-point sampling; `open_meshes` gives them anew each time, so that they need not be held in memory.
    """
    chosen: list[int] = []
    nearest, wanted = np.inf, _centred(mesh, region)
    while len(chosen) < count:
        nearest = np.minimum(nearest, [_away(other, wanted, region) for other in open_meshes()])
        farthest = int(np.argmax(nearest))
        if nearest[farthest] <= 0:
            break
        chosen.append(farthest)
        wanted = _centred(next(itertools.islice(open_meshes(), farthest, None)), region)
    return sorted(chosen)


def _away(mesh: NDArray, wanted: NDArray, region: LipRegion) -> float:
    return float(np.sqrt(((_centred(mesh, region) - wanted) ** 2).sum(axis=1).mean()))


def _centred(mesh: NDArray, region: LipRegion) -> NDArray[np.float64]:
    points = np.asarray(mesh, float)[region.vertices]
    return points - points.mean(axis=0)
