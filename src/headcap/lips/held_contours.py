"""Contours as constraints of a correction (the lip paper's future work, section 8): where a picture shows lips' border and rims.

The border's samples are drawn to the outer contour, the rims of the mouth's opening to the inner one. Which of a contour's points
a sample belongs to is told by the border's normal, as for features, but for the corners of the mouth: any contour names them as
points of their own, and normals there run across the mouth, so that corners which a smile raises would stay below.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.lips.correction import CanonicalMeshes, CorrectionLayer, HeldPlaces
from headcap.lips.features import SAMPLES, FeatureSpace, LipContours, cast_back, contour_points
from headcap.lips.mesh_contours import MeshContours, Opening

_EVERY = 2
"""Every so manieth station across the opening is held, about as many as the border has samples."""
REST_SHARE = 0.35
"""Of what contours and corrected border are apart while a person is at rest, so much is left as it is: it says who somebody is
and where their contours are seen, which either side may have wrong, not what they do. On six people, one left out in turn, shares
of 0, 0.35, 0.5, 0.65 and 1 take 24.7, 25.5, 25.4, 25.0 and 23.2 % off the base tracker's error; the gap does not see it."""
_SHUT_PX = 1e-3
"""Between rims that are one line: a finder's are equal there, in single precision apart by rounding."""


@dataclass(frozen=True, eq=False)
class HeldContours:
    """What a clip's contours hold of its meshes."""

    space: FeatureSpace
    see: MeshContours
    camera: Camera
    contours: Sequence[LipContours | None]
    """One per frame; None where none were found."""
    weight: float = 1.0
    """Of a squared distance, see `HeldPlaces`."""
    quiet: NDArray[np.bool_] | None = None
    """(f,) frames in which the person is at rest; None where nobody knows: then contours are taken as they are."""

    def drawn(self, layer: CorrectionLayer, found: NDArray, world_from_canonical: NDArray) -> NDArray[np.float64]:
        """Canonical meshes (f, n, 3) of `CorrectionLayer.corrected` drawn to their contours; the rest stay as they are.

        The border first, then border and rims: which of a lip's edges is its rim shows once the lip is where it belongs.
        """
        out, offset = found, REST_SHARE * self.resting_offset(CanonicalMeshes(found, world_from_canonical))
        for rims in (False, True):
            out = layer.drawn(found, self.places(CanonicalMeshes(out, world_from_canonical), rims=rims, offset=offset))
        return out

    def resting_offset(self, meshes: CanonicalMeshes) -> NDArray[np.float64]:
        """(20, 2) metres from the border's samples of canonical meshes (f, n, 3) to their contours, median over `quiet` frames.

        Zero where no such frame has contours.
        """
        if self.quiet is None:
            return np.zeros((SAMPLES, 2))
        samples, held = self.space.samples(meshes.meshes)[..., :2], self.places(meshes, rims=False)
        apart = [held[frame].targets - samples[frame] for frame in np.flatnonzero(self.quiet) if held[frame] is not None]
        return np.median(apart, axis=0) if apart else np.zeros((SAMPLES, 2))

    def places(self, meshes: CanonicalMeshes, *, rims: bool = True, offset: NDArray | None = None) -> list[HeldPlaces | None]:
        """Per frame what is held of canonical meshes (f, n, 3): the border, and the opening's rims as well with `rims`.

        Meshes are best those that are corrected already: pixels are cast back to their depth, and what lies wrongly along a
        contour is left alone. An `offset` (20, 2) is taken off the border's targets, its mean off the rims', so that the opening
        is held as wide as it is seen. None for frames that were not tracked or have no contours.
        """
        offset = np.zeros((SAMPLES, 2)) if offset is None else offset
        out: list[HeldPlaces | None] = [None] * len(self.contours)
        for frame, (mesh, contours) in enumerate(zip(meshes.meshes, self.contours, strict=True)):
            if contours is None or not np.isfinite(mesh).all():
                continue
            alone = CanonicalMeshes(mesh[None], meshes.world_from_canonical[frame : frame + 1])
            out[frame] = self._border(alone, contours, offset)
            if rims:
                out[frame] = out[frame].joined(self._rims(alone, contours, offset.mean(axis=0)))
        return out

    def _border(self, mesh: CanonicalMeshes, contours: LipContours, offset: NDArray) -> HeldPlaces:
        samples = self.space.samples(mesh.meshes)
        pixels = border_points(self.camera.project(mesh.world(samples)[0])[0], contours)
        targets = cast_back(pixels[None], samples[..., 2], self.camera, mesh.world_from_canonical)[0]
        return HeldPlaces(self.space.border, self.space.share, targets - offset, np.full(SAMPLES, self.weight))

    def _rims(self, mesh: CanonicalMeshes, contours: LipContours, offset: NDArray) -> HeldPlaces:
        """Rims are held up and down alone: along them nothing is seen."""
        opening = self.see.opening(*self.camera.project(mesh.world(mesh.meshes)[0]))
        edges, share, pixels = rim_points(opening, contours.inner)
        start, end = mesh.meshes[0, edges[:, 0], 2], mesh.meshes[0, edges[:, 1], 2]
        depth = start + share * (end - start)
        targets = cast_back(pixels[None], depth[None], self.camera, mesh.world_from_canonical)[0] - offset
        targets[:, 0] = np.nan
        return HeldPlaces(edges, share, targets, np.full(len(share), self.weight))


