"""Growing a subject out of the generic head: identity, eyes, denser mesh, fields, look."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from headcap.meshes.normals import triangle_normals, vertex_normals
from headcap.meshes.topology import boundary_loops, submesh
from headcap.registration.register import lip_pairs
from headcap.registration.template import Template
from headcap.synthetic import identity, lips, motion
from headcap.synthetic.anatomy import Fields, Places, find_places, solve_fields
from headcap.synthetic.densify import subdivide
from headcap.synthetic.larynx import build_larynx, throat_frame
from headcap.synthetic.lighting import openness
from headcap.synthetic.parts import Part, ball_radius, eyeball, teeth
from headcap.synthetic.render import Surface
from headcap.synthetic.rig import SUBJECT_STREAM, random_stream
from headcap.synthetic.settings import SubjectSettings
from headcap.synthetic.subject import AT_REST, Subject
from headcap.synthetic.texture import EYE, MOUTH, SKIN, TOOTH, Grain, make_grain

_FOLD = (0.95, 0.86)
"""The lids' edge is folded in to these shares of its distance from the eye's centre, which closes the gap to the eyeball."""
LEAST_OPENNESS, LEAST_TOOTH_OPENNESS = 0.15, 0.6
_LIP_ZONE_M = 0.08


@dataclass(frozen=True)
class _Skin:
    """The soft part of a subject: the dense, detailed skin with the mouth's wall."""

    points: NDArray[np.float64]
    triangles: NDArray[np.int32]
    coarse_triangles: NDArray[np.int32]
    """Fewer triangles over the first of the same points."""
    in_mouth: NDArray[np.bool_]
    """(n,)."""
    follows_face: NDArray[np.float64]
    """(n,) how far a vertex follows the face's muscles, less and less inside the mouth."""
    contact: lips.LipContact
    material: NDArray[np.uint8]
    looks: tuple[NDArray[np.float32], NDArray[np.float32]]
    """(n, 7) for most takes and for lip takes."""
    fields: Fields
    rims: tuple[NDArray, ...]
    """Vertices of the left and right lids' edges."""


def grow_subject(base: Template, settings: SubjectSettings, seed: int) -> Subject:
    """A subject of the base head's kind: another identity, surface, mesh and skin; equal seeds give equal subjects."""
    random = random_stream(seed, SUBJECT_STREAM)
    head = base.with_vertices(identity.vary(base.vertices, random, settings.identity))
    places = find_places(head)
    head = head.with_vertices(identity.bare_throat(head.vertices, head.triangles, places))
    places = replace(places, larynx=place_larynx(head.vertices, places))
    head, rims = _open_eyes(head, places)
    skin = _grow_skin(head, rims, places, random, settings)
    hard = (
        eyeball(places.eye_left, places.eye_radius),
        eyeball(places.eye_right, places.eye_radius),
        teeth(places, upper=True),
        teeth(places, upper=False),
    )
    subject = _assemble(skin, hard, places, settings.larynx_prominence_mm / 1000, make_grain(seed))
    return _lit(replace(subject, landmarks=head.landmarks, inner_lips=_inner_lips(head)))


def _grow_skin(
    head: Template, rims: tuple[NDArray, ...], places: Places, random: np.random.Generator, settings: SubjectSettings
) -> _Skin:
    operator, triangles = subdivide(head.triangles, len(head.vertices))
    regions = {name: np.clip(operator @ mask.astype(float), 0, 1) for name, mask in head.regions.items()}
    relief = (1 - regions["mouth_interior"]) * (1 - 0.5 * regions["lips_upper"] - 0.5 * regions["lips_lower"])
    points = identity.add_detail(operator @ head.vertices, triangles, relief, random, settings.detail_mm / 1000)
    fields, pairs = solve_fields(head, places).mapped(operator), lip_pairs(head)
    above, below = fields.upper_lip > fields.lower_lip, fields.lower_lip > fields.upper_lip
    points = lips.close_lips(points, pairs, above, below)
    sides = [regions[f"lips_{side}"] + regions[f"lips_inner_{side}"] > 0.01 for side in ("upper", "lower")]
    inside = regions["mouth_interior"] + regions["lips_inner_upper"] + regions["lips_inner_lower"] > 0.01
    look = identity.skin_look(points, regions, places, random, tattoos=settings.tattoos)
    lips_look = identity.tattoo_lips(look, points, regions, places) if settings.tattoos else look
    wall = np.tile(head.regions["mouth_interior"][head.triangles].all(1), 4)
    return _Skin(
        points=points,
        triangles=triangles,
        coarse_triangles=head.triangles,
        in_mouth=regions["mouth_interior"] > 0.5,
        material=np.where(wall, MOUTH, SKIN).astype(np.uint8),
        looks=(look, lips_look),
        follows_face=lips.follows_face(points, pairs, inside),
        contact=lips.build_contact(points, pairs, *sides),
        fields=fields,
        rims=rims,
    )


