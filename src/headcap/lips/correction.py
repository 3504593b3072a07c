"""The correction layer: what a base tracker's mouth lacks, in nine numbers per triangle (lip paper, section 4.2, eq. 1).

Frames are canonical: metres in the head's frame (y up, z out of the face), rigid motion removed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import sparse

from headcap.errors import InputError
from headcap.geometry.transforms import fit_rigid, fit_similarity, transform
from headcap.lips.mouth import Mouth
from headcap.lips.triangle_parameters import PARAMETERS, compose, decompose
from headcap.meshes.laplacian import Factor
from headcap.registration.face_correspondence import Correspondence

Identity = Literal["corrected", "kept"]

_ROUNDS, _ROBUST_M = 5, 1e-3
"""Rounds of reweighting of rigid motion, and the residual at which a vertex counts a quarter: brows and lids move."""
_LEAST_AREA = 1e-9
"""Triangles below this share of the mean area have no deformation that could be told."""


@dataclass(frozen=True, eq=False)
class CanonicalMeshes:
    """Meshes without their rigid motion."""

    meshes: NDArray[np.float64]
    """(f, n, 3) metres, canonical frame."""
    world_from_canonical: NDArray[np.float64]
    """(f, 4, 4) rigid."""

    def world(self, meshes: NDArray) -> NDArray[np.float64]:
        """Canonical meshes (f, n, 3) of the same frames where the head was."""
        rotation, shift = self.world_from_canonical[:, :3, :3], self.world_from_canonical[:, :3, 3]
        return meshes @ np.swapaxes(rotation, 1, 2) + shift[:, None]


def canonical_meshes(meshes: NDArray, neutral: NDArray, steady: NDArray) -> CanonicalMeshes:
    """Meshes (f, n, 3), metres, moved rigidly onto a canonical neutral head (n, 3) where it holds still.

    A robust fit (Geman & McClure's weights) on the vertices `steady` (s,). Any rigid motion of a mesh leaves its canonical form
    as it is. Frames that are not finite stay so.
    """
    meshes = np.asarray(meshes, np.float64)
    _check_meshes(meshes, neutral)
    placements = np.stack([_robust_rigid(mesh[steady], neutral[steady]) for mesh in meshes]) if len(meshes) else _NO_PLACES
    rotation, shift = placements[:, :3, :3], placements[:, :3, 3]
    return CanonicalMeshes((meshes - shift[:, None]) @ rotation, placements)


@dataclass(frozen=True, eq=False)
class TrueNeutral:
    """A person's true neutral head H_0, and where on it lies the skin of the base tracker's C_0 (section 4.1).

    Two reconstructions of one person need not put a forehead's vertex at the same place of the skin, even in one topology: where
    the skin shows nothing a tracker leaves it to its model. What is compared must not be turned and shifted by that.
    """

    vertices: NDArray[np.float64]
    """(n, 3) metres, any frame."""
    skin: NDArray[np.int64]
    """(k,) vertices of C_0 by which the two are laid on each other."""
    places: NDArray[np.float64]
    """(k, 3) where they lie on H_0."""

    @classmethod
    def of(cls, given: NDArray | TrueNeutral, steady: NDArray) -> TrueNeutral:
        """Of vertices (n, 3) whose numbers mean the same places as C_0's do, laid on it by those that hold still."""
        if isinstance(given, TrueNeutral):
            return given
        vertices = np.asarray(given, np.float64)
        return cls(vertices, np.asarray(steady), vertices[steady])

    def placement(self, base_neutral: NDArray) -> tuple[NDArray[np.float64], float]:
        """The similarity, rigid part (4, 4) and scale, that brings H_0 onto C_0 (n, 3)."""
        return fit_similarity(self.places, base_neutral[self.skin])


@dataclass(frozen=True, eq=False)
class CorrectionLayer:
    """The layer of one person (or one sequence) whose base-tracked neutral mesh is the anchor, frame f = 0 of the paper.

    `identity` says what D_0 of eq. 1 is: "corrected" takes C_0 -> H_0 as it stands (the paper), so that the layer also mends the
    neutral mouth that the base tracker believes in; "kept" takes the identity, so that the layer carries the difference in
    expression alone onto the base tracker's own neutral, which is all that can be known of a person who was never in the rig.
    """

    mouth: Mouth
    base_neutral: NDArray[np.float64]
    """C_0 (n, 3) metres, canonical."""
    identity: Identity = "corrected"

    def __post_init__(self) -> None:
        object.__setattr__(self, "base_neutral", np.ascontiguousarray(self.base_neutral, np.float64))
        expected = int(self.mouth.triangles.max()) + 1
        if self.base_neutral.ndim != 2 or self.base_neutral.shape[0] < expected or self.base_neutral.shape[1:] != (3,):
            raise _other_topology(self.base_neutral.shape, expected)
        area = _areas(self.base_neutral, self.mouth.triangles[self.mouth.patch])
        flat = ~(area > _LEAST_AREA * area.mean())
        if flat.any():
            raise InputError(
                f"{flat.sum()} triangles about the neutral mouth have no area",
                expected="none",
                remedy="Anchor the layer at a frame whose mouth is at rest and was tracked.",
            )

    # -- eq. 1 ------------------------------------------------------------------------------------------------------------------

    def parameters(
        self,
        base: NDArray,
        truth_neutral: NDArray | TrueNeutral,
        truth: NDArray,
        correspondence: Correspondence | None = None,
    ) -> NDArray[np.float32]:
        """l_f of eq. 1 (f, T, 9) between base-tracked (f, n, 3) and true meshes (f, N, 3); radians and strains.

        G_f = H_f D_0 C_f^-1 with H_f: H_0 -> H_f, C_f: C_0 -> C_f the deformation gradients of each triangle with its normal as
        fourth vertex (Sumner & Popovic 2004, eq. 2 to 4). Base meshes are canonical (`canonical_meshes` onto C_0), true ones in
        any frame: H_0 is brought onto C_0 by a similarity, for one camera cannot tell how large a head is, and H_f onto H_0 by
        rigid motion. True meshes of another topology come with their `correspondence` (section 4.1): H_f is then that of the
        triangle that corresponds, and D_0 goes from C_0 to its registration onto H_0. Frames that are not finite give NaN. Raises
        `InputError` for another topology or numbers of frames.
        """
        base, truth = np.asarray(base), np.asarray(truth)
        _check_meshes(base, self.base_neutral)
        if len(base) != len(truth):
            raise InputError(
                f"{len(base)} base-tracked and {len(truth)} true meshes", expected="one each per frame", remedy="Pair the frames."
            )
        fine = _TrueMotion(self, truth_neutral, correspondence)
        _check_meshes(truth, fine.anchor)
        corners = self.mouth.triangles[self.mouth.layer]
        out = np.empty((len(base), len(corners), PARAMETERS), np.float32)
        gradients, numbers = np.empty((len(corners), 3, 3)), np.empty((len(corners), PARAMETERS))
        for row, coarse, true in zip(out, base, truth, strict=True):
            source = np.ascontiguousarray(coarse, np.float64)
            _gradients(source, corners, fine.canonical(true), fine.corners, fine.between, gradients)
            decompose(gradients, numbers)
            row[:] = numbers
        return out

    def corrected(self, base: NDArray, parameters: NDArray) -> NDArray[np.float64]:
        """Meshes (f, n, 3) of base-tracked ones (f, n, 3), canonical, with the layer (f, T, 9) put in.

        Deformation transfer: the vertices of the patch about the mouth minimise the sum over its triangles of weight x area x
        |S - G C|^2, G the layer's gradient (none outside of it), C of C_0 -> C_f; weights are `Mouth.weights`. Edges of C_f are
        carried, distances are weighed by C_0, so one Cholesky factor serves all frames; what lies about the patch stays as it
        was tracked. Frames with NaN stay NaN there.
        """
        base, parameters = np.asarray(base, np.float64), np.asarray(parameters)
        _check_meshes(base, self.base_neutral)
        wanted = (len(base), len(self.mouth.layer), PARAMETERS)
        if parameters.shape != wanted:
            raise InputError(f"a layer of {parameters.shape}", expected=f"{wanted}", remedy="Use the mask it was learnt with.")
        out, patch = base.copy(), self._patch
        gradients = np.empty((len(self.mouth.layer), 3, 3))
        for mesh, numbers in zip(out, parameters, strict=True):
            compose(self.mouth.fade[:, None] * numbers, gradients)
            right = np.zeros((len(patch.free) + len(patch.rim), 3))
            _carried_edges(mesh, patch.corners, patch.local, patch.layer_of, patch.cotangents, gradients, right)
            inner = right[: len(patch.free)] - patch.border @ mesh[patch.rim]
            mesh[patch.free] = patch.factor.solve(inner)
        return out

    def drawn(self, corrected: NDArray, held: Sequence[HeldPlaces | None]) -> NDArray[np.float64]:
        """Canonical meshes (f, n, 3) that `corrected` gave, drawn to places that a picture shows (section 8, future work).

        The minimisers of the same sum plus `HeldPlaces.weight` x squared distances across the view. With the factor K of the sum
        alone and rows A that take the places off the vertices, x + K^-1 A^T (W^-1 + A K^-1 A^T)^-1 (t - A x): a small system per
        frame, whichever places each holds. Raises `InputError` for another number of frames or topology.
        """
        corrected = np.asarray(corrected, np.float64)
        _check_meshes(corrected, self.base_neutral)
        if len(held) != len(corrected):
            raise InputError(
                f"places held in {len(held)} frames", expected=f"{len(corrected)}", remedy="Give None for frames without."
            )
        out = corrected.copy()
        for mesh, places in zip(out, held, strict=True):
            if places is not None and len(places.share):
                self._patch.draw(mesh, places)
        return out

    @cached_property
    def _patch(self) -> _Patch:
        return _Patch(self.base_neutral, self.mouth)


@dataclass(frozen=True, eq=False)
class HeldPlaces:
    """Where k places of one mesh belong, seen along the head's z axis."""

    edges: NDArray[np.int64]
    """(k, 2) vertices; the places lie on edges of the patch."""
    share: NDArray[np.float64]
    """(k,) how far along."""
    targets: NDArray[np.float64]
    """(k, 2) x, y metres, canonical; a coordinate that is NaN is free."""
    weight: NDArray[np.float64]
    """(k,) of a squared distance, beside strains: the collar's stiffness against a shift of the mouth is about five."""

    def joined(self, other: HeldPlaces) -> HeldPlaces:
        """Both together."""
        names = ("edges", "share", "targets", "weight")
        return HeldPlaces(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in names))


