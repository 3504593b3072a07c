"""Hand-made shapes of another topology, or of another face, brought onto the neutral face of a performance.

The paper's animator sculpts on the captured person's face in its topology (section 3: one v^0). Studios have a rig of their own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial import cKDTree

from headcap.errors import InputError
from headcap.expressions.basis import ExpressionBasis
from headcap.expressions.basis_checks import flat_shapes
from headcap.geometry.transforms import fit_similarity, transform
from headcap.meshes.deformation_transfer import DeformationTransfer
from headcap.meshes.extension import SmoothExtension
from headcap.meshes.topology import same_triangles, vertex_adjacency
from headcap.registration.face_correspondence import FaceCorrespondenceSettings, NeutralFace, correspond

Topology = Literal["same", "reordered", "other"]
_STILL_SHARE = 0.05
"""Of the vertices: those that all shapes together move least hold the face where it is."""


class BasisRegistrationSettings(BaseModel):
    """How shapes are brought onto another neutral face."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    carry: Literal["gradients", "displacements"] = Field(
        "gradients",
        description="What of a shape is carried over to another person's face: how it deforms the surface (deformation "
        "transfer), or how far it moves each vertex, turned and scaled with the face as a whole",
    )
    same_face_mm: float = Field(
        0.1, ge=0, description="Neutral faces that a similarity brings together to this (root mean square) are one face"
    )
    correspondence: FaceCorrespondenceSettings = FaceCorrespondenceSettings()


@dataclass(frozen=True, eq=False)
class RegisteredBasis:
    """Shapes on a performance's neutral face, and how they came there."""

    basis: ExpressionBasis
    topology: Topology
    """Of the shapes beside the neutral face's."""
    figures: dict[str, float]
    """`neutral_rms_mm` between the neutral faces after a similarity, and its `scale`; of another topology `distance_median_mm`,
    `distance_p95_mm` and `matched_share`, as `correspond` tells them."""


@dataclass(frozen=True, eq=False)
class _Laid:
    """A basis in the onto-topology, on its own face still."""

    rest: NDArray[np.float64]
    shapes: NDArray[np.float64]
    topology: Topology
    figures: dict[str, float]


def registered(
    basis: ExpressionBasis,
    onto_neutral: NDArray,
    onto_triangles: NDArray,
    *,
    landmarks: Mapping[str, int] | None = None,
    onto_landmarks: Mapping[str, int] | None = None,
    skin: NDArray[np.bool_] | None = None,
    onto_skin: NDArray[np.bool_] | None = None,
    settings: BasisRegistrationSettings | None = None,
) -> RegisteredBasis:
    """The shapes of a basis on a neutral face (n, 3), metres, of the triangles (m, 3), vertex for vertex.

    1. The same topology is recognised, also where a program has numbered the vertices anew. Otherwise both faces need
    landmarks, vertex numbers by name, four in common at least, and dense correspondence is found
    (`registration.face_correspondence`), for which `skin` masks say what the other face may have too; what of this face has no
    counterpart follows its surroundings smoothly and fades to rest. 2. If a similarity brings the neutral faces together,
    shapes are turned and scaled with it. Otherwise it is another person's face, and each shape deforms it as it deformed its
    own (Sumner & Popovic 2004), or as `settings` say. Raises `InputError` for points without triangles, missing landmarks,
    shapes that move nothing which this face has, and as `correspond` and `DeformationTransfer`.
    """
    settings = settings or BasisRegistrationSettings()
    onto_neutral, onto_triangles = np.asarray(onto_neutral, np.float64), np.asarray(onto_triangles, np.int32)
    if not len(onto_triangles) or not len(basis.triangles):
        raise InputError(
            "a neutral face without triangles", expected="meshes on both sides", remedy="Tie markers to a mesh, and use that."
        )
    laid = _of_known_topology(basis, onto_neutral, onto_triangles)
    if laid is None:
        own = _face(basis.neutral, basis.triangles, landmarks, skin, f"the shapes ({len(basis.neutral)} vertices)")
        onto = _face(onto_neutral, onto_triangles, onto_landmarks, onto_skin, f"the performance ({len(onto_neutral)} vertices)")
        laid = _of_other_topology(basis, own, onto, settings.correspondence)
    placement, scale = fit_similarity(laid.rest, onto_neutral)
    apart = transform(placement, scale * laid.rest) - onto_neutral
    rms_mm = 1e3 * float(np.sqrt(np.square(apart).sum(axis=1).mean()))
    if settings.carry == "displacements" or rms_mm <= settings.same_face_mm:
        shapes = scale * laid.shapes @ placement[:3, :3].T
    else:
        transfer = DeformationTransfer(laid.rest, onto_neutral, onto_triangles, _still(laid.shapes))
        shapes = np.stack([transfer(laid.rest + shape) for shape in laid.shapes]) - transfer(laid.rest)
    figures = {"neutral_rms_mm": rms_mm, "scale": float(scale), **laid.figures}
    out = ExpressionBasis(basis.names, onto_neutral, shapes, onto_triangles)
    for error in flat_shapes(out):
        raise error
    return RegisteredBasis(out, laid.topology, figures)


