"""Growing a subject out of the generic head: identity, eyes, denser mesh, fields, look."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from headcap.meshes.normals import triangle_normals, vertex_normals
from headcap.meshes.topology import boundary_loops, submesh
from headcap.registration.template import Template
from headcap.synthetic import identity, motion
from headcap.synthetic.anatomy import Fields, Places, find_places, solve_fields
from headcap.synthetic.densify import subdivide
from headcap.synthetic.larynx import build_larynx, throat_frame
from headcap.synthetic.lighting import openness
from headcap.synthetic.render import Surface
from headcap.synthetic.rig import SUBJECT_STREAM, random_stream
from headcap.synthetic.settings import SubjectSettings
from headcap.synthetic.subject import AT_REST, Subject
from headcap.synthetic.texture import EYE, LOOK_COLUMNS, MOUTH, SKIN, make_grain

_FOLD = (0.95, 0.86)
"""The lids' edge is folded in to these shares of its distance from the eye's centre, which closes the gap to the eyeball."""
_LEAST_OPENNESS = 0.12
_EYE_SHARE = 0.965
"""The eyeball is this much smaller than the sphere the lids were modelled on: their thickness."""


def grow_subject(base: Template, settings: SubjectSettings, seed: int) -> Subject:
    """A subject of the base head's kind: another identity, surface, mesh and skin; equal seeds give equal subjects."""
    random = random_stream(seed, SUBJECT_STREAM)
    head = base.with_vertices(identity.vary(base.vertices, random, settings.identity))
    places = find_places(head)
    head = head.with_vertices(identity.bare_throat(head.vertices, head.triangles, places))
    places = replace(places, larynx=_throat_place(head.vertices, places))
    head, rims = _open_eyes(head, places)
    operator, triangles = subdivide(head.triangles, len(head.vertices))
    regions = {name: np.clip(operator @ mask.astype(float), 0, 1) for name, mask in head.regions.items()}
    relief = (1 - regions["mouth_interior"]) * (1 - 0.5 * regions["lips_upper"] - 0.5 * regions["lips_lower"])
    skin_m = identity.add_detail(operator @ head.vertices, triangles, relief, random, settings.detail_mm / 1000)
    fields = solve_fields(head, places).mapped(operator)
    look = identity.skin_look(skin_m, regions, places, random, tattoos=settings.tattoos)
    lips_look = identity.tattoo_lips(look, skin_m, regions, places) if settings.tattoos else look
    material = np.where(np.tile(head.regions["mouth_interior"][head.triangles].all(1), 4), MOUTH, SKIN)
    in_mouth = regions["mouth_interior"] > 0.5
    subject = _assemble(skin_m, triangles, material, (look, lips_look), in_mouth, fields, places, seed, rims, head)
    subject = replace(
        subject, larynx=build_larynx(subject.bare_m, _mask(subject, ~in_mouth), places, settings.larynx_prominence_mm / 1000)
    )
    return _lit(subject)


def _assemble(
    skin_m: NDArray, triangles: NDArray, material: NDArray, looks: tuple, in_mouth: NDArray, fields: Fields,
    places: Places, seed: int, rims: list[NDArray], head: Template,
) -> Subject:  # fmt: skip
    n = len(skin_m)
    ball, ball_triangles = _sphere(24, 48)
    radius = _EYE_SHARE * places.eye_radius
    centres = (places.eye_left, places.eye_right)
    points = np.concatenate([skin_m, *(centre + radius * ball for centre in centres)])
    eyes = tuple(n + k * len(ball) + np.arange(len(ball)) for k in range(2))
    coarse = len(triangles) // 4
    balls = [ball_triangles + n + k * len(ball) for k in range(2)]
    triangles = np.concatenate([triangles, *balls]).astype(np.int32)
    material = np.concatenate([material, np.full(2 * len(ball_triangles), EYE)]).astype(np.uint8)
    eye_look = np.zeros((2 * len(ball), len(LOOK_COLUMNS)), np.float32)
    eye_look[:, :3] = np.tile(1000 * radius * ball, (2, 1))
    area = 0.5 * np.linalg.norm(triangle_normals(points, triangles), axis=1) * 1e6
    surfaces = [
        Surface(triangles, material, np.concatenate([look, eye_look]).astype(np.float32), area.astype(np.float32))
        for look in looks
    ]
    fields = Fields(
        *(np.concatenate([f, np.full(2 * len(ball), v)]) for f, v in zip(fields.all(), (1.0, 0.0, 0.0, 0.0), strict=True))
    )
    skin = np.arange(len(points)) < n
    face_skin = skin & ~np.pad(in_mouth, (0, 2 * len(ball)), constant_values=True)
    lids = tuple(motion.build_lids(points, skin, rim, centre, radius) for rim, centre in zip(rims, centres, strict=True))
    near_mouth = np.linalg.norm(points - places.mouth, axis=1) < 0.08
    moving_jaw = (fields.jaw > 1e-3) | (fields.upper_lip > 1e-3)
    outside = (material == SKIN) | ((material == EYE) & (points[triangles].mean(1)[:, 2] > places.eye_left[2]))
    return Subject(
        bare_m=points, surface=surfaces[0], lips_surface=surfaces[1],
        occluder=np.concatenate([head.triangles[:coarse], *balls]).astype(np.int32),
        openness=np.ones(len(points)), grain=make_grain(seed), places=places, fields=fields,
        larynx=build_larynx(points, face_skin, places, 0.0), pulls=motion.build_pulls(points, face_skin, places), lids=lids, eyes=eyes,
        lip_zone=np.flatnonzero(skin & near_mouth), jaw_zone=np.flatnonzero(moving_jaw),
        landmarks=head.landmarks, inner_lips=_inner_lips(head), outside=outside,
    )  # fmt: skip