def border_points(samples: NDArray, contours: LipContours) -> NDArray[np.float64]:
    """Points (20, 2) of the outer contour that belong to samples (20, 2) of a border, pixels: as `contour_points`, but for the
    mouth's corners, which are the contour's first point and the one farthest from it."""
    found, ring = contour_points(samples, contours)[0], contours.outer
    ends = ring[[0, int(np.linalg.norm(ring - ring[0], axis=1).argmax())]]
    corners = samples[[0, SAMPLES // 2]]
    if np.linalg.norm(ends[::-1] - corners) < np.linalg.norm(ends - corners):
        # drawn from the left corner on
        ends = ends[::-1]
    found[[0, SAMPLES // 2]] = ends
    return found


def rim_points(opening: Opening, inner: NDArray) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Edges (r, 2), shares (r,) and pixels (r, 2) where an inner contour (j, 2) has the rims of a mesh's opening.

    At stations across the mesh's mouth that the contour spans. Where the contour is one line, lips are shut and the one behind
    shows nothing: it is held only if it stands out beyond the line.
    """
    upper, lower = ring_heights(opening, inner)
    chosen = np.zeros(len(upper), bool)
    chosen[_EVERY // 2 :: _EVERY] = True
    known = chosen & np.isfinite([upper, lower, opening.upper.height, opening.lower.height]).all(axis=0)
    shut, front = lower - upper <= _SHUT_PX, opening.upper_in_front
    edges, share, height, stations = [], [], [], []
    for rim, wanted, in_front, beyond in (
        (opening.upper, upper, front, opening.upper.height < upper),
        (opening.lower, lower, ~front, opening.lower.height > lower),
    ):
        held = known & (~shut | in_front | beyond)
        edges.append(rim.edges[held])
        share.append(rim.share[held])
        height.append(wanted[held])
        stations.append(opening.stations[held])
    along, down = (np.concatenate(parts)[:, None] for parts in (stations, height))
    return np.concatenate(edges), np.concatenate(share), opening.right + along * opening.along + down * opening.down


def ring_heights(opening: Opening, ring: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(s,), (s,) the highest and the lowest crossing of a ring (j, 2) with an opening's stations, pixels down from the line
    between its corners; NaN where the ring does not reach."""
    flat = np.stack([(ring - opening.right) @ opening.along, (ring - opening.right) @ opening.down], axis=1)
    ahead = np.roll(flat, -1, axis=0)
    run = ahead[:, 0] - flat[:, 0]
    share = (opening.stations[:, None] - flat[:, 0]) / np.where(run == 0, np.inf, run)
    height = flat[:, 1] + share * (ahead[:, 1] - flat[:, 1])
    crosses = (share >= 0) & (share <= 1) & (run != 0)
    reached = crosses.any(axis=1)
    upper, lower = np.where(crosses, height, np.inf).min(axis=1), np.where(crosses, height, -np.inf).max(axis=1)
    return np.where(reached, upper, np.nan), np.where(reached, lower, np.nan)
