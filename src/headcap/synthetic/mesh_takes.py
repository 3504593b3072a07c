"""Subjects as mesh sequences, without a rig: the rehearsed person in the head model's own topology, with muscles in the neck.

A study may take further subjects in this form. Their motion is `Subject`'s (arcs, a hinge, a spine of seven joints, a larynx that
slides), in no model's class; what is left out is what only a camera sees: denser skin, eyeballs that turn, teeth, blinking lids.

As true lips for training these meshes need no cleaning: gums and teeth, which the lips' paper masks out of its reconstructions
(section 3.1), are in no mesh, lips never pass through each other, and the wall behind them is the region `mouth_interior`, which
`lips.mouth.find_mouth` leaves out. The same region keeps gums out of tracked takes. What remains there are the lips' inner sides,
a tenth of the vertices that correction and errors count: true here, and in tracked takes carried along where no camera sees them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from headcap.heads.procedural import base_head
from headcap.meshes.normals import vertex_normals
from headcap.registration.register import lip_pairs
from headcap.registration.template import Template
from headcap.synthetic import identity, lips, motion
from headcap.synthetic.anatomy import Places, find_places, solve_fields
from headcap.synthetic.growth import place_larynx
from headcap.synthetic.larynx import build_larynx
from headcap.synthetic.performance import Performance, perform
from headcap.synthetic.rig import MOTION_STREAM, SUBJECT_STREAM, random_stream
from headcap.synthetic.settings import LipShape, SubjectSettings, TakeKind
from headcap.synthetic.subject import AT_REST, Subject

_FULL_TURN_RAD = 0.5
"""The turn of the head at which a sternomastoid is as thick as it gets."""
_STERNOMASTOID_SWELL_M, _STERNOMASTOID_RADIUS_M = 0.0045, 0.011
_PLATYSMA_SWELL_M, _PLATYSMA_PULL_M, _PLATYSMA_RADIUS_M = 0.0025, 0.006, 0.009


@dataclass(frozen=True, eq=False)
class MeshTake:
    """What a subject does in a take, as meshes in the base head's topology."""

    meshes: NDArray[np.float32]
    """(f, n, 3) metres."""
    states: tuple[dict[str, float], ...]
    """Channels of `performance.CHANNELS` at each frame."""
    performance: Performance


@dataclass(frozen=True, eq=False)
class NeckMuscles:
    """Sternomastoids that swell as the head turns away from them, and the platysma's bands that grimaces draw up."""

    normals: NDArray[np.float64]
    """(n, 3) of the resting skin."""
    sternomastoids: tuple[tuple[NDArray, NDArray], ...]
    """Left, right: closeness (n,) to the strand, place (n,) along it from mastoid (0) to sternum (1)."""
    platysma: NDArray[np.float64]
    """(n,) closeness to the bands."""

    def displacement(self, state: dict[str, float]) -> NDArray[np.float64]:
        """(n, 3) metres at rest; grows faster than the angles, and its peak wanders along the strand."""
        out = np.zeros_like(self.normals)
        for side, (near, along) in zip((1, -1), self.sternomastoids, strict=True):
            turned = np.clip(-side * state["turn_y"] / _FULL_TURN_RAD, 0, 1.2)
            contraction = turned + 0.4 * np.clip(-state["turn_x"] / _FULL_TURN_RAD, 0, 1)
            belly = np.exp(-0.5 * ((along - 0.62 + 0.25 * contraction) / 0.22) ** 2)
            out += (_STERNOMASTOID_SWELL_M * contraction**1.7 * near * belly)[:, None] * self.normals
        drawn = 0.5 * (state["corner_down_left"] + state["corner_down_right"]) + 0.35 * state["jaw"] ** 2
        out += (_PLATYSMA_SWELL_M * drawn**1.5 * self.platysma)[:, None] * self.normals
        out[:, 1] += _PLATYSMA_PULL_M * np.sin(np.clip(drawn, 0, 1.5)) * self.platysma**0.5
        return out


@dataclass(frozen=True, eq=False)
class MeshSubject:
    """A person of its own in the base head's topology."""

    seed: int
    subject: Subject
    muscles: NeckMuscles

    @property
    def neutral_m(self) -> NDArray[np.float64]:
        """(n, 3) at rest."""
        return self.mesh(AT_REST)

    def mesh(self, state: dict[str, float]) -> NDArray[np.float64]:
        """Positions (n, 3), metres, for the channels of `performance.CHANNELS`."""
        swollen = replace(self.subject, bare_m=self.subject.bare_m + self.muscles.displacement(state))
        return swollen.vertices(state)

    def take(
        self, kind: TakeKind, frames: int, rate_hz: float, *, number: int = 0, intensity: float = 1.0,
        lip_shapes: tuple[LipShape, ...] = (),
    ) -> MeshTake:  # fmt: skip
        """A take of a kind; takes of different numbers differ, equal ones are equal."""
        performance = perform(random_stream(self.seed, MOTION_STREAM, number), kind, frames / rate_hz, intensity, lip_shapes)
        states = tuple(performance.state(k / rate_hz) for k in range(frames))
        meshes = np.empty((frames, *self.subject.bare_m.shape), np.float32)
        for mesh, state in zip(meshes, states, strict=True):
            mesh[:] = self.mesh(state)
        return MeshTake(meshes, states, performance)


