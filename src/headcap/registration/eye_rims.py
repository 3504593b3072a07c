"""The eyes' openings: where a scan has holes between its lids, the template's lid rims are laid onto their rims."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from headcap.meshes.topology import boundary_loops, submesh
from headcap.registration.nonrigid import Lines
from headcap.registration.scan import Scan
from headcap.registration.template import Template

_LENGTHS = (0.6, 1.7)
"""A hole of an eye is so much longer or shorter than the template's rim: people and their lids differ, nostrils are smaller."""


@dataclass(frozen=True)
class _Outline:
    """A closed rim as its upper and its lower line, both from one corner of the eye to the other."""

    points: NDArray
    """(k, 3) in order around the eye."""
    corners: tuple[int, int]
    """Where in the order the corners are."""

    def arcs(self) -> tuple[NDArray, NDArray]:
        """Indices of either line, corners included."""
        first, second = self.corners
        ring = np.arange(len(self.points))
        one_way = np.roll(ring, -first)[: (second - first) % len(ring) + 1]
        other_way = np.roll(ring[::-1], first + 1 - len(ring))[: (first - second) % len(ring) + 1]
        return one_way, other_way


def eye_rims(base: Template) -> tuple[NDArray[np.int64], ...]:
    """Vertices (k,) of each lid rim in order around the eye: the loops about what `eyes` and `lid_rims` span; maybe none."""
    if not {"eyes", "lid_rims"} <= base.regions.keys():
        return ()
    spanned = (base.regions["eyes"] | base.regions["lid_rims"])[base.triangles].all(1)
    triangles, used = submesh(base.triangles, spanned)
    return tuple(used[loop] for loop in boundary_loops(triangles))


def eye_lines(rest: NDArray, vertices: NDArray, rims: tuple[NDArray, ...], scan: Scan) -> Lines:
    """Places on the scan's eye holes for the template's lid rims; empty for eyes that the scan shows closed by surface.

    `rest` and `vertices` (n, 3) are the template placed and as bent so far. A hole is taken for an eye's where it lies
    around the bent rim and is of its size. Corner goes to corner, and between them shares of length to shares of length.
    """
    holes = [scan.vertices[loop] for loop in boundary_loops(scan.triangles) if len(loop) > 8]
    found = Lines.none()
    for rim in rims:
        across = _corners(rest[rim], rest[rim] - rest[rim].mean(0))
        axis = vertices[rim[across[1]]] - vertices[rim[across[0]]]
        hole = _hole_of(vertices[rim], holes)
        if hole is None:
            continue
        ends = _corners(hole, axis[None])
        found = found.joined(Lines(rim, _laid_on(_Outline(rest[rim], across), _Outline(hole, ends))))
    return found


def _hole_of(rim: NDArray, holes: list[NDArray]) -> NDArray | None:
    """The hole nearest to a rim (k, 3), if their middles lie within half the rim's width and their lengths are alike."""
    width = np.linalg.norm(rim[:, None] - rim[None], axis=2).max()
    near = [
        (np.linalg.norm(hole.mean(0) - rim.mean(0)), k)
        for k, hole in enumerate(holes)
        if _LENGTHS[0] < _length(hole) / _length(rim) < _LENGTHS[1]
    ]
    if not near or min(near)[0] > 0.5 * width:
        return None
    return holes[min(near)[1]]


def _corners(ring: NDArray, directions: NDArray) -> tuple[int, int]:
    """Positions of the ring's (k, 3) two extremes along the main one of some directions (m, 3)."""
    axis = np.linalg.svd(directions, full_matrices=False)[2][0] if len(directions) > 1 else directions[0]
    along = (ring - ring.mean(0)) @ axis
    return int(along.argmin()), int(along.argmax())


def _laid_on(rim: _Outline, hole: _Outline) -> NDArray[np.float64]:
    """Places (k, 3) for the rim's points on the hole's outline; lines that run the same side of the eye go together."""
    mine, theirs = rim.arcs(), hole.arcs()
    # lids bulge forward both: what tells upper from lower is where they lie to each other
    across = [np.subtract(*(o.points[arc].mean(0) for arc in arcs)) for o, arcs in ((rim, mine), (hole, theirs))]
    if across[0] @ across[1] < 0:
        theirs = theirs[::-1]
    out = np.empty_like(rim.points)
    for arc, other in zip(mine, theirs, strict=True):
        share, along = _shares(rim.points[arc]), _shares(hole.points[other])
        out[arc] = np.stack([np.interp(share, along, hole.points[other, axis]) for axis in range(3)], axis=1)
    return out


def _shares(line: NDArray) -> NDArray:
    """Share (k,) of a line's length run at each of its points."""
    run = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    return run / run[-1]


def _length(ring: NDArray) -> float:
    return float(np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1).sum())
