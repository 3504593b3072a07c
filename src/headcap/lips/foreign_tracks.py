"""Tracks that other programs made, in the place of our own base tracker's (lip paper, section 3.2: any tracker may be corrected).

What the correction asks of a base track is `BaseTrack`: meshes in the head model's topology in the axes of the world that the
camera stands in, the neutral mesh they deviate from, and which frames have an answer. A FLAME parameter sequence gives that
through FLAME itself; a mesh sequence gives it as it is, or, in a topology of its own, through ties to the model's vertices.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from headcap.errors import InputError
from headcap.geometry.rotations import rotation_matrices
from headcap.geometry.transforms import rigid
from headcap.heads import HeadCoefficients, HeadModel
from headcap.heads.archive import read_npz
from headcap.heads.flame import FlameSettings, flame_root
from headcap.lips.correction import CanonicalMeshes, canonical_meshes
from headcap.lips.mouth import Mouth
from headcap.meshes.closest_point import barycentric_weights
from headcap.meshes.normals import triangle_normals, vertex_normals

_BLOCK = 64
_KEYS = {
    "expression": ("expression", "expr", "exp"),
    "shape": ("shape", "betas"),
    "pose": ("pose", "full_pose"),
    "turn": ("global_orient", "rotation", "global_pose"),
    "neck": ("neck_pose", "neck"),
    "jaw": ("jaw_pose", "jaw"),
    "shift": ("transl", "translation", "trans"),
}
"""What the common FLAME trackers call their arrays."""
_POSES = {6: {"turn": 0, "jaw": 3}, 9: {"turn": 0, "neck": 3, "jaw": 6}, 15: {"turn": 0, "neck": 3, "jaw": 6}}
"""Where rotation vectors begin in a joined pose of so many numbers: turn and jaw, or all of FLAME's joints in order."""
_HEAD_M = (0.1, 0.8)
"""Least and largest extent of a head with or without its shoulders, metres."""
_CANDIDATES, _OPPOSED_M = 12, 0.02
"""Triangles that a vertex may be tied to, and how much farther away one counts whose normal points the other way: lips touch."""


@runtime_checkable
class BaseTrack(Protocol):
    """f frames of one head as a base tracker saw it."""

    time_s: NDArray[np.float64]
    """(f,) rising."""

    @property
    def answered(self) -> NDArray[np.bool_]:
        """(f,) frames with an answer."""

    def neutral(self, model: HeadModel) -> NDArray[np.float64]:
        """(n, 3) the head at rest, metres, in its own frame (C_0 of eq. 1)."""

    def meshes(self, model: HeadModel) -> Iterator[NDArray[np.float32]]:
        """(n, 3) of each frame in the world, metres, NaN where there is no answer."""


def canonical_track(track: BaseTrack, model: HeadModel, mouth: Mouth) -> CanonicalMeshes:
    """All frames of a base track without rigid motion, as the correction layer takes them; frames without an answer are NaN."""
    meshes = np.empty((len(track.time_s), len(model.vertices), 3), np.float32)
    for k, mesh in enumerate(track.meshes(model)):
        meshes[k] = mesh
    return canonical_meshes(meshes, track.neutral(model), mouth.steady)


# -- FLAME --------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class FlameTrack:
    """A FLAME parameter sequence; f frames, NaN where its tracker gave none."""

    model: str
    """Digest of the head model that `load_flame` made."""
    time_s: NDArray[np.float64]
    shape: NDArray[np.float64]
    """beta (s,)."""
    expression: NDArray[np.float64]
    """psi (f, e)."""
    pose: NDArray[np.float64]
    """(f, 2, 3) rotation vectors of neck and jaw, radians."""
    placement: NDArray[np.float64]
    """world_from_head (f, 4, 4): FLAME's global rotation about its root joint, and its translation."""

    @property
    def answered(self) -> NDArray[np.bool_]:
        """(f,) frames whose every number is finite."""
        rows = (self.expression, self.pose, self.placement)
        return np.all([np.isfinite(row).reshape(len(row), -1).all(axis=1) for row in rows], axis=0)

    def neutral(self, model: HeadModel) -> NDArray[np.float64]:
        """(n, 3) the person at rest, metres."""
        self._check(model)
        return np.asarray(model.identity(self.shape), np.float64)

    def meshes(self, model: HeadModel) -> Iterator[NDArray[np.float32]]:
        """Vertices (n, 3) of each frame in the world, metres; raises `InputError` for another head model."""
        self._check(model)
        for start in range(0, len(self.time_s), _BLOCK):
            block = slice(start, start + _BLOCK)
            given = HeadCoefficients(self.shape, self.expression[block], self.pose[block], placement=self.placement[block])
            meshes = model.evaluate(given)
            meshes[~self.answered[block]] = np.nan
            yield from meshes

    def _check(self, model: HeadModel) -> None:
        if model.digest != self.model:
            raise InputError(
                f"FLAME parameters read for head model {self.model}",
                expected=f"those of {model.name}, {model.digest}",
                remedy="Read the parameters again with this model.",
            )


