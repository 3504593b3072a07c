"""A scan of the subject, checked and mended before anything is fitted to it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.meshes.files import read_coloured_mesh
from headcap.meshes.normals import triangle_normals, vertex_normals
from headcap.meshes.topology import boundary_mask, mesh_edges, non_manifold_edges, submesh, vertex_components

METRES_PER = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
HEAD_SIZE_M = (0.15, 0.6)
MOST_BROKEN_SHARE = 0.02
SMALLEST_PIECE_SHARE = 0.05


@dataclass(frozen=True)
class Scan:
    """A triangle mesh of a head in any placement, in metres."""

    vertices: NDArray[np.float64]
    """(n, 3) metres, in the scanner's own frame."""
    triangles: NDArray[np.int32]
    """(m, 3), counter-clockwise seen from outside."""
    colours: NDArray[np.uint8] | None = None
    """(n, 3) RGB."""
    notes: tuple[str, ...] = ()
    """What was mended, in words."""

    def normals(self) -> NDArray[np.float64]:
        """(n, 3) unit vertex normals."""
        return vertex_normals(self.vertices, self.triangles)

    def boundary(self) -> NDArray[np.bool_]:
        """(n,) true at the rims of holes."""
        return boundary_mask(self.triangles, len(self.vertices))


def load_scan(path: Path | str, unit: str) -> Scan:
    """Read a PLY, OBJ, STL, OFF or GLB scan whose numbers are in `unit` (m, cm, mm, in) and check it.

    Raises `InputError` where the file is no mesh, broken beyond mending, or its size in this unit is no head's.
    """
    path = Path(path)
    if unit not in METRES_PER:
        raise InputError(
            f"scan unit {unit!r}", expected=f"one of {', '.join(METRES_PER)}", remedy="Set scan.unit in the session file."
        )
    if not path.exists():
        raise InputError(f"no scan at {path}", expected="a mesh file", remedy="Set scan.file in the session file.")
    vertices, triangles, colours = read_coloured_mesh(path, remedy="Export the scan again.")
    return check_scan(vertices * METRES_PER[unit], triangles, colours, unit=unit)


def check_scan(vertices: NDArray, triangles: NDArray, colours: NDArray | None = None, *, unit: str = "m") -> Scan:
    """Mend and check a mesh given in metres; `unit` is what the file claimed, for the message.

    Dropped and noted: vertices that are not finite, triangles without area, triangles at edges shared by more than two,
    loose pieces; welded: soups of separate triangles; turned: inside-out scans. Raises `InputError` past 2 % of triangles,
    for an empty mesh, and for a size no head has.
    """
    if len(triangles) == 0 or len(vertices) == 0:
        raise InputError(
            f"the scan has {len(vertices)} points and no triangles",
            expected="a triangle mesh",
            remedy="Mesh the scan before export.",
        )
    notes: list[str] = []
    vertices, triangles, colours = _welded(vertices, triangles, colours, notes)
    triangles = _finite(vertices, triangles, notes)
    check_size(vertices[np.unique(triangles)], unit)
    triangles = _manifold(vertices, triangles, notes)
    triangles = _largest_pieces(vertices, triangles, notes)
    triangles = _outside_out(vertices, triangles, notes)
    triangles, used = submesh(triangles, np.ones(len(triangles), bool))
    return Scan(vertices[used], triangles, None if colours is None else colours[used], tuple(notes))


def check_size(vertices: NDArray, unit: str) -> None:
    """Refuse a scan (n, 3) whose size in metres is no head's, naming the unit that would fit."""
    extent = float(np.ptp(vertices, axis=0).max())
    low, high = HEAD_SIZE_M
    if low <= extent <= high:
        return
    fits = [name for name, metres in METRES_PER.items() if low <= extent / METRES_PER[unit] * metres <= high]
    remedy = f"Its numbers would be a head's in {' or '.join(fits)}: set scan.unit." if fits else "Crop the scan to the head."
    raise InputError(
        f"the scan is {extent:.4g} m across when read in {unit}",
        expected=f"a head and shoulders, {low} to {high} m",
        remedy=remedy,
    )


def _welded(vertices: NDArray, triangles: NDArray, colours: NDArray | None, notes: list[str]) -> tuple:
    """Vertices at one place joined, where the mesh is a soup; scans with closed lips must not be glued otherwise."""
    if mesh_edges(triangles).boundary.mean() < 0.3:
        return vertices, triangles, colours
    joined, first, back = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
    notes.append(f"{len(vertices) - len(joined)} doubled vertices welded")
    return joined, back.ravel()[triangles].astype(np.int32), None if colours is None else colours[first]


def _finite(vertices: NDArray, triangles: NDArray, notes: list[str]) -> NDArray:
    bad = ~np.isfinite(vertices).all(1)
    hit = bad[triangles].any(1)
    _refuse_if_many(hit, "touch a vertex that is not a number")
    if hit.any():
        notes.append(f"{int(bad.sum())} vertices that are not numbers dropped, with {int(hit.sum())} triangles")
    return triangles[~hit]


def _manifold(vertices: NDArray, triangles: NDArray, notes: list[str]) -> NDArray:
    flat = np.linalg.norm(triangle_normals(vertices, triangles), axis=1) <= 1e-16
    if flat.any():
        notes.append(f"{int(flat.sum())} triangles without area dropped")
        triangles = triangles[~flat]
    for _ in range(3):
        bad = non_manifold_edges(triangles)
        if len(bad) == 0:
            break
        n = len(vertices)
        keys = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2)
        hit = np.isin(keys[..., 0].astype(np.int64) * n + keys[..., 1], bad[:, 0].astype(np.int64) * n + bad[:, 1]).any(1)
        _refuse_if_many(hit, f"meet at {len(bad)} non-manifold edges")
        notes.append(f"{int(hit.sum())} triangles at {len(bad)} non-manifold edges dropped")
        triangles = triangles[~hit]
    return triangles


def _refuse_if_many(hit: NDArray, what: str) -> None:
    if hit.mean() > MOST_BROKEN_SHARE:
        raise InputError(
            f"{hit.mean():.0%} of the scan's triangles {what}",
            expected=f"at most {MOST_BROKEN_SHARE:.0%}",
            remedy="Repair the scan (for example with a mesh tool's 'remesh') and export it again.",
        )


def _largest_pieces(vertices: NDArray, triangles: NDArray, notes: list[str]) -> NDArray:
    labels = vertex_components(triangles, len(vertices))[triangles[:, 0]]
    area = np.bincount(labels, np.linalg.norm(triangle_normals(vertices, triangles), axis=1))
    keep = area >= SMALLEST_PIECE_SHARE * area.max()
    dropped = int((~keep & (area > 0)).sum())
    if dropped:
        notes.append(f"{dropped} loose pieces dropped")
    return triangles[keep[labels]]


def _outside_out(vertices: NDArray, triangles: NDArray, notes: list[str]) -> NDArray:
    """A head bulges: seen from its middle most of the surface faces away."""
    centre = vertices[np.unique(triangles)].mean(0)
    outward = np.einsum("nk,nk->", triangle_normals(vertices, triangles), vertices[triangles].mean(1) - centre)
    if outward >= 0:
        return triangles
    notes.append("inside out: all triangles turned")
    return np.ascontiguousarray(triangles[:, ::-1])
