"""The mouth of a head's topology: the mask of the correction layer, the patch it blends into, what holds still, the outline."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator
from scipy.sparse.csgraph import dijkstra

from headcap.errors import InputError
from headcap.meshes.topology import boundary_loops, submesh
from headcap.registration.graph import edge_graph

_LIPS = ("lips_upper", "lips_lower", "lips_inner_upper", "lips_inner_lower")
_POCKET_WEIGHT = 1e-2
"""Of triangles in the mouth, which nobody measures: they follow the lips and must not hold them."""
_ACROSS_M = 0.02
"""Height over which the collar's weight goes from the skull's to the jaw's."""
_STEADY_ABOVE_M, _STEADY_AWAY_M = 0.02, 0.05
"""What lies so high above the middle of the lips and so far from them is skin that neither mouth nor jaw moves much."""


class MouthSettings(BaseModel):
    """What is corrected; the paper shows its mask as a picture (figure 7)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    reach_mm: float = Field(30.0, gt=0, description="The layer's mask reaches so far from the lips, along the skin")
    fade_mm: float = Field(6.0, ge=0, description="Corrections fade to none over so much at the mask's rim")
    collar_mm: float = Field(25.0, gt=0, description="Skin about the mask that gives way so that the correction blends in")
    jaw_hold: float = Field(
        0.02,
        gt=0,
        le=1,
        description="Weight of the collar below the mouth beside that above it. The skull carries the upper part, which the base "
        "tracker places well; the jaw's place it gets wrong as it does the lips'. Of what a base that sees half of each motion "
        "misses, the true layer leaves 64 % with a weight of 1, 40 % with 0.1, 28 % with 0.01",
    )

    @model_validator(mode="after")
    def _fade_within(self) -> MouthSettings:
        if self.fade_mm >= self.reach_mm:
            raise ValueError(f"corrections fade over {self.fade_mm} mm of a mask that reaches {self.reach_mm} mm")
        return self


@dataclass(frozen=True, eq=False)
class Mouth:
    """Parts of a topology of n vertices and m triangles."""

    triangles: NDArray[np.int32]
    """(m, 3) of the whole head."""
    layer: NDArray[np.int64]
    """(T,) triangles of the correction layer: skin about the mouth with the lips, without the pocket behind them."""
    fade: NDArray[np.float64]
    """(T,) share of the correction that counts: one inside, zero at the rim."""
    patch: NDArray[np.int64]
    """(p,) triangles that give way: the layer, its collar and the pocket."""
    weights: NDArray[np.float64]
    """(p,) how much each triangle of the patch holds to its gradient, 1 in the layer."""
    steady: NDArray[np.int64]
    """(s,) vertices that tell the head's rigid motion."""
    outline: NDArray[np.int64]
    """(r,) ring of vertices on the lips' outer border, from the subject's right corner over the upper lip to the left corner and
    back over the lower one."""
    left: int
    """Place in `outline` of the left corner; the right one is the first."""

    @property
    def vertices(self) -> NDArray[np.int64]:
        """(k,) of the layer: where errors are measured."""
        return np.unique(self.triangles[self.layer]).astype(np.int64)


def find_mouth(
    vertices: NDArray, triangles: NDArray, regions: dict[str, NDArray], settings: MouthSettings | None = None
) -> Mouth:
    """The mouth of a neutral head (n, 3), metres, y up, z out of the face, with its regions (n,).

    Needs the regions lips_upper and lips_lower; lips_inner_*, mouth_interior and neck are used where they are named. Raises
    `InputError` for heads without lips or with too little skin about them.
    """
    settings = settings or MouthSettings()
    lips = _union(regions, _LIPS, len(vertices))
    if not lips.any():
        raise InputError(
            f"regions {', '.join(sorted(regions)) or 'none'}",
            expected="lips_upper and lips_lower among the regions of the head",
            remedy="Use a head model with lips, or name their vertices.",
        )
    away = dijkstra(edge_graph(vertices, triangles), indices=np.flatnonzero(lips), min_only=True)
    reach, collar, fade = (1e-3 * length for length in (settings.reach_mm, settings.collar_mm, settings.fade_mm))
    inside = _union(regions, ("mouth_interior",), len(vertices))
    in_pocket = inside[triangles].any(axis=1)
    layer = np.flatnonzero((away <= reach)[triangles].all(axis=1) & ~in_pocket)
    patch = np.flatnonzero((away <= reach + collar)[triangles].all(axis=1))
    along = np.clip((reach - away[triangles[layer]].mean(axis=1)) / max(fade, 1e-12), 0, 1)
    middle = vertices[lips].mean(axis=0)
    steady = (vertices[:, 1] > middle[1] + _STEADY_ABOVE_M) & (away > _STEADY_AWAY_M) & np.isfinite(away)
    # what a camera in front sees of a head; the rest a base tracker extrapolates
    steady &= regions["face"] if "face" in regions else ~_union(regions, ("neck", "mouth_interior"), len(vertices))
    steady &= ~_union(regions, ("eyes",), len(vertices))
    if steady.sum() < 30 or len(patch) in (0, len(triangles)):
        raise InputError(
            f"{steady.sum()} vertices that hold still and {len(patch)} triangles about the mouth",
            expected="a head with brow and nose above the mouth",
            remedy="Check the units (metres) and axes (y up, z out of the face), and that the mesh has a face about its mouth.",
        )
    outline, left = _outline(vertices, triangles, lips, inside)
    corners = vertices[outline[[0, left]]]
    return Mouth(
        np.ascontiguousarray(triangles, np.int32),
        layer,
        along * along * (3 - 2 * along),
        patch,
        _weights(vertices[triangles[patch]].mean(axis=1), np.isin(patch, layer), in_pocket[patch], corners, settings.jaw_hold),
        np.flatnonzero(steady),
        outline,
        left,
    )


def _weights(places: NDArray, in_layer: NDArray, in_pocket: NDArray, corners: NDArray, jaw_hold: float) -> NDArray[np.float64]:
    """(p,) of triangles at `places` (p, 3): the collar's go from 1 above the mouth's corners (2, 3) to `jaw_hold` below."""
    below = np.clip(0.5 - (places[:, 1] - corners[:, 1].mean()) / _ACROSS_M, 0, 1)
    return np.where(in_pocket, _POCKET_WEIGHT, np.where(in_layer, 1.0, jaw_hold**below))


def _union(regions: dict[str, NDArray], names: tuple[str, ...], n: int) -> NDArray[np.bool_]:
    return np.any([regions[name] for name in names if name in regions] or [np.zeros(n, bool)], axis=0)


def _outline(vertices: NDArray, triangles: NDArray, lips: NDArray, inside: NDArray) -> tuple[NDArray[np.int64], int]:
    """The lips' border to the skin, the longest of their borders that does not lead into the mouth."""
    compact, used = submesh(triangles, lips[triangles].all(axis=1))
    into_mouth = np.isin(np.arange(len(vertices)), triangles[inside[triangles].any(axis=1)])
    rings = [used[loop].astype(np.int64) for loop in boundary_loops(compact)]
    rings = [ring for ring in rings if not into_mouth[ring].any()] or rings
    ring = max(rings, key=lambda ring: np.linalg.norm(np.diff(vertices[ring], axis=0), axis=1).sum())
    ring = np.roll(ring, -int(vertices[ring, 0].argmin()))
    left = int(vertices[ring, 0].argmax())
    if vertices[ring[1:left], 1].mean() < vertices[ring[left + 1 :], 1].mean():
        ring, left = np.roll(ring[::-1], 1), len(ring) - left
    return ring, left