def _assemble(skin: _Skin, hard: tuple[Part, ...], places: Places, prominence_m: float, grain: Grain) -> Subject:
    """Skin and hard parts in one mesh; eyeballs first among the parts."""
    starts = len(skin.points) + np.cumsum([0] + [len(part.points) for part in hard])
    points = np.concatenate([skin.points, *(part.points for part in hard)])
    moved = [part.triangles + start for part, start in zip(hard, starts, strict=False)]
    triangles = np.concatenate([skin.triangles, *moved]).astype(np.int32)
    material = np.concatenate([skin.material, *(np.full(len(p.triangles), p.material, np.uint8) for p in hard)])
    fields = _with_parts(skin.fields, hard)
    is_skin = np.arange(len(points)) < len(skin.points)
    outer = is_skin & ~np.pad(skin.in_mouth, (0, len(points) - len(skin.points)), constant_values=True)
    surface, lips_surface = (_surface(points, triangles, material, look, hard) for look in skin.looks)
    balls = ((places.eye_left, places.eye_right), (ball_radius(places.eye_radius),) * 2)
    in_front = points[triangles].mean(1)[:, 2] > places.eye_left[2]
    return Subject(
        bare_m=points,
        surface=surface,
        lips_surface=lips_surface,
        occluder=np.concatenate([skin.coarse_triangles, *moved]).astype(np.int32),
        openness=np.ones(len(points)),
        grain=grain,
        places=places,
        fields=fields,
        larynx=build_larynx(points, outer, places, prominence_m),
        pulls=motion.build_pulls(points, np.pad(skin.follows_face, (0, len(points) - len(skin.points))), places),
        contact=skin.contact,
        lids=tuple(motion.build_lids(points, is_skin, rim, c, r) for rim, c, r in zip(skin.rims, *balls, strict=True)),
        eyes=tuple(np.arange(starts[k], starts[k + 1]) for k in range(2)),
        lip_zone=np.flatnonzero(is_skin & (np.linalg.norm(points - places.mouth, axis=1) < _LIP_ZONE_M)),
        jaw_zone=np.flatnonzero((fields.jaw > 1e-3) | (fields.upper_lip > 1e-3)),
        outside=(material == SKIN) | ((material == EYE) & in_front),
    )


def _with_parts(fields: Fields, hard: tuple[Part, ...]) -> Fields:
    """Fields of skin and parts: a part goes all the way with the head, and with the jaw or not."""

    def joined(field: NDArray, shares: list[float]) -> NDArray:
        """A field of the skin continued by each part's share."""
        return np.concatenate([field, *(np.full(len(part.points), share) for part, share in zip(hard, shares, strict=True))])

    nowhere = [0.0] * len(hard)
    return Fields(
        joined(fields.head, [1.0] * len(hard)),
        joined(fields.jaw, [part.jaw for part in hard]),
        joined(fields.upper_lip, nowhere),
        joined(fields.lower_lip, nowhere),
    )


def _surface(points: NDArray, triangles: NDArray, material: NDArray, look: NDArray, hard: tuple[Part, ...]) -> Surface:
    area_mm2 = 0.5e6 * np.linalg.norm(triangle_normals(points, triangles), axis=1)
    whole = np.concatenate([look, *(part.look for part in hard)]).astype(np.float32)
    return Surface(triangles, material, whole, area_mm2.astype(np.float32))


def _lit(subject: Subject) -> Subject:
    """The subject with the sky that each of its vertices sees."""
    rest = subject.vertices(AT_REST)
    normals = vertex_normals(rest, subject.surface.triangles)
    # what is shut away at rest, the mouth and the eyeballs' backs, sees something of the room once it opens
    least = np.full(len(rest), LEAST_OPENNESS)
    least[subject.surface.triangles[subject.surface.material == TOOTH]] = LEAST_TOOTH_OPENNESS
    return replace(subject, openness=np.maximum(openness(rest, normals, subject.occluder), least))


def place_larynx(points_m: NDArray, places: Places) -> NDArray[np.float64]:
    """The larynx's place on the bare throat."""
    near = np.abs(points_m - places.larynx) @ [2.0, 1.0, 0.0] + 10 * (np.abs(points_m[:, 2] - places.larynx[2]) > 0.03)
    outward, _ = throat_frame(points_m, places)
    found = points_m[np.argmin(near)]
    return places.larynx + outward * float((found - places.larynx) @ outward)


def _open_eyes(head: Template, places: Places) -> tuple[Template, tuple[NDArray, ...]]:
    """The head with its eyes cut out along the lids' rims, the rims folded in; rims left then right, outermost vertices."""
    keep = ~head.regions["eyes"][head.triangles].any(1)
    triangles, used = submesh(head.triangles, keep)
    points = head.vertices[used]
    new_index = {int(old): new for new, old in enumerate(used)}
    centres = (places.eye_left, places.eye_right)
    loops = [loop for loop in boundary_loops(triangles) if len(loop) > 8]
    rims = tuple(min(loops, key=lambda loop, c=centre: np.linalg.norm(points[loop].mean(0) - c)) for centre in centres)
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


def _inner_lips(head: Template) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Right, middle and left vertex of the upper and the lower rim, where the lips meet: pairs that lie on each other."""
    pairs = lip_pairs(head)
    x = head.vertices[pairs, 0].mean(1)
    chosen = [int(np.argmin(np.abs(x - place))) for place in (0.4 * x[0], 0.0, 0.4 * x[-1])]
    return pairs[chosen, 0], pairs[chosen, 1]
