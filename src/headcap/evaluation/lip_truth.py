"""A clip's lips against true meshes, which may have a topology of their own (lip paper, section 4.1 and table 1)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import dijkstra

from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.evaluation.lip_errors import BASE, LipErrors, LipReference, compare_lips
from headcap.evaluation.lip_sections import LipSections
from headcap.evaluation.truth import Truth
from headcap.geometry.transforms import fit_similarity, rigid
from headcap.heads import HeadModel
from headcap.lips.correction import TrueNeutral
from headcap.lips.mouth import Mouth
from headcap.lips.people import registered_neutral
from headcap.lips.takes import MouthSpace, SeenTake
from headcap.meshes.rasteriser import rasterise
from headcap.registration.face_correspondence import Correspondence, NeutralFace, correspond, face_skin, same_topology
from headcap.registration.graph import edge_graph
from headcap.registration.sequence import MeshSequence
from headcap.registration.template import Template

_HIDDEN_M = 4e-3
"""How far behind what is seen a face goes on: lips turn inwards there and come to light as the mouth opens."""
_YAWS_DEG, _PITCHES_DEG = (-60.0, -30.0, 0.0, 30.0, 60.0), (-40.0, -10.0, 20.0)
"""From where a face is looked at; positive pitches are above it."""
_DISTANCE_M, _VIEW_PX, _VIEW_M = 0.8, 900, 0.3
"""Of the eye, the side of its picture, and how much of the face that shows."""
_LEAST_LANDMARKS = 4
_ELSEWHERE = ("nose_wing_left", "nose_wing_right")
"""Landmarks that schemes place differently: the widest place of a nose, or the lower end of its wing, 7 mm away."""


@dataclass(frozen=True, eq=False)
class TrueMeshes:
    """What a face truly did in a clip, in any topology (N vertices, M triangles) and any frame, metres."""

    triangles: NDArray[np.int32]
    """(M, 3)"""
    neutral: NDArray[np.float64]
    """(N, 3) at rest."""
    landmarks: dict[str, int]
    """Named vertices; names are the head model's."""
    at: Callable[[int], NDArray[np.float64] | None]
    """The mesh (N, 3) of a frame of the clip; None where it is not known."""

    @classmethod
    def of_sequence(cls, sequence: MeshSequence, template: Template, frames: int) -> TrueMeshes:
        """Of meshes that belong to the clip's frames one by one; the template tells triangles, landmarks and the face at rest.

        Raises `InputError` for another number of frames, and for a template of another topology.
        """
        if len(sequence) != frames:
            raise _refused(f"{len(sequence)} true meshes", f"{frames}, one for each frame of the video")
        parts = [np.load(chunk, mmap_mode="r") for chunk in sequence.chunks]
        if parts[0].shape[1:] != template.vertices.shape:
            raise _refused(f"true meshes of {parts[0].shape[1]} vertices", f"{len(template.vertices)}, as their template has")
        starts = np.cumsum([0, *(len(part) for part in parts)])

        def at(frame: int) -> NDArray[np.float64] | None:
            """From its chunk's memory map."""
            part = int(np.searchsorted(starts, frame, side="right")) - 1
            mesh = np.asarray(parts[part][frame - starts[part]], np.float64)
            return mesh if np.isfinite(mesh).all() else None

        return cls(template.triangles, np.asarray(template.vertices, np.float64), dict(template.landmarks), at)

    @classmethod
    def of_rig(cls, truth: Truth, take: str, camera: str, time_s: NDArray) -> TrueMeshes:
        """Of a truth folder, at the moments `time_s` (f,) of a camera's recording; the take's first frame is taken for rest.

        Moments that the truth does not span are not known. Raises `InputError` for takes and cameras that the folder has not.
        """
        if take not in truth.takes:
            raise _refused(f"a take called {take}", f"one of {', '.join(truth.takes)}")
        starts = truth.start_s(take)
        if camera not in starts:
            raise _refused(f"a camera called {camera}", f"one of {', '.join(starts)}")
        true, shift_s = truth.take(take), starts[camera] - float(time_s[0])

        def at(frame: int) -> NDArray[np.float64] | None:
            """Between the take's frames, at the moment the camera took this one."""
            try:
                return true.at(shift_s + float(time_s[frame]))
            except ValueError:
                return None

        return cls(truth.triangles, true.frame(0), truth.landmarks, at)


def correspondence_of(model: HeadModel, mouth: Mouth, neutral: NDArray, true: TrueMeshes) -> Correspondence:
    """Where the head model's vertices, at rest as tracked (n, 3), lie on a true face (section 4.1).

    The identity where both have the same triangles. Otherwise `correspond` on the landmarks that both name, with what is seen of
    the true face from before it, and a little behind. Raises `InputError` as `correspond`.
    """
    if np.array_equal(model.triangles, true.triangles):
        return same_topology(true.neutral, true.triangles)
    names = [name for name in true.landmarks if name not in _ELSEWHERE]
    marks = {name: vertex for name, vertex in (model.landmarks | _lip_middles(model, mouth)).items() if name in names}
    own = NeutralFace.of(neutral, model.triangles, marks, model.regions)
    theirs = {name: true.neutral[true.landmarks[name]] for name in marks}
    if len(marks) < _LEAST_LANDMARKS:
        raise _refused(
            f"{len(marks)} landmarks that both topologies name", f"{_LEAST_LANDMARKS} at least: corners of eyes and mouth, chin"
        )
    upright = fit_similarity(np.array(list(own.landmarks.values())), np.array(list(theirs.values())))[0][:3, :3]
    return correspond(own, NeutralFace(true.neutral, true.triangles, theirs, seen_skin(true, upright, list(theirs.values()))))