def load_flame_track(
    path: Path | str,
    model: HeadModel,
    flame_file: Path | str,
    time_s: NDArray | None = None,
    *,
    rate_hz: float | None = None,
    settings: FlameSettings | None = None,
) -> FlameTrack:
    """A FLAME parameter sequence, npz, of any of the usual trackers, for the head model that `load_flame` made of `flame_file`.

    `settings` are those that the model was loaded with.

    Arrays by any of their usual names: expression (f, e) or expr, exp; shape (s,), (1, s) or (f, s), whose mean is taken, or
    betas; the pose as one array (f, 6) of global rotation and jaw, (f, 9) or (f, 15) of global rotation, neck, jaw (and eyes,
    passed over), or as global_orient, neck_pose, jaw_pose (f, 3) each, also called rotation, neck, jaw; transl (f, 3) or
    translation, metres; rotation vectors in radians. Moments are `time_s` (f,), the file's own `time_s`, or frames at `rate_hz`.
    What the file does not hold is zero. FLAME turns the head about its root joint: v = R (v - J_0) + J_0 + t (Li et al. 2017,
    eq. 2). Offsets of single vertices are passed over. Raises `InputError` for a file of another kind or lengths that differ.
    """
    path = Path(path)
    arrays = read_npz(path, expected="an npz of plain arrays", remedy="Export the parameters without objects.")
    found = {name: arrays[key] for name, keys in _KEYS.items() for key in keys if key in arrays}
    if "expression" not in found:
        raise InputError(
            f"{path.name} holds {', '.join(sorted(arrays)) or 'nothing'}",
            expected="expression (f, e), with shape, pose and transl beside it",
            remedy="Export FLAME's parameters by these names.",
        )
    expression = _rows(path, "expression", found["expression"], None)
    frames = len(expression)
    turns = {name: _rows(path, name, found[name], frames, 3) for name in ("turn", "neck", "jaw") if name in found}
    if "pose" in found:
        pose = _rows(path, "pose", found["pose"], frames)
        if pose.shape[1] not in _POSES:
            raise _unfit(path, "pose", pose.shape, f"({frames}, 6), ({frames}, 9) or ({frames}, 15)")
        turns = {name: pose[:, at : at + 3] for name, at in _POSES[pose.shape[1]].items()} | turns
    zero = np.zeros((frames, 3))
    shape = _shape(path, found.get("shape", np.zeros(1)), len(model.shape_basis))
    shift = _rows(path, "transl", found["shift"], frames, 3) if "shift" in found else zero
    placement = _about_root(turns.get("turn", zero), shift, flame_root(flame_file, shape, settings))
    expression = expression[:, : len(model.expression_basis)]
    moments = _moments(path, arrays.get("time_s") if time_s is None else time_s, rate_hz, frames)
    pose = np.stack([turns.get("neck", zero), turns.get("jaw", zero)], axis=1)
    return FlameTrack(model.digest, moments, shape, expression, pose, placement)


def _about_root(turn: NDArray, shift: NDArray, root: NDArray) -> NDArray[np.float64]:
    """world_from_head (f, 4, 4) of FLAME's global rotation vectors (f, 3) about its root joint (3,), and translations (f, 3)."""
    rotation = rotation_matrices(turn)
    return np.stack([rigid(r, root - r @ root + t) for r, t in zip(rotation, shift, strict=True)])


