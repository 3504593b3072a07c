"""How a subject that is rehearsed as meshes looks to a camera: its skin over the very vertices of the meshes, eyes, teeth.

What is true of the meshes is true of the pictures: no vertex is added to the skin and none is moved. Where an eye meets the lids
vertices are doubled, because paint is told in millimetres of the resting body on skin and of the eyeball on an eye. The eyeballs
of these meshes do not turn; the iris wanders over them. Teeth stand behind the lips and are in no mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from headcap.heads.procedural import base_head
from headcap.meshes.normals import triangle_normals, vertex_normals
from headcap.synthetic import identity, motion
from headcap.synthetic.anatomy import Places
from headcap.synthetic.growth import LEAST_OPENNESS, LEAST_TOOTH_OPENNESS
from headcap.synthetic.lighting import openness
from headcap.synthetic.mesh_takes import MeshSubject
from headcap.synthetic.parts import Part, teeth
from headcap.synthetic.render import Surface
from headcap.synthetic.rig import SUBJECT_STREAM, random_stream
from headcap.synthetic.subject import AT_REST
from headcap.synthetic.texture import EYE, LOOK_COLUMNS, MOUTH, SKIN, TOOTH, Grain, make_grain

_LOOK_STREAM, _HAIR_STREAM = 3, 4
"""Of `SUBJECT_STREAM`; the subject itself, its scan and the scan's place are drawn from others."""
TONE = LOOK_COLUMNS.index("tone")
_HAIR_TONE = -24.0
"""Skin so dark is hair, as far as a pixel can tell."""
_BROW_LIFT_M, _BROW_ARCH_M = (0.007, 0.012), (0.001, 0.005)
"""Of a brow's middle over the upper lid, and of its arc."""
_BROW_THICKNESS_M, _BROW_DARKNESS = (0.0030, 0.0048), (0.6, 0.95)


@dataclass(frozen=True, eq=False)
class MeshLook:
    """Skin and hard parts of a mesh subject, ready to be posed and rendered; n points, the first k of them on the mesh."""

    origin: NDArray[np.int64]
    """(k,) the mesh's vertex at each point."""
    surface: Surface
    openness: NDArray[np.float64]
    """(n,) share of the sky seen at rest."""
    grain: Grain
    eyes: NDArray[np.int64]
    """(e,) points of the eyes."""
    from_pupil_mm: NDArray[np.float64]
    """(e, 3) from the eyeball's centre at rest."""
    teeth: tuple[Part, ...]
    places: Places

    def pose(self, mesh: NDArray, state: dict[str, float]) -> tuple[NDArray[np.float64], Surface]:
        """Points (n, 3) for a mesh (v, 3) of this subject that was made from the channels `state`, and the surface over them."""
        points = np.concatenate([np.asarray(mesh, float)[self.origin], *(self._teeth(part, state) for part in self.teeth)])
        look = self.surface.look.copy()
        # the part of the eyeball that comes to lie under a place is the one that lay there, turned back
        look[self.eyes, :3] = self.from_pupil_mm @ motion.gaze_rotation(state["gaze_x"], state["gaze_y"])
        return points, replace(self.surface, look=look)

    def _teeth(self, part: Part, state: dict[str, float]) -> NDArray[np.float64]:
        points = part.points.copy()
        if part.jaw:
            motion.turn_hinge(points, np.arange(len(points)), np.full(len(points), part.jaw), self.places, state)
        turn = np.array([state["turn_x"], state["turn_y"], state["turn_z"]])
        if turn.any():
            motion.bend_neck(points, np.ones(len(points)), motion.neck_transforms(self.places, turn))
        return points


def look_of(person: MeshSubject, *, tattoos: bool, lip_tattoo: bool) -> MeshLook:
    """What a camera sees of a person; equal people look equal, with and without tattoos but for the ink."""
    subject, head = person.subject, base_head()
    places, rest = subject.places, person.mesh(AT_REST)
    origin, triangles, is_eye = _parted_eyes(head.triangles, head.regions["eyes"])
    look = _skin_look(person, tattoos=tattoos, lip_tattoo=lip_tattoo)[origin]
    eyes = np.unique(triangles[is_eye])
    left = rest[origin[eyes], 0] > 0
    from_pupil_mm = 1000 * (rest[origin[eyes]] - np.where(left[:, None], places.eye_left, places.eye_right))
    wall = head.regions["mouth_interior"][head.triangles].all(axis=1)
    material = np.where(is_eye, EYE, np.where(wall, MOUTH, SKIN)).astype(np.uint8)
    hard = teeth(places, upper=True), teeth(places, upper=False)
    starts = len(origin) + np.cumsum([0, len(hard[0].points)])
    points = np.concatenate([rest[origin], *(part.points for part in hard)])
    joined = np.concatenate([triangles, *(part.triangles + k for part, k in zip(hard, starts, strict=True))]).astype(np.int32)
    area_mm2 = 0.5e6 * np.linalg.norm(triangle_normals(points, joined), axis=1)
    material = np.concatenate([material, *(np.full(len(part.triangles), part.material, np.uint8) for part in hard)])
    looks = np.concatenate([look, *(part.look for part in hard)]).astype(np.float32)
    surface = Surface(joined, material, looks, area_mm2.astype(np.float32))
    return MeshLook(origin, surface, _sky(points, surface), make_grain(person.seed), eyes, from_pupil_mm, hard, places)