def mesh_subject(seed: int, settings: SubjectSettings | None = None) -> MeshSubject:
    """A subject of the base head's kind whose vertices are the base head's; equal seeds give equal subjects."""
    settings, base = settings or SubjectSettings(), base_head()
    random = random_stream(seed, SUBJECT_STREAM)
    head = base.with_vertices(identity.vary(base.vertices, random, settings.identity))
    places = find_places(head)
    head = head.with_vertices(identity.bare_throat(head.vertices, head.triangles, places))
    places = replace(places, larynx=place_larynx(head.vertices, places))
    fields, pairs = solve_fields(head, places), lip_pairs(head)
    above, below = fields.upper_lip > fields.lower_lip, fields.lower_lip > fields.upper_lip
    head = head.with_vertices(lips.close_lips(head.vertices, pairs, above, below))
    subject = _subject(head, places, fields, pairs, 1e-3 * settings.larynx_prominence_mm)
    return MeshSubject(seed, subject, neck_muscles(head, places))


def neck_muscles(head: Template, places: Places) -> NeckMuscles:
    """Where the neck's muscles run under the skin of a head."""
    v, skin = head.vertices, head.regions["neck"] | head.regions["face"]
    low = v[head.regions["neck"], 1].min()
    strands, bands = [], np.zeros(len(v))
    for side in (1, -1):
        width = side * v[head.regions["neck"] & (side * v[:, 0] > 0), 0]
        mastoid = places.hinge + np.array([side * 0.9 * width.max(), -0.022, -0.038])
        sternum = np.array([side * 0.016, low + 0.012, places.larynx[2] - 0.012])
        near, along = _strand(v, mastoid, sternum, _STERNOMASTOID_RADIUS_M)
        strands.append((near * skin, along))
        jaw = places.chin + np.array([side * 0.024, -0.012, -0.016])
        collar = np.array([side * 0.034, low + 0.01, places.larynx[2] - 0.02])
        near, along = _strand(v, jaw, collar, _PLATYSMA_RADIUS_M)
        bands = np.maximum(bands, near * np.sin(np.pi * np.clip(along, 0, 1)) * head.regions["neck"])
    # the bands lie right under the skin, wherever the line through them runs
    return NeckMuscles(vertex_normals(v, head.triangles), tuple(strands), bands / bands.max())


def _strand(points: NDArray, start: NDArray, end: NDArray, radius_m: float) -> tuple[NDArray, NDArray]:
    """Closeness (n,) of points (n, 3) to the line between two points, whose depth under the skin is unknown, and place (n,)."""
    way = end - start
    along = (points - start) @ way / (way @ way)
    away = points - (start + np.clip(along, 0, 1)[:, None] * way)
    return np.exp(-0.5 * (away**2).sum(axis=1) / radius_m**2), along


def _subject(head: Template, places: Places, fields, pairs: NDArray, prominence_m: float) -> Subject:
    v, regions = head.vertices, head.regions
    upper, lower = (regions[f"lips_{side}"] | regions[f"lips_inner_{side}"] for side in ("upper", "lower"))
    inside = regions["mouth_interior"] | regions["lips_inner_upper"] | regions["lips_inner_lower"]
    follows = lips.follows_face(v, pairs, inside) * ~regions["eyes"]
    nobody = np.zeros(0, np.int64)
    return Subject(
        bare_m=v,
        surface=None,
        lips_surface=None,
        occluder=head.triangles,
        openness=np.ones(len(v)),
        grain=None,
        places=places,
        fields=fields,
        larynx=build_larynx(v, ~regions["mouth_interior"], places, prominence_m),
        pulls=motion.build_pulls(v, follows, places),
        contact=lips.build_contact(v, pairs, upper, lower),
        lids=(),
        eyes=(nobody, nobody),
        lip_zone=np.flatnonzero(np.linalg.norm(v - places.mouth, axis=1) < 0.08),
        jaw_zone=np.flatnonzero((fields.jaw > 1e-3) | (fields.upper_lip > 1e-3)),
        outside=np.ones(len(head.triangles), bool),
        landmarks=head.landmarks,
    )