def _rows(path: Path, name: str, array: NDArray, frames: int | None, width: int | None = None) -> NDArray[np.float64]:
    array = np.asarray(array, np.float64)
    if array.ndim == 3 and array.shape[1] == 1:
        array = array[:, 0]
    wrong = array.ndim != 2 or (frames is not None and len(array) != frames) or (width is not None and array.shape[1] != width)
    if wrong or not array.size:
        raise _unfit(path, name, array.shape, f"({frames or 'frames'}, {width or 'numbers'})")
    return array


def _shape(path: Path, given: NDArray, known: int) -> NDArray[np.float64]:
    given = np.atleast_2d(np.asarray(given, np.float64))
    if given.ndim != 2:
        raise _unfit(path, "shape", given.shape, "(s,), (1, s) or (f, s)")
    return given[np.isfinite(given).all(axis=1)].mean(axis=0)[:known]


def _moments(path: Path, time_s: NDArray | None, rate_hz: float | None, frames: int) -> NDArray[np.float64]:
    if time_s is None and rate_hz is None:
        raise InputError(
            f"{path.name} without times", expected="time_s (f,) in it, or beside it", remedy="Give the times or the frame rate."
        )
    out = np.arange(frames) / rate_hz if time_s is None else np.ravel(np.asarray(time_s, np.float64))
    if out.shape != (frames,) or not (np.diff(out) > 0).all():
        raise _unfit(path, "time_s", out.shape, f"({frames},), rising")
    return out


def _unfit(path: Path, name: str, shape: tuple[int, ...], expected: str) -> InputError:
    return InputError(f"{name} {shape} in {path.name}", expected=expected, remedy="Export one row per frame of the video.")


# -- meshes -------------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class MeshTrack:
    """Meshes of one head in the head model's topology, as another tracker left them; NaN where it gave none."""

    topology: str
    """Digest of the head model's topology."""
    time_s: NDArray[np.float64]
    at_rest: NDArray[np.float64]
    """(n, 3) neutral, metres, upright: y up, z out of the face."""
    sequence: Sequence[NDArray]
    """f meshes (N, 3) in the world, metres; an array (f, N, 3), in memory or mapped, or a `MeshSequence` read into one."""
    ties: SurfaceTies | None = None
    """From the sequence's topology to the model's, where they differ."""

    @property
    def answered(self) -> NDArray[np.bool_]:
        """(f,) frames whose every vertex is finite."""
        return np.array([bool(np.isfinite(mesh).all()) for mesh in self.sequence])

    def neutral(self, model: HeadModel) -> NDArray[np.float64]:
        """(n, 3) the person at rest, metres."""
        self._check(model)
        return self.at_rest

    def meshes(self, model: HeadModel) -> Iterator[NDArray[np.float32]]:
        """Vertices (n, 3) of each frame in the world, metres; raises `InputError` for another topology."""
        self._check(model)
        for mesh in self.sequence:
            if not np.isfinite(mesh).all():
                yield np.full_like(self.at_rest, np.nan, np.float32)
            else:
                yield np.asarray(mesh if self.ties is None else self.ties.carry(mesh), np.float32)

    def _check(self, model: HeadModel) -> None:
        if model.topology_digest != self.topology:
            raise InputError(
                f"meshes in topology {self.topology}",
                expected=f"that of {model.name}, {model.topology_digest}",
                remedy="Tie the sequence to this model first.",
            )