class _TrueMotion:
    """H_0 and H_f of eq. 1 about a layer's triangles, in the layer's topology or in one that corresponds to it."""

    def __init__(
        self, layer: CorrectionLayer, truth_neutral: NDArray | TrueNeutral, correspondence: Correspondence | None
    ) -> None:
        self.mouth, self.correspondence = layer.mouth, correspondence
        coarse = layer.mouth.triangles[layer.mouth.layer]
        steady = layer.mouth.steady
        if correspondence is None:
            true = TrueNeutral.of(truth_neutral, steady)
            self.corners, registered = coarse, true.vertices
        else:
            self.corners = correspondence.rig_triangles[correspondence.of_triangle[layer.mouth.layer]]
            vertices = np.asarray(truth_neutral, np.float64)
            registered = correspondence.carry(vertices)
            true = TrueNeutral(vertices, steady, registered[steady])
        placement, self.unit = true.placement(layer.base_neutral)
        self.anchor = transform(placement, self.unit * true.vertices)
        placed = transform(placement, self.unit * registered)
        self.steady = placed[steady]
        # V_H0^-1 D_0 V_C0: what stands between the frames of a true and the inverse of a base triangle
        identity = placed if layer.identity == "corrected" else layer.base_neutral
        self.between = np.linalg.inv(triangle_frames(self.anchor, self.corners)) @ triangle_frames(identity, coarse)

    def canonical(self, mesh: NDArray) -> NDArray[np.float64]:
        """A true mesh (N, 3) moved rigidly onto H_0."""
        mesh = self.unit * np.asarray(mesh, np.float64)
        steady = self.mouth.steady
        points = mesh[steady] if self.correspondence is None else self.correspondence.carry(mesh, steady)
        placement = _robust_rigid(points, self.steady)
        return np.ascontiguousarray((mesh - placement[:3, 3]) @ placement[:3, :3])


