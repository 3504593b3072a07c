"""Triangle meshes out of files, vertices numbered as the file numbers them."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.meshes.topology import polygon_fans

if TYPE_CHECKING:
    import trimesh

_OBJ_LINE = re.compile(rb"^[ \t]*([vf])[ \t]+([^#\r\n]*)", re.MULTILINE)
_OBJ_CONTINUED = re.compile(rb"\\\r?\n")
_OBJ_OTHER_INDICES = re.compile(rb"/\S*")


def read_mesh(
    path: Path | str, *, expected: str = "a whole PLY, OBJ, STL, OFF or GLB mesh", remedy: str = "Export it again."
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices (n, 3) in the file's order and unit, none merged, split or dropped, and triangles (m, 3).

    Polygons are cut into fans from their first corner. A vertex of a textured OBJ or PLY stays one vertex, whatever number of
    texture coordinates it has. Raises `InputError` with `expected` and `remedy` where the file is no mesh.
    """
    path = Path(path)
    try:
        return _read_obj(path.read_bytes()) if _is_obj(path) else _arrays(_load(path))
    except Exception as error:  # trimesh raises whatever its readers come upon
        raise InputError(f"{path} cannot be read ({error})", expected=expected, remedy=remedy) from error


def read_coloured_mesh(
    path: Path | str, *, expected: str = "a whole PLY, OBJ, STL, OFF or GLB mesh", remedy: str = "Export it again."
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.uint8] | None]:
    """As `read_mesh`, and the vertices' RGB (n, 3), out of the texture where there is one; None where the file has no colours."""
    path = Path(path)
    try:
        if _is_obj(path):
            vertices, triangles = _read_obj(path.read_bytes())
            return vertices, triangles, _obj_colours(path, vertices)
        mesh = _load(path)
        return *_arrays(mesh), _vertex_colours(mesh)
    except Exception as error:
        raise InputError(f"{path} cannot be read ({error})", expected=expected, remedy=remedy) from error


def _is_obj(path: Path) -> bool:
    return path.suffix.lower() == ".obj"


def _load(path: Path) -> trimesh.Trimesh:
    """What trimesh reads; of an OBJ it splits vertices at texture seams and orders faces by material, hence `_read_obj`."""
    import trimesh

    options = {"fix_texture": False} if path.suffix.lower() == ".ply" else {}
    return trimesh.load(path, process=False, force="mesh", **options)


def read_vertex_numbers(path: Path | str, vertices: int, *, of: str = "landmark") -> dict[str, int]:
    """Vertex numbers by name, JSON, of a mesh of so many `vertices`; raises `InputError` for other content and numbers beyond."""
    path = Path(path)
    try:
        found = {str(name): int(vertex) for name, vertex in json.loads(path.read_text(encoding="utf-8")).items()}
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise InputError(
            f"{path.name}: {error}", expected=f"vertex numbers by {of} name, JSON", remedy='Write {"name": vertex, ...}.'
        ) from error
    beyond = sorted(name for name, vertex in found.items() if not 0 <= vertex < vertices)
    if beyond:
        raise InputError(
            f"{path.name}: {beyond[0]} is vertex {found[beyond[0]]}",
            expected=f"0 to {vertices - 1}",
            remedy="Count vertices from zero, as the mesh has them.",
        )
    return found


def _arrays(mesh: trimesh.Trimesh) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    return np.array(mesh.vertices, float), np.array(mesh.faces, np.int32).reshape(-1, 3)


def _read_obj(content: bytes) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices and triangles of Wavefront OBJ text, in the order of its `v` and `f` lines; groups and materials count nothing."""
    found = _OBJ_LINE.findall(_OBJ_CONTINUED.sub(b" ", content))
    points = [values for kind, values in found if kind == b"v"]
    if not points:
        raise ValueError("no vertices")
    vertices = np.loadtxt(points, dtype=float, usecols=(0, 1, 2), comments=None, ndmin=2)
    polygons = [_OBJ_OTHER_INDICES.sub(b"", values).split() for kind, values in found if kind == b"f"]
    corners = np.array([len(polygon) for polygon in polygons], np.int64)
    if (corners < 3).any():
        raise ValueError(f"a face of {corners.min()} corners")
    indices = np.array([index for polygon in polygons for index in polygon], dtype="S").astype(np.int64)
    # negative indices count back from the last vertex above their line
    known = np.cumsum([kind == b"v" for kind, _ in found])[[kind == b"f" for kind, _ in found]]
    indices = np.where(indices < 0, indices + np.repeat(known, corners), indices - 1)
    if len(indices) and not (indices.min() >= 0 and indices.max() < len(vertices)):
        raise ValueError(f"faces name vertices beyond its {len(vertices)}")
    return vertices, polygon_fans(indices, corners)


def _vertex_colours(mesh: trimesh.Trimesh) -> NDArray[np.uint8] | None:
    visual = mesh.visual
    if visual is None or not visual.defined:
        return None
    if visual.kind == "texture":
        visual = visual.to_color()
    colours = np.asarray(visual.vertex_colors)
    return np.ascontiguousarray(colours[:, :3], np.uint8) if len(colours) == len(mesh.vertices) else None


def _obj_colours(path: Path, vertices: NDArray) -> NDArray[np.uint8] | None:
    """Colours (n, 3) of an OBJ's vertices (n, 3) from trimesh's copies of them; a vertex of a seam takes one of its copies'."""
    from scipy.spatial import cKDTree

    try:
        mesh = _load(path)
        colours = _vertex_colours(mesh)
    except Exception:  # what was read of the shape is whole: comments behind numbers are enough for trimesh to give up
        return None
    if colours is None:
        return None
    finite = np.isfinite(mesh.vertices).all(axis=1)
    _, nearest = cKDTree(mesh.vertices[finite]).query(np.nan_to_num(vertices))
    return colours[finite][nearest]