def _mask(subject: Subject, skin: NDArray) -> NDArray[np.bool_]:
    return np.pad(skin, (0, len(subject.bare_m) - len(skin)), constant_values=False)


def _lit(subject: Subject) -> Subject:
    """The subject with the sky that each of its vertices sees."""
    rest = subject.vertices(AT_REST)
    normals = vertex_normals(rest, subject.surface.triangles)
    # what is shut away at rest, the mouth and the eyeballs' backs, sees something of the room once it opens
    return replace(subject, openness=np.maximum(openness(rest, normals, subject.occluder), _LEAST_OPENNESS))


def _throat_place(points_m: NDArray, places: Places) -> NDArray[np.float64]:
    """The larynx's place on the bare throat."""
    near = np.abs(points_m - places.larynx) @ [2.0, 1.0, 0.0] + 10 * (np.abs(points_m[:, 2] - places.larynx[2]) > 0.03)
    outward, _ = throat_frame(points_m, places)
    found = points_m[np.argmin(near)]
    return places.larynx + outward * float((found - places.larynx) @ outward)


def _open_eyes(head: Template, places: Places) -> tuple[Template, list[NDArray]]:
    """The head with its eyes cut out along the lids' rims, the rims folded in; rims left then right, outermost vertices."""
    keep = ~head.regions["eyes"][head.triangles].any(1)
    triangles, used = submesh(head.triangles, keep)
    points = head.vertices[used]
    new_index = {int(old): new for new, old in enumerate(used)}
    centres = (places.eye_left, places.eye_right)
    loops = [loop for loop in boundary_loops(triangles) if len(loop) > 8]
    rims = [min(loops, key=lambda loop, c=centre: np.linalg.norm(points[loop].mean(0) - c)) for centre in centres]
    parts, folded = [triangles], [points]
    for rim, centre in zip(rims, centres, strict=True):
        outer = rim
        for share in _FOLD:
            inner = sum(len(part) for part in folded) + np.arange(len(rim))
            folded.append(centre + share * (points[rim] - centre))
            after, inner_after = np.roll(outer, -1), np.roll(inner, -1)
            parts += [np.stack([after, outer, inner], axis=1), np.stack([after, inner, inner_after], axis=1)]
            outer = inner
    vertices = np.concatenate(folded)
    extra = len(vertices) - len(points)
    regions = {name: np.pad(mask[used], (0, extra)) for name, mask in head.regions.items()}
    landmarks = {name: new_index[index] for name, index in head.landmarks.items() if index in new_index}
    triangles = np.concatenate(parts).astype(np.int32)
    return Template(vertices, triangles, np.zeros((1, 2)), np.zeros_like(triangles), regions, landmarks), rims


def _sphere(rows: int, columns: int) -> tuple[NDArray, NDArray]:
    """Unit sphere with its poles on the z axis, finest at the pupil; counter-clockwise seen from outside."""
    polar = np.linspace(0, np.pi, rows + 1)[1:-1]
    turn = np.arange(columns) * 2 * np.pi / columns
    ring = np.stack([np.outer(np.sin(polar), np.cos(turn)), np.outer(np.sin(polar), np.sin(turn))], axis=-1)
    body = np.concatenate([ring, np.broadcast_to(np.cos(polar)[:, None, None], (*ring.shape[:2], 1))], axis=-1).reshape(-1, 3)
    points = np.concatenate([[[0, 0, 1.0]], body, [[0, 0, -1.0]]])
    index = 1 + np.arange(len(body)).reshape(len(polar), columns)
    after = np.roll(index, -1, axis=1)
    a, b, c, d = index[:-1].ravel(), after[:-1].ravel(), index[1:].ravel(), after[1:].ravel()
    top = np.stack([np.zeros(columns, int), index[0], after[0]], axis=1)
    bottom = np.stack([np.full(columns, len(points) - 1), after[-1], index[-1]], axis=1)
    return points, np.concatenate([top, np.stack([a, c, b], 1), np.stack([b, c, d], 1), bottom]).astype(np.int32)


def _inner_lips(head: Template) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Right, middle and left vertex of the upper and the lower inner lip, where the lips meet."""
    v, regions = head.vertices, head.regions
    seam_y = 0.5 * (v[regions["lips_inner_upper"], 1].min() + v[regions["lips_inner_lower"], 1].max())
    half = 0.5 * np.ptp(v[regions["lips_upper"], 0])
    found = []
    for name in ("lips_inner_upper", "lips_inner_lower"):
        inner = np.flatnonzero(regions[name])
        cost = lambda x, i=inner: np.abs(v[i, 0] - x) + 0.3 * np.abs(v[i, 1] - seam_y) - 0.1 * v[i, 2]  # noqa: E731
        found.append(np.array([inner[np.argmin(cost(x))] for x in (-0.4 * half, 0.0, 0.4 * half)]))
    return found[0], found[1]