class _Patch:
    """The skin that gives way, numbered free vertices first, and the factor of its Laplacian."""

    def __init__(self, neutral: NDArray, mouth: Mouth) -> None:
        self.corners = np.ascontiguousarray(mouth.triangles[mouth.patch])
        used = np.unique(self.corners)
        count = np.bincount(mouth.triangles.ravel(), minlength=len(neutral))
        fixed = np.bincount(self.corners.ravel(), minlength=len(neutral)) < count
        self.free, self.rim = used[~fixed[used]], used[fixed[used]]
        number = np.zeros(len(neutral), np.int32)
        number[self.free] = np.arange(len(self.free))
        number[self.rim] = len(self.free) + np.arange(len(self.rim))
        self.local = number[self.corners]
        self.layer_of = np.full(len(mouth.triangles), -1, np.int64)
        self.layer_of[mouth.layer] = np.arange(len(mouth.layer))
        self.layer_of = self.layer_of[mouth.patch]
        self.cotangents = mouth.weights[:, None] * _cotangents(neutral, self.corners)
        laplacian = _laplacian(self.local, self.cotangents, len(used))
        inner = slice(0, len(self.free))
        self.border = sparse.csr_array(laplacian[inner, len(self.free) :])
        self.factor, self._number = Factor(laplacian[inner, inner]), number

    def draw(self, mesh: NDArray, places: HeldPlaces) -> None:
        """Move the free vertices of a mesh (n, 3) to the constrained minimum, see `CorrectionLayer.drawn`."""
        count = len(places.share)
        rows = np.repeat(np.arange(count), 2)
        values = np.stack([1 - places.share, places.share], axis=1).ravel()
        off = sparse.csr_array((values, (rows, self._number[places.edges].ravel())), shape=(count, len(self.free)))
        reach = self.factor.solve(off.T.toarray())
        between = off @ reach
        for axis in range(2):
            known = np.isfinite(places.targets[:, axis])
            away = (places.targets[:, axis] - off @ mesh[self.free, axis])[known]
            stiff = between[np.ix_(known, known)] + np.diag(1 / places.weight[known])
            mesh[self.free, axis] += reach[:, known] @ np.linalg.solve(stiff, away)