def _of_known_topology(basis: ExpressionBasis, neutral: NDArray, triangles: NDArray) -> _Laid | None:
    if basis.neutral.shape != neutral.shape:
        return None
    rest, shapes = basis.neutral.astype(np.float64), basis.displacements.astype(np.float64)
    if same_triangles(basis.triangles, triangles):
        return _Laid(rest, shapes, "same", {})
    order = _renumbering(rest, basis.triangles, neutral, triangles)
    return None if order is None else _Laid(rest[order], shapes[:, order], "reordered", {})


def _renumbering(rest: NDArray, triangles: NDArray, neutral: NDArray, onto_triangles: NDArray) -> NDArray[np.int64] | None:
    """(n,) the basis' vertex at each place of a neutral face (n, 3) that is the same, numbered anew; None where it is not.

    Vertices at one place, as those of closed lips, are told apart by where their neighbours lie. Both faces must be placed alike.
    """
    near = 1e-4 * float(np.ptp(neutral, axis=0).max())
    own, theirs = (np.hstack([v, _neighbourhood(v, t)]) for v, t in ((rest, triangles), (neutral, onto_triangles)))
    _, order = cKDTree(own).query(theirs)
    if len(np.unique(order)) < len(order) or np.linalg.norm(rest[order] - neutral, axis=1).max() > near:
        return None
    number = np.argsort(order)
    return order if same_triangles(number[triangles].astype(np.int32), onto_triangles) else None


def _neighbourhood(vertices: NDArray, triangles: NDArray) -> NDArray[np.float64]:
    """(n, 3) mean place of each vertex's neighbours."""
    adjacency = vertex_adjacency(triangles, len(vertices)).astype(np.float64)
    count = np.asarray(adjacency.sum(axis=1)).ravel()
    return (adjacency @ vertices) / np.maximum(count, 1.0)[:, None]


def _face(
    vertices: NDArray, triangles: NDArray, landmarks: Mapping[str, int] | None, skin: NDArray | None, of: str
) -> NeutralFace:
    if not landmarks:
        raise InputError(
            f"no landmarks on {of}",
            expected="vertex numbers by name on both faces, since their topologies differ",
            remedy="Name corners of eyes and mouth, tip of the nose, chin.",
        )
    vertices = np.asarray(vertices, np.float64)
    beyond = [name for name, vertex in landmarks.items() if not 0 <= vertex < len(vertices)]
    if beyond:
        raise InputError(f"landmark {beyond[0]} on {of}", expected="one of its vertices", remedy="Count vertices from zero.")
    return NeutralFace(vertices, triangles, {name: vertices[vertex] for name, vertex in landmarks.items()}, skin)


def _of_other_topology(
    basis: ExpressionBasis, own: NeutralFace, onto: NeutralFace, settings: FaceCorrespondenceSettings
) -> _Laid:
    found = correspond(onto, own, settings)
    known = np.flatnonzero(found.matched)
    rest = own.vertices
    shapes = np.zeros((len(basis), len(onto.vertices), 3))
    at_rest = found.carry(rest, known)
    for shape, displacement in zip(shapes, basis.displacements, strict=True):
        shape[known] = found.carry(rest + displacement, known) - at_rest
    if not found.matched.all():
        shapes = SmoothExtension(found.registered, onto.triangles, found.matched)(shapes)
    return _Laid(found.registered, shapes, "other", found.figures)


def _still(shapes: NDArray) -> NDArray[np.bool_]:
    """(n,) what all shapes (k, n, 3) leave most alone."""
    farthest = np.square(shapes).sum(axis=2).max(axis=0)
    return farthest <= np.quantile(farthest, _STILL_SHARE)