def mesh_track(
    model: HeadModel,
    meshes: NDArray,
    time_s: NDArray,
    neutral: NDArray,
    triangles: NDArray | None = None,
    registered: NDArray | None = None,
) -> MeshTrack:
    """A mesh sequence (f, N, 3) at `time_s` (f,) as a base track of the head model.

    `neutral` (N, 3) is the same person at rest in the sequence's topology, in the head's frame (y up, z out of the face). In the
    model's own topology that is all. In another, `triangles` (m, 3) are the sequence's and `registered` (n, 3) is the head model
    laid onto `neutral` (the two Laplacian registrations of section 4.1): each of its vertices is tied to the triangle it lies
    on. Raises `InputError` for meshes that are no head in metres, times that do not fit, and another topology without ties.
    """
    meshes, neutral = np.asanyarray(meshes), np.asarray(neutral, np.float64)
    time_s = np.asarray(time_s, np.float64)
    if meshes.ndim != 3 or meshes.shape[1:] != (len(neutral), 3) or time_s.shape != meshes.shape[:1]:
        raise InputError(
            f"meshes {meshes.shape} with {time_s.shape} times and a neutral mesh {neutral.shape}",
            expected="(f, N, 3), (f,) and (N, 3)",
            remedy="Give one mesh per moment, all in one topology.",
        )
    extent = float(np.ptp(neutral, axis=0).max())
    if not _HEAD_M[0] < extent < _HEAD_M[1]:
        raise InputError(
            f"a neutral head {extent:.3g} m large",
            expected=f"{_HEAD_M[0]} to {_HEAD_M[1]} m",
            remedy="Scale the sequence to metres; a picture of known camera gives the scale of the model that was tracked with.",
        )
    if registered is None:
        if len(neutral) != len(model.vertices) or (triangles is not None and not np.array_equal(triangles, model.triangles)):
            raise InputError(
                f"meshes of {len(neutral)} vertices",
                expected=f"{len(model.vertices)}, as {model.name}",
                remedy="Register the model to the sequence's neutral mesh and give it with the sequence's triangles.",
            )
        return MeshTrack(model.topology_digest, time_s, neutral, meshes)
    ties = SurfaceTies.of(neutral, np.asarray(triangles), np.asarray(registered, np.float64), model.triangles)
    return MeshTrack(model.topology_digest, time_s, ties.carry(neutral), meshes, ties)


@dataclass(frozen=True, eq=False)
class SurfaceTies:
    """Vertices of one topology that ride on the triangles of another."""

    triangles: NDArray[np.int64]
    """(m, 3) that carry."""
    chosen: NDArray[np.int64]
    """(n,) the triangle that each vertex rides on."""
    barycentric: NDArray[np.float64]
    """(n, 3)."""
    height_m: NDArray[np.float64]
    """(n,) over the triangle, along the carrying surface's smooth normal."""

    @classmethod
    def of(cls, vertices: NDArray, triangles: NDArray, riders: NDArray, rider_triangles: NDArray) -> SurfaceTies:
        """Ties of riders (n, 3), with their triangles, to a surface (N, 3), (m, 3) that they lie on.

        Of the nearest triangles the one that is near and faces the same way: where lips touch, the nearest alone may be the other
        lip's.
        """
        middles = vertices[triangles].mean(axis=1)
        normals, own = triangle_normals(vertices, triangles), vertex_normals(riders, rider_triangles)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
        _, near = cKDTree(middles).query(riders, k=min(_CANDIDATES, len(triangles)))
        near = near.reshape(len(riders), -1)
        corners = vertices[triangles[near.ravel()]]
        points = np.repeat(riders, near.shape[1], axis=0)
        weights = barycentric_weights(corners, points)
        away = np.linalg.norm(np.einsum("qc,qck->qk", weights, corners) - points, axis=1).reshape(near.shape)
        opposed = 0.5 * (1.0 - np.einsum("nck,nk->nc", normals[near], own))
        best = (away + _OPPOSED_M * opposed**2).argmin(axis=1)
        rows = np.arange(len(riders))
        chosen, weights = near[rows, best], weights.reshape(*near.shape, 3)[rows, best]
        ties = cls(np.asarray(triangles, np.int64), chosen, weights, np.zeros(len(riders)))
        height = np.einsum("nk,nk->n", riders - ties.carry(vertices), ties._normals(vertices))
        return cls(ties.triangles, chosen, weights, height)

    def carry(self, vertices: NDArray) -> NDArray[np.float64]:
        """Riders (n, 3) on a deformed surface (N, 3)."""
        vertices = np.asarray(vertices, np.float64)
        on = np.einsum("nc,nck->nk", self.barycentric, vertices[self.triangles[self.chosen]])
        return on + self.height_m[:, None] * self._normals(vertices) if self.height_m.any() else on

    def _normals(self, vertices: NDArray) -> NDArray[np.float64]:
        smooth = vertex_normals(vertices, self.triangles)
        out = np.einsum("nc,nck->nk", self.barycentric, smooth[self.triangles[self.chosen]])
        return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-20)