def canonical_truth(
    truth_neutral: NDArray | TrueNeutral, base_neutral: NDArray, steady: NDArray
) -> tuple[NDArray[np.float64], float]:
    """H_0 (n, 3) brought onto C_0 (n, 3) by a similarity, and its scale; vertices alone by those of them that hold still (s,)."""
    true = TrueNeutral.of(truth_neutral, steady)
    _check_meshes(true.vertices[None], base_neutral)
    placement, scale = true.placement(base_neutral)
    return transform(placement, scale * true.vertices), scale


def triangle_frames(vertices: NDArray, corners: NDArray) -> NDArray[np.float64]:
    """V (T, 3, 3) of triangles (T, 3): two edges and the normal n / sqrt(|n|) as columns (Sumner & Popovic 2004, eq. 1 to 3)."""
    frames = np.empty((len(corners), 3, 3))
    _frames(np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(corners, np.int32), frames)
    return frames


_NO_PLACES = np.zeros((0, 4, 4))


def _robust_rigid(points: NDArray, neutral: NDArray) -> NDArray[np.float64]:
    """world_from_canonical (4, 4) of points (s, 3) that were at `neutral` (s, 3)."""
    if not np.isfinite(points).all():
        return np.full((4, 4), np.nan)
    placement = fit_rigid(neutral, points)
    for _ in range(_ROUNDS):
        squared = ((transform(placement, neutral) - points) ** 2).sum(axis=1)
        placement = fit_rigid(neutral, points, 1.0 / (1.0 + squared / _ROBUST_M**2) ** 2)
    return placement


def _check_meshes(meshes: NDArray, neutral: NDArray) -> None:
    if meshes.ndim != 3 or meshes.shape[1:] != neutral.shape:
        raise _other_topology(meshes.shape[1:], len(neutral))


