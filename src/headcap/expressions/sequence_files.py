"""Mesh sequences of other programs as one array of frames: npy, point caches, folders of OBJ or PLY, USD.

Formats that hold an array are memory-mapped. Text and USD are decoded once into an unnamed temporary file, so that a long take
neither fills the memory nor is parsed again at each pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from headcap.artifacts import ArtifactError
from headcap.errors import InputError
from headcap.expressions.mesh_files import MESH_SUFFIXES, natural_key, read_mesh_files
from headcap.expressions.mesh_frames import MeshFrames, refuse_other_count
from headcap.expressions.usd_frames import read_usd_frames
from headcap.meshes.topology import same_triangles
from headcap.registration.point_cache import read_pc2
from headcap.registration.sequence import JoinedMeshes, MeshSequence

USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
_KNOWN = "a mesh_sequence .json, an .npy (frames, vertices, 3), a .pc2, a USD file or a folder of .obj or .ply files"


def read_mesh_frames(source: Path | Sequence[Path], rate_hz: float, prim: str | None = None) -> MeshFrames:
    """Frames of a file or folder, or of several one after another; files of one mesh each make one sequence.

    `rate_hz` times the formats that hold no times. Raises `InputError` for unknown, broken or empty sources and where topologies
    differ, naming the file and both counts.
    """
    paths = [Path(source)] if isinstance(source, str | Path) else [Path(path) for path in source]
    if not paths:
        raise InputError("no file of a performance", expected=_KNOWN, remedy="Name a file or folder.")
    for path in paths:
        if not path.exists():
            raise InputError(f"no performance at {path}", expected=_KNOWN, remedy="Check the path.")
    if all(path.suffix.lower() in MESH_SUFFIXES for path in paths):
        return read_mesh_files(paths, rate_hz, paths[0].parent.name)
    parts = [_one(path, rate_hz, prim) for path in paths]
    return parts[0] if len(parts) == 1 else _joined(parts)


def _one(path: Path, rate_hz: float, prim: str | None) -> MeshFrames:
    suffix = path.suffix.lower()
    if path.is_dir():
        files = sorted((f for f in path.iterdir() if f.suffix.lower() in MESH_SUFFIXES), key=natural_key)
        kinds = {file.suffix.lower() for file in files}
        if len(kinds) != 1:
            raise InputError(
                f"{path} holds {'OBJ and PLY files both' if kinds else 'neither OBJ nor PLY files'}",
                expected="one mesh file per frame, all of one kind",
                remedy="Name the folder that holds the frames and nothing else.",
            )
        return read_mesh_files(files, rate_hz, path.name)
    try:
        if suffix == ".json":
            return _own(path)
        if suffix == ".npy":
            return _array(path, rate_hz)
        if suffix == ".pc2":
            cache = read_pc2(path)
            times = (cache.first_frame + cache.frames_per_sample * np.arange(len(cache.positions))) / rate_hz
            return MeshFrames(cache.positions, times, path.name)
    except (ArtifactError, ValueError, OSError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path} cannot be read ({error})", expected=_KNOWN, remedy="Export it again.") from error
    if suffix in USD_SUFFIXES:
        return read_usd_frames(path, prim)
    raise InputError(
        f"{path.name} is of a kind that is not known", expected=_KNOWN, remedy="Export the performance as one of them."
    )


def _own(path: Path) -> MeshFrames:
    sequence = MeshSequence.load(path)
    parts = [np.load(chunk, mmap_mode="r") for chunk in sequence.chunks]
    return MeshFrames(JoinedMeshes(parts, parts[0].shape[1]), sequence.time_s, f"{path.parent.name}/{path.name}", in_metres=True)


def _array(path: Path, rate_hz: float) -> MeshFrames:
    positions = np.load(path, mmap_mode="r", allow_pickle=False)
    if positions.ndim != 3 or positions.shape[2] != 3 or 0 in positions.shape or positions.dtype.kind != "f":
        raise InputError(
            f"{path.name} holds {positions.dtype} of shape {positions.shape}",
            expected="floating-point positions (frames, vertices, 3)",
            remedy="Save the performance as one array of positions.",
        )
    return MeshFrames(positions, np.arange(len(positions)) / rate_hz, path.name)


def _joined(parts: list[MeshFrames]) -> MeshFrames:
    """Parts one after another; each begins one frame after the last one's end."""
    first = parts[0]
    for part in parts[1:]:
        refuse_other_count(part.source, part.positions.shape[1], first.source, first.positions.shape[1], "vertices")
        if part.in_metres != first.in_metres:
            raise InputError(
                f"{part.source} and {first.source} say their units in different ways",
                expected="files of one kind",
                remedy="Read them one by one, each with its unit.",
            )
    topologies = [part.triangles for part in parts if part.triangles is not None]
    if any(not same_triangles(topologies[0], other) for other in topologies[1:]):
        raise InputError(
            "the files' triangles differ", expected="one topology", remedy="Export all takes from one mesh, in one vertex order."
        )
    times, start = [], 0.0
    for part in parts:
        step = float(np.median(np.diff(part.time_s))) if len(part) > 1 else 0.0
        times.append(start + part.time_s - part.time_s[0])
        start = times[-1][-1] + step
    return MeshFrames(
        JoinedMeshes([part.positions for part in parts], first.positions.shape[1]),
        np.concatenate(times),
        ", ".join(part.source for part in parts),
        topologies[0] if topologies else None,
        first.in_metres,
        tuple(label for part in parts for label in part.labels or [""] * len(part)) if any(p.labels for p in parts) else (),
    )
