"""The neutral face v^0 of a mesh sequence: read, and checked against the topology of the sequence and the size of a head."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import ArtifactError
from headcap.errors import InputError
from headcap.expressions.mesh_files import MESH_SUFFIXES, read_surface
from headcap.expressions.mesh_frames import MeshFrames
from headcap.meshes.topology import same_triangles
from headcap.registration.template import Template

Unit = Literal["m", "cm", "mm"]
METRES_PER: dict[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001}
HEAD_SIZE_M = (0.08, 1.0)
"""Largest extent of a mesh that may be a face alone or a head with its shoulders."""


@dataclass(frozen=True, eq=False)
class NeutralFace:
    """v^0 and what is known of its topology."""

    vertices: NDArray[np.float64]
    """(n, 3) metres."""
    triangles: NDArray[np.int32]
    """(m, 3)"""
    regions: dict[str, NDArray[np.bool_]]
    source: str


def metres_per(unit: str) -> float:
    """Metres of a unit's name; raises `InputError` for others than m, cm and mm."""
    if unit not in METRES_PER:
        raise InputError(f"unit {unit!r}", expected=f"one of {', '.join(METRES_PER)}", remedy="Name the unit of the files.")
    return METRES_PER[unit]


def check_size(vertices: NDArray, what: str, unit: str | None) -> None:
    """Refuse a mesh (n, 3) whose size in metres is no head's, naming the unit that would fit."""
    finite = vertices[np.isfinite(vertices).all(axis=1)]
    extent = float(np.ptp(finite, axis=0).max()) if len(finite) else 0.0
    low, high = HEAD_SIZE_M
    if low <= extent <= high or not len(finite):
        return
    fits = [] if unit is None else [u for u, m in METRES_PER.items() if low <= extent / METRES_PER[unit] * m <= high]
    raise InputError(
        f"{what} is {extent:.4g} m across" + (f" when read in {unit}" if unit else ""),
        expected=f"a face or head, {low} to {high} m",
        remedy=f"Its numbers would be a head's in {' or '.join(fits)}: name that unit."
        if fits
        else "Export the head alone, in metres.",
    )


def neutral_face(
    frames: MeshFrames, scale: float, neutral: Path | NDArray | Template | None, triangles: NDArray | None, unit: str
) -> NeutralFace:
    """v^0 of frames in `scale` metres; arguments as of `performance_files.read_performance`. Raises `InputError`."""
    face = _read_neutral(frames, scale, neutral, unit)
    known = [np.asarray(t, np.int32).reshape(-1, 3) for t in (triangles, face.triangles, frames.triangles) if t is not None]
    if not known:
        raise InputError(
            f"{frames.source} holds positions and no triangles",
            expected="a neutral face with its topology",
            remedy="Give the neutral as a template or an OBJ or PLY mesh of the same vertices.",
        )
    count = frames.positions.shape[1]
    if face.vertices.shape != (count, 3):
        raise InputError(
            f"the neutral ({face.source}) has {len(face.vertices)} vertices",
            expected=f"the {count} of {frames.source}",
            remedy="Give the neutral in the performance's own topology and vertex order.",
        )
    if frames.triangles is not None and not same_triangles(known[0], frames.triangles):
        raise InputError(
            f"the triangles of the neutral ({face.source}) are not those of {frames.source}",
            expected="one topology",
            remedy="Export the neutral and the frames from one mesh, in one vertex order.",
        )
    broken = np.flatnonzero(~np.isfinite(face.vertices).all(axis=1))
    if len(broken):
        raise InputError(
            f"the neutral ({face.source}) has {len(broken)} vertices that are no numbers, the first is {broken[0]}",
            expected="finite positions",
            remedy="Export it again, or give another neutral.",
        )
    check_size(face.vertices, f"the neutral ({face.source})", unit if isinstance(neutral, str | Path) else None)
    return NeutralFace(face.vertices, known[0], face.regions, face.source)


def _read_neutral(frames: MeshFrames, scale: float, neutral: Path | NDArray | Template | None, unit: str) -> NeutralFace:
    """With triangles None where none are known."""
    if neutral is None:
        return NeutralFace(np.asarray(frames.positions[0:1][0], float) * scale, None, {}, "the first frame")
    if isinstance(neutral, Template):
        return NeutralFace(np.asarray(neutral.vertices, float), neutral.triangles, dict(neutral.regions), "the template")
    if not isinstance(neutral, str | Path):
        return NeutralFace(np.asarray(neutral, float).reshape(-1, 3), None, {}, "the positions given")
    path = Path(neutral)
    if path.suffix.lower() in MESH_SUFFIXES:
        vertices, corners = read_surface(path)
        return NeutralFace(vertices * metres_per(unit), corners, {}, path.name)
    try:
        template = Template.load(path)
    except (ArtifactError, OSError) as error:
        raise InputError(
            f"{path} is no neutral face ({error})", expected="a template .npz or an OBJ or PLY mesh", remedy="Name another file."
        ) from error
    return NeutralFace(np.asarray(template.vertices, float), template.triangles, dict(template.regions), path.name)
