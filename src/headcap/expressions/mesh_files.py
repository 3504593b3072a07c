"""A folder of OBJ or PLY files as frames of one topology."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.expressions.mesh_frames import FrameCache, MeshFrames, refuse_other_count
from headcap.meshes.files import read_mesh
from headcap.meshes.topology import same_triangles

MESH_SUFFIXES = (".obj", ".ply")


def natural_key(path: Path) -> tuple:
    """Sorts frame_9 before frame_10."""
    return tuple((int(part), "") if part.isdigit() else (-1, part.lower()) for part in re.split(r"(\d+)", path.name))


def read_mesh_files(files: list[Path], rate_hz: float, source: str) -> MeshFrames:
    """One mesh a file; the first one's topology is everyone's.

    Raises `InputError` naming the file and both counts where another topology comes up.
    """
    first, triangles = read_surface(files[0])
    cache = FrameCache(len(files), len(first))
    cache.put(0, first)
    faces = _obj_lines(files[0])[b"f "]
    for frame, file in enumerate(files[1:], 1):
        vertices = _vertices_alone(file, faces, len(first))
        if vertices is None:
            vertices, others = read_surface(file)
            refuse_other_count(file.name, len(others), files[0].name, len(triangles), "triangles")
            refuse_other_count(file.name, len(vertices), files[0].name, len(first), "vertices")
            if not same_triangles(others, triangles):
                raise InputError(
                    f"{file.name} has other triangles than {files[0].name}",
                    expected="one topology",
                    remedy="Export all frames from one mesh, in one vertex order.",
                )
        cache.put(frame, vertices)
    times = np.arange(len(files)) / rate_hz
    return MeshFrames(cache.positions, times, source, triangles, labels=tuple(file.name for file in files))


def read_surface(path: Path) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """`meshes.files.read_mesh`, and `InputError` for points without triangles too."""
    vertices, triangles = read_mesh(path, expected="an OBJ or PLY mesh")
    if len(vertices) == 0 or len(triangles) == 0:
        raise InputError(
            f"{path} has {len(vertices)} vertices and {len(triangles)} triangles",
            expected="a triangle mesh",
            remedy="Export it again, with its faces.",
        )
    return vertices, triangles


def _vertices_alone(path: Path, faces: list[bytes], count: int) -> NDArray[np.float64] | None:
    """Vertices of an OBJ whose face lines are the first file's, to the letter: a tenth of the time of a whole one."""
    lines = _obj_lines(path)
    if not faces or lines[b"f "] != faces or len(lines[b"v "]) != count:
        return None
    return np.loadtxt(lines[b"v "], usecols=(1, 2, 3), ndmin=2)


def _obj_lines(path: Path) -> dict[bytes, list[bytes]]:
    """Vertex and face lines of an OBJ, those that begin with their letter; none of a PLY."""
    lines = path.read_bytes().splitlines() if path.suffix.lower() == ".obj" else []
    return {start: [line for line in lines if line.startswith(start)] for start in (b"v ", b"f ")}
