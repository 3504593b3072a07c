"""Single meshes as OBJ and PLY, vertices in the file's order, and a folder of them as frames of one topology."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.expressions.mesh_frames import FrameCache, MeshFrames, refuse_other_count

MESH_SUFFIXES = (".obj", ".ply")


def natural_key(path: Path) -> tuple:
    """Sorts frame_9 before frame_10."""
    return tuple((int(part), "") if part.isdigit() else (-1, part.lower()) for part in re.split(r"(\d+)", path.name))


def read_mesh_files(files: list[Path], rate_hz: float, source: str) -> MeshFrames:
    """One mesh a file; the first one's topology is everyone's.

    Raises `InputError` naming the file and both counts where another topology comes up.
    """
    first, triangles = read_mesh(files[0])
    cache = FrameCache(len(files), len(first))
    topology = _face_lines(files[0])
    for frame, file in enumerate(files):
        same_text = topology is not None and _face_lines(file) == topology
        if same_text:
            vertices = _obj_vertices(file)
        else:
            vertices, others = read_mesh(file)
            refuse_other_count(file.name, len(others), files[0].name, len(triangles), "triangles")
        refuse_other_count(file.name, len(vertices), files[0].name, len(first), "vertices")
        if not same_text and not np.array_equal(others, triangles):
            raise InputError(
                f"{file.name} has other triangles than {files[0].name}",
                expected="one topology",
                remedy="Export all frames from one mesh, in one vertex order.",
            )
        cache.put(frame, vertices)
    times = np.arange(len(files)) / rate_hz
    return MeshFrames(cache.positions, times, source, triangles, labels=tuple(file.name for file in files))


def read_mesh(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Vertices (n, 3) of an OBJ or PLY in the file's order, nothing welded or split, and triangles (m, 3).

    Faces of more corners become fans, so files of one topology give equal triangles. Raises `InputError`.
    """
    try:
        vertices, triangles = _read_obj(path) if path.suffix.lower() == ".obj" else _read_ply(path)
    except Exception as error:
        raise InputError(f"{path} cannot be read ({error})", expected="an OBJ or PLY mesh", remedy="Export it again.") from error
    if len(vertices) == 0 or len(triangles) == 0 or triangles.min() < 0 or triangles.max() >= len(vertices):
        raise InputError(
            f"{path} has {len(vertices)} vertices and {len(triangles)} triangles that name them",
            expected="a triangle mesh",
            remedy="Export it again, with its faces.",
        )
    return vertices, triangles


def fans(counts: NDArray, corners: NDArray) -> NDArray[np.int32]:
    """Triangles (m, 3) of faces with so many corners each (f,), whose vertices (sum,) stand one after another."""
    counts, corners = np.asarray(counts, np.int64), np.asarray(corners, np.int64)
    first = np.repeat(np.cumsum(counts) - counts, counts - 2)
    second = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(counts - 2) - (counts - 2), counts - 2)
    return np.stack([corners[first], corners[second], corners[second + 1]], axis=1).astype(np.int32)


def _read_obj(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    vertices, counts, corners = _obj_vertices(path), [], []
    for line in _face_lines(path) or ():
        face = [int(corner.split(b"/", 1)[0]) for corner in line.split()[1:]]
        counts.append(len(face))
        corners += face
    numbers = np.array(corners, np.int64)
    # a negative number counts back from the last vertex so far: right for files that list all vertices before the faces
    return vertices, fans(np.array(counts), np.where(numbers < 0, len(vertices) + numbers, numbers - 1))


def _lines(path: Path, start: bytes) -> list[bytes]:
    return [line for line in path.read_bytes().splitlines() if line.startswith(start)]


def _face_lines(path: Path) -> list[bytes] | None:
    return _lines(path, b"f ") if path.suffix.lower() == ".obj" else None


def _obj_vertices(path: Path) -> NDArray[np.float64]:
    lines = _lines(path, b"v ")
    if not lines:
        return np.empty((0, 3))
    return np.loadtxt(lines, usecols=(1, 2, 3), ndmin=2)


def _read_ply(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    import trimesh

    mesh = trimesh.load(path, process=False, force="mesh", maintain_order=True)
    return np.array(mesh.vertices, float), np.array(mesh.faces, np.int32).reshape(-1, 3)