def _skin_look(person: MeshSubject, *, tattoos: bool, lip_tattoo: bool) -> NDArray[np.float32]:
    """Columns `texture.LOOK_COLUMNS` (v, 7) of a mesh's vertices; lips are red as far in as they can be seen."""
    points, places = person.subject.bare_m, person.subject.places
    regions = {name: mask.astype(float) for name, mask in base_head().regions.items()}
    for side in ("upper", "lower"):
        regions[f"lips_{side}"] = np.maximum(regions[f"lips_{side}"], regions[f"lips_inner_{side}"])
    random = random_stream(person.seed, SUBJECT_STREAM, _LOOK_STREAM)
    look = identity.skin_look(points, regions, places, random, tattoos=tattoos)
    # a stream of its own: who grows no hair otherwise looks as before
    look[:, TONE] += _HAIR_TONE * facial_hair(person)
    return identity.tattoo_lips(look, points, regions, places) if lip_tattoo else look


def facial_hair(person: MeshSubject) -> NDArray[np.float64]:
    """Share (v,) of the skin that brows and lashes cover: by them faces are found, in life and by trackers.

    Brows are arcs over the eyes, of a height, thickness, length and darkness of the person's own; lashes line the upper lids.
    """
    points, marks = person.subject.bare_m, base_head().landmarks
    random = random_stream(person.seed, SUBJECT_STREAM, _HAIR_STREAM)
    height, thickness, dark = random.uniform(*_BROW_LIFT_M), random.uniform(*_BROW_THICKNESS_M), random.uniform(*_BROW_DARKNESS)
    arch, hair, rims = random.uniform(*_BROW_ARCH_M), np.zeros(len(points)), base_head().regions["lid_rims"]
    facing = vertex_normals(points, base_head().triangles)[:, 2] > 0.1
    for side in ("left", "right"):
        inner, outer, top = (points[marks[f"eye_{end}_{side}"]] for end in ("inner", "outer", "top"))
        along = (points[:, 0] - inner[0]) / (outer[0] - inner[0])
        middle = top[1] + height + arch * (1 - ((along - 0.62) / 0.75) ** 2)
        tapered = thickness * np.clip(1.3 - 0.5 * along, 0.3, 1.0)
        ends = np.clip((along + 0.25) / 0.2, 0, 1) * np.clip((1.25 - along) / 0.2, 0, 1)
        hair = np.maximum(hair, facing * ends * np.exp(-(((points[:, 1] - middle) / tapered) ** 4)))
        upper = (along > 0) & (along < 1) & (points[:, 1] > inner[1] + along * (outer[1] - inner[1]))
        hair = np.maximum(hair, rims & upper)
    return dark * hair


def _parted_eyes(triangles: NDArray, eyes: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.bool_]]:
    """Old vertex of each new one (k,), triangles (m, 3) over the new ones, mask (m,) of the eyes'; the two share no vertex."""
    is_eye = eyes[triangles].any(axis=1)
    rim = np.intersect1d(triangles[is_eye], triangles[~is_eye])
    renamed = np.arange(len(eyes))
    renamed[rim] = len(eyes) + np.arange(len(rim))
    parted = np.where(is_eye[:, None], renamed[triangles], triangles)
    return np.concatenate([np.arange(len(eyes)), rim]), parted.astype(np.int32), is_eye


def _sky(points: NDArray, surface: Surface) -> NDArray[np.float64]:
    # what is shut away at rest sees something of the room once the mouth opens; eyes and teeth are wet
    least = np.full(len(points), LEAST_OPENNESS)
    least[surface.triangles[np.isin(surface.material, (TOOTH, EYE))]] = LEAST_TOOTH_OPENNESS
    return np.maximum(openness(points, vertex_normals(points, surface.triangles), surface.triangles), least)