def seen_skin(true: TrueMeshes, upright: NDArray, places: list[NDArray]) -> NDArray[np.bool_]:
    """(N,) of a true face at rest that is seen from 15 places before it, and what lies up to 4 mm behind along the surface.

    `upright` (3, 3) turns x to the face's left, y up and z out of it; `places` (3,) lie about it. The mouth's inside, the nose's
    and what is behind the lids have no counterpart in a head model.
    """
    seen, middle = np.zeros(len(true.neutral), bool), np.mean(places, axis=0)
    for yaw in np.radians(_YAWS_DEG):
        for pitch in np.radians(_PITCHES_DEG):
            out = upright @ [np.cos(pitch) * np.sin(yaw), np.sin(pitch), np.cos(pitch) * np.cos(yaw)]
            raster = rasterise(_looking(middle, out, upright[:, 1]), true.neutral, true.triangles, cull_back_faces=True)
            seen[true.triangles[np.unique(raster.triangle[raster.hit])]] = True
    graph = edge_graph(true.neutral, true.triangles)
    return np.isfinite(dijkstra(graph, indices=np.flatnonzero(seen), min_only=True, limit=_HIDDEN_M))


def carried_meshes(tie: Correspondence, true: TrueMeshes, frames: int) -> Iterator[NDArray[np.float64]]:
    """True meshes (n, 3) of a clip's frames in the head model's topology, one at a time; NaN where they are not known."""
    for frame in range(frames):
        mesh = true.at(frame)
        yield np.full(tie.registered.shape, np.nan) if mesh is None else tie.carry(mesh)


def judge_against(
    space: MouthSpace,
    seen: SeenTake,
    corrected: Mapping[str, Iterable[NDArray]],
    true: TrueMeshes,
    time_s: NDArray,
    *,
    person: str,
    take: str,
    knowing: Collection[str] = (),
) -> LipErrors:
    """Errors of a clip's base track and of what was made of it, meshes (f, n, 3) by method in the camera's world.

    Methods `knowing` the true head at rest are aligned by it. Raises `InputError` as `correspondence_of` and `compare_lips`.
    """
    tie = correspondence_of(space.model, space.mouth, seen.neutral, true)
    sections = LipSections.of(np.asarray(space.model.vertices, float), space.mouth, space.model.regions)
    reference = LipReference(space.mouth, sections, seen.neutral, placed_neutral(space.model, seen.neutral, true, tie))
    sequences = {BASE: seen.base.world(seen.base.meshes), **corrected}
    return compare_lips(
        reference, carried_meshes(tie, true, len(seen)), sequences, time_s, person=person, take=take, knowing=knowing
    )


def placed_neutral(model: HeadModel, neutral: NDArray, true: TrueMeshes, tie: Correspondence) -> TrueNeutral:
    """The true face at rest in the head model's topology, and by which skin the tracked one (n, 3) is laid on it."""
    if np.array_equal(model.triangles, true.triangles):
        return registered_neutral(model, neutral, true.neutral)
    carried, skin = tie.carry(true.neutral), np.flatnonzero(tie.matched & face_skin(model.regions))
    return TrueNeutral(carried, skin, carried[skin])


def _lip_middles(model: HeadModel, mouth: Mouth) -> dict[str, int]:
    """Vertices of the lips' border to the skin above and below the middle: models' own landmarks may lie beside it."""
    across = np.abs(np.asarray(model.vertices)[mouth.outline, 0])
    upper, lower = slice(1, mouth.left), slice(mouth.left + 1, None)
    return {
        "lip_upper_top": int(mouth.outline[upper][across[upper].argmin()]),
        "lip_lower_bottom": int(mouth.outline[lower][across[lower].argmin()]),
    }


def _looking(middle: NDArray, out: NDArray, up: NDArray) -> Camera:
    """A camera that looks at a point from the way `out` (3,)."""
    right = np.cross(up, out)
    right /= np.linalg.norm(right)
    turn = np.stack([right, -np.cross(out, right), -out])
    focal, centre = _VIEW_PX * _DISTANCE_M / _VIEW_M, 0.5 * (_VIEW_PX - 1)
    matrix = np.array([[focal, 0, centre], [0, focal, centre], [0, 0, 1]])
    return Camera("looking", _VIEW_PX, _VIEW_PX, matrix, np.zeros(5), rigid(turn, -turn @ (middle + _DISTANCE_M * out)))


def _refused(found: str, expected: str) -> InputError:
    return InputError(found, expected=expected, remedy="Give the true meshes of this very clip, with their topology.")
