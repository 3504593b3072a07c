"""Mouths in a mirror: a face that smirks to the left tells how one smirks to the right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from headcap.lips.features import ACROSS, BETWEEN, SAMPLES, FeatureSpace, LipFeatures
from headcap.lips.mouth import Mouth
from headcap.lips.regression import LipTake

_SYMMETRIC_M = 1e-4
"""How far a vertex may lie from where its partner is mirrored to."""
_FLIP = np.array([-1.0, 1.0, 1.0])
"""Of a place, at x = 0."""
_FLIPPED_PARAMETERS = np.array([1, -1, -1, 1, 1, 1, 1, -1, -1], np.float32)
"""M G M with M = diag(-1, 1, 1): turns about y and z change their sense, so do the shears yx and zx; see `PARAMETERS`."""


@dataclass(frozen=True, eq=False)
class MouthMirror:
    """What features and corrections of a mouth become when left and right change places; all of them linear maps."""

    triangles: NDArray[np.int64]
    """(T,) the layer's triangle across the midline from each of the layer's."""
    shape: NDArray[np.float64]
    """(k, k) psi in the mirror is psi times this."""
    distances: NDArray[np.int64]
    """(20,) the distance that stands in each one's place."""

    @classmethod
    def of(cls, vertices: NDArray, mouth: Mouth, space: FeatureSpace) -> MouthMirror | None:
        """Of a neutral head (n, 3), metres, its midline at x = 0; None where head or triangles are not symmetric."""
        away, partner = cKDTree(vertices).query(vertices * _FLIP)
        number = {tuple(sorted(corners)): row for row, corners in enumerate(mouth.triangles[mouth.layer].tolist())}
        across = [number.get(tuple(sorted(corners)), -1) for corners in partner[mouth.triangles[mouth.layer]].tolist()]
        place = np.full(len(vertices), -1)
        place[space.vertices] = np.arange(len(space.vertices))
        moved = place[partner[space.vertices]]
        symmetric = away[mouth.vertices].max() <= _SYMMETRIC_M and min(across) >= 0 and moved.min() >= 0
        if not symmetric or not np.isin(partner[mouth.outline], mouth.outline).all():
            return None
        basis = space.basis.astype(np.float64)
        turned = (basis[:, moved] * _FLIP).reshape(len(basis), -1) @ basis.reshape(len(basis), -1).T
        return cls(np.array(across), turned, _mirrored_distances())

    def __call__(self, take: LipTake) -> LipTake:
        """The take in a mirror, of the same name: what leaves one out leaves out both."""
        told = LipFeatures(take.features.shape @ self.shape, take.features.distances[:, self.distances])
        return LipTake(take.person, take.name, told, take.parameters[:, self.triangles] * _FLIPPED_PARAMETERS)


def _mirrored_distances() -> NDArray[np.int64]:
    """Sample k of the border, counted from the right corner over the upper lip, is mirrored to 10 - k."""
    rows = {tuple(pair): row for row, pair in enumerate(ACROSS.tolist())}
    across = [rows[tuple(sorted(_opposite(pair)))] for pair in ACROSS.tolist()]
    between = [BETWEEN.tolist().index(at) for at in _opposite(BETWEEN.tolist())]
    return np.array([*across, *(len(ACROSS) + row for row in between)])


def _opposite(samples: list[int]) -> list[int]:
    return [(SAMPLES // 2 - at) % SAMPLES for at in samples]
