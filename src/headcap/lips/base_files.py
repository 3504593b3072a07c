"""Base tracks as files of any tracker's: which kind a file is, and what ties it to the head model (lip paper, section 3.2)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import ArtifactError
from headcap.errors import InputError
from headcap.geometry.transforms import fit_rigid, transform
from headcap.heads import FlameSettings, HeadModel, load_flame
from headcap.lips.foreign_tracks import BaseTrack, MeshTrack, load_flame_track, mesh_track
from headcap.lips.monocular import MonocularTrack
from headcap.lips.mouth import Mouth
from headcap.meshes.files import read_mesh, read_vertex_numbers
from headcap.registration.face_correspondence import NeutralFace, correspond
from headcap.registration.sequence import MeshSequence
from headcap.registration.template import Template


@dataclass(frozen=True)
class BaseTrackFiles:
    """What another tracker left of a video."""

    track: Path
    """.npz of `headcap lips` or of FLAME parameters; .json of a mesh sequence, or .npy (f, N, 3), metres."""
    flame: Path | None = None
    """The FLAME model of the parameters."""
    neutral: Path | None = None
    """The person at rest, upright, in the sequence's topology: template .npz, .ply or .obj in metres."""
    landmarks: Path | None = None
    """JSON of vertex numbers of that mesh by the head model's landmark names, where its file names none."""

    @property
    def given(self) -> list[Path]:
        """The files that there are."""
        return [path for path in (self.track, self.flame, self.neutral, self.landmarks) if path is not None]


@dataclass(frozen=True)
class _Person:
    """A neutral mesh in another topology than the head model's."""

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int32]
    landmarks: dict[str, int] = field(default_factory=dict)
    regions: dict[str, NDArray[np.bool_]] = field(default_factory=dict)

    def face(self) -> NeutralFace:
        """As `correspond` takes it."""
        return NeutralFace.of(self.vertices, self.triangles, self.landmarks, self.regions)


def load_base_track(
    files: BaseTrackFiles, model: HeadModel, mouth: Mouth, time_s: NDArray, flame_settings: FlameSettings | None = None
) -> BaseTrack:
    """A base track of the head model for the frames of a video at `time_s` (f,); `flame_settings` say what is kept of FLAME.

    FLAME parameters of the very FLAME model that the head model was made of are evaluated as they are. Those of another head, and
    meshes of another topology, are tied to the model's vertices, which are laid onto the person at rest by landmarks that both
    name and Laplacian registration (`correspond`, section 4.1). Meshes in the model's topology need no neutral mesh: the first
    frame with an answer, as the paper has it (section 4.2), brought upright by what expressions leave alone. Raises `InputError`
    for files that are none of these, another number of frames than the video's, and as `load_flame_track`, `mesh_track` and
    `correspond`; `ArtifactError`.
    """
    path = files.track
    if path.suffix == ".npz":
        track = _of_parameters(files, model, time_s, flame_settings)
    elif path.suffix in (".json", ".npy"):
        meshes = _meshes(path)
        _check_frames(path, len(meshes), len(time_s))
        track = _of_meshes(files, meshes, model, mouth, time_s)
    else:
        raise InputError(f"{path.name} as a base track", expected="a file that ends in .npz, .json or .npy", remedy="Export one.")
    _check_frames(path, len(track.time_s), len(time_s))
    return track


def _of_parameters(files: BaseTrackFiles, model: HeadModel, time_s: NDArray, settings: FlameSettings | None) -> BaseTrack:
    if files.flame is None:
        try:
            return MonocularTrack.load(files.track)
        except ArtifactError as error:
            raise InputError(
                f"{files.track.name} without a FLAME model ({error})",
                expected="a track of `headcap lips`, or FLAME parameters with --base-flame",
                remedy="Name the FLAME model that the parameters are of.",
            ) from error
    flame = load_flame(files.flame, settings=settings)
    track = load_flame_track(files.track, flame, files.flame, time_s, settings=settings)
    if flame.digest == model.digest:
        return track
    person = _Person(track.neutral(flame), flame.triangles, dict(flame.landmarks), dict(flame.regions))
    return _tied(person, np.array(list(track.meshes(flame))), model, time_s)


def _of_meshes(files: BaseTrackFiles, meshes: NDArray, model: HeadModel, mouth: Mouth, time_s: NDArray) -> MeshTrack:
    if files.neutral is not None:
        person = _read_person(files)
        if not np.array_equal(person.triangles, model.triangles):
            return _tied(person, meshes, model, time_s)
        return mesh_track(model, meshes, time_s, person.vertices)
    if meshes.shape[1:] != model.vertices.shape:
        raise InputError(
            f"{files.track.name} of {meshes.shape[1]} vertices",
            expected=f"the {len(model.vertices)} of {model.name}, or the person at rest in the sequence's topology",
            remedy="Give --base-neutral, a mesh of the same vertices, upright and in metres.",
        )
    known = np.flatnonzero(np.isfinite(meshes).all(axis=(1, 2)))
    if not len(known):
        raise InputError(f"{files.track.name} without a finite mesh", expected="one at least", remedy="Export it again.")
    first, held = np.asarray(meshes[known[0]], float), mouth.steady
    upright = fit_rigid(first[held], np.asarray(model.vertices, float)[held])
    return mesh_track(model, meshes, time_s, transform(upright, first))


def _tied(person: _Person, meshes: NDArray, model: HeadModel, time_s: NDArray) -> MeshTrack:
    """Meshes (f, N, 3) of a person's topology as a track of the head model."""
    vertices = np.asarray(model.vertices, float)
    own = NeutralFace.of(vertices, model.triangles, model.landmarks, model.regions)
    registered = correspond(own, person.face()).registered
    return mesh_track(model, meshes, time_s, person.vertices, person.triangles, registered)


def _read_person(files: BaseTrackFiles) -> _Person:
    path = files.neutral
    if path.suffix == ".npz":
        known = Template.load(path)
        return _Person(known.vertices, known.triangles, dict(known.landmarks), dict(known.regions))
    vertices, triangles = read_mesh(path, expected="a PLY or OBJ mesh, or a template .npz")
    landmarks = {} if files.landmarks is None else read_vertex_numbers(files.landmarks, len(vertices))
    return _Person(vertices, triangles, landmarks)


def _meshes(path: Path) -> NDArray:
    """(f, N, 3), mapped where it is one file."""
    try:
        meshes = MeshSequence.load(path).positions() if path.suffix == ".json" else np.load(path, mmap_mode="r")
    except (OSError, ValueError) as error:
        raise InputError(f"{path.name} cannot be read ({error})", expected="(f, N, 3) numbers", remedy="Export again.") from error
    if meshes.ndim != 3 or meshes.shape[2] != 3 or meshes.dtype.kind != "f":
        raise InputError(
            f"{path.name} {meshes.shape} of {meshes.dtype}", expected="(f, N, 3) of floats, metres", remedy="Export it again."
        )
    return meshes


def _check_frames(path: Path, found: int, wanted: int) -> None:
    if found != wanted:
        raise InputError(
            f"{path.name} of {found} frames", expected=f"{wanted}, as the video", remedy="Export one row per frame of the video."
        )
