"""Markers that swap labels: at one frame each stands where the other one stood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from headcap.errors import InputError
from headcap.expressions.markers.take import MarkerTake

_JUMP, _CROSSED = 0.5, 0.25
"""A marker is suspected where it jumps by so much of the way to its nearest neighbour, and two have swapped where the squared
steps of the crossed assignment are so small a share of the straight one's, each foretold at rest or at the speed before as fits
better. Lip markers 5 mm apart that a plosive parts at 0.2 m/s are the hard case: at 60 frames per second they step by 3.5 mm, a
share of 0.29 at rest."""


@dataclass(frozen=True)
class Swap:
    """Two markers whose labels change places from the frame before to this one."""

    first: str
    second: str
    frame: int


def refuse_swaps(take: MarkerTake) -> None:
    """Raise `InputError` naming pairs and frames where labels swap."""
    swaps = find_swaps(take)
    if swaps:
        told = "; ".join(f"{swap.first} and {swap.second} at frame {swap.frame}" for swap in swaps[:6])
        more = f" and {len(swaps) - 6} times more" if len(swaps) > 6 else ""
        raise InputError(
            f"{take.source}: markers swap labels: {told}{more}",
            expected="one marker under each label all through",
            remedy="Label them anew from that frame on, or leave both out by name.",
        )


def find_swaps(take: MarkerTake) -> list[Swap]:
    """Swaps between each marker's last sighting and the next one, gaps skipped, the common motion (median step) taken out.

    Two that trade labels are found, and one that takes the label's place of another that is not seen then.
    """
    positions = _without_common_motion(take)
    last, speed = positions[0].copy(), np.zeros(positions.shape[1:])
    swaps = []
    for frame in range(1, len(positions)):
        now = positions[frame]
        suspects = np.flatnonzero(np.linalg.norm(now - last, axis=1) > _JUMP * _spacing(last))
        if len(suspects):
            swaps += [Swap(take.names[i], take.names[j], frame) for i, j in _exchanged(now, last, speed, suspects)]
        known = np.isfinite(now[:, 0])
        speed = np.nan_to_num(now - positions[frame - 1])
        last[known] = now[known]
    return swaps


def _without_common_motion(take: MarkerTake) -> NDArray[np.float64]:
    steps = np.diff(take.positions_m, axis=0)
    common = np.zeros((len(take.time_s), 3))
    shared = np.isfinite(steps).all(axis=2).any(axis=1)
    common[1:][shared] = np.nanmedian(steps[shared], axis=1)
    return take.positions_m - np.cumsum(common, axis=0)[:, None]


def _spacing(places: NDArray) -> NDArray[np.float64]:
    """(k,) distance from each marker (k, 3) to the nearest other one that is known."""
    apart = cdist(places, places)
    np.fill_diagonal(apart, np.inf)
    return np.where(np.isfinite(apart), apart, np.inf).min(axis=1)


def _exchanged(now: NDArray, last: NDArray, speed: NDArray, suspects: NDArray) -> list[tuple[int, int]]:
    """Pairs among suspects (s,) that stand where the other was to come; and suspects on the place of one that is not seen."""
    unseen = np.flatnonzero(~np.isfinite(now[:, 0]) & np.isfinite(last[:, 0]))

    def step(marker: int, other: int) -> float:
        """Squared distance from where the one is to where the other was to come."""
        away = now[marker] - np.stack([last[other], last[other] + speed[other]])
        return float((away**2).sum(axis=1).min())

    pairs = []
    for place, i in enumerate(suspects.tolist()):
        for j in suspects[place + 1 :].tolist():
            if step(i, j) + step(j, i) < _CROSSED * (step(i, i) + step(j, j)):
                pairs.append((i, j))
        pairs += [(i, j) for j in unseen.tolist() if step(i, j) < 0.5 * _CROSSED * step(i, i)]
    return pairs