def _other_topology(shape: tuple[int, ...], vertices: int) -> InputError:
    return InputError(
        f"meshes of {shape}", expected=f"({vertices}, 3)", remedy="Bring base and true meshes to the topology of one head model."
    )


def _areas(vertices: NDArray, corners: NDArray) -> NDArray[np.float64]:
    a, b, c = (vertices[corners[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1)


def _cotangents(vertices: NDArray, corners: NDArray) -> NDArray[np.float64]:
    """(p, 3) half the cotangent of the angle at each corner."""
    points = vertices[corners]
    sides = [(points[:, (k + 1) % 3] - points[:, k], points[:, (k + 2) % 3] - points[:, k]) for k in range(3)]
    return 0.5 * np.stack([np.einsum("ni,ni->n", a, b) for a, b in sides], axis=1) / _areas(vertices, corners)[:, None]


def _laplacian(corners: NDArray, cotangents: NDArray, n: int) -> sparse.csr_array:
    rows = np.concatenate([corners[:, (k + 1) % 3] for k in range(3)])
    columns = np.concatenate([corners[:, (k + 2) % 3] for k in range(3)])
    off = sparse.csr_array((cotangents.T.ravel(), (rows, columns)), shape=(n, n))
    off = off + off.T
    return sparse.csr_array(sparse.diags_array(off.sum(axis=1)) - off)


@njit(cache=True)
def _frame(vertices, corners, out):
    a, b, c = corners
    for i in range(3):
        out[i, 0], out[i, 1] = vertices[b, i] - vertices[a, i], vertices[c, i] - vertices[a, i]
    length = 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i, 2] = out[j, 0] * out[k, 1] - out[k, 0] * out[j, 1]
        length += out[i, 2] ** 2
    if length > 0.0:
        out[:, 2] /= length**0.25


@njit(cache=True)
def _frames(vertices, corners, out):
    for t in range(len(corners)):
        _frame(vertices, corners[t], out[t])


@njit(cache=True)
def _gradients(coarse, corners, fine, fine_corners, between, out):
    """G = V_Hf (V_H0^-1 D_0 V_C0) V_Cf^-1 of every triangle; NaN where C_f has no area."""
    source, inverse, target, middle = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for t in range(len(corners)):
        _frame(coarse, corners[t], source)
        _frame(fine, fine_corners[t], target)
        for i in range(3):
            for j in range(3):
                a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
                inverse[j, i] = source[a, c] * source[b, d] - source[a, d] * source[b, c]
        determinant = source[0, 0] * inverse[0, 0] + source[0, 1] * inverse[1, 0] + source[0, 2] * inverse[2, 0]
        if not determinant > 0.0:
            out[t] = np.nan
            continue
        for i in range(3):
            for j in range(3):
                middle[i, j] = (
                    between[t, i, 0] * inverse[0, j] + between[t, i, 1] * inverse[1, j] + between[t, i, 2] * inverse[2, j]
                )
        for i in range(3):
            for j in range(3):
                total = target[i, 0] * middle[0, j] + target[i, 1] * middle[1, j] + target[i, 2] * middle[2, j]
                out[t, i, j] = total / determinant


@njit(cache=True)
def _carried_edges(mesh, corners, local, layer_of, cotangents, gradients, right):
    """Right-hand side of the Poisson equation: edges of the base mesh, turned and stretched by the layer."""
    edge = np.empty((3, 3))
    for t in range(len(corners)):
        for k in range(3):
            # the edge across from corner k
            start, end = corners[t, (k + 1) % 3], corners[t, (k + 2) % 3]
            for i in range(3):
                edge[k, i] = mesh[end, i] - mesh[start, i]
        row = layer_of[t]
        for k in range(3):
            start, end, weight = local[t, (k + 1) % 3], local[t, (k + 2) % 3], cotangents[t, k]
            for i in range(3):
                value = edge[k, i]
                if row >= 0:
                    g = gradients[row, i]
                    value = g[0] * edge[k, 0] + g[1] * edge[k, 1] + g[2] * edge[k, 2]
                right[start, i] -= weight * value
                right[end, i] += weight * value
