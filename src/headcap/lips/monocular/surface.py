"""The part of a head model that a monocular tracker looks at, and its analytic derivatives by all unknowns of a frame.

Unknowns in order: turn and shift of the head in the camera's frame (3 + 3, applied on the left about the face's middle), the
jaw's rotation vector (3), expression psi (e), shape beta (s), and the logarithm of the focal length (1). Frames: vertices and
normals are in the camera's axes, metres.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.geometry.rotations import rotation_derivatives, rotation_matrices
from headcap.geometry.transforms import rigid, transform
from headcap.heads import HeadModel
from headcap.lips.monocular.medium_scale import medium_layer
from headcap.lips.monocular.person import MonocularPerson
from headcap.meshes.normals import vertex_normals
from headcap.meshes.topology import submesh

RIGID, JAW = slice(0, 6), slice(6, 9)
FIRST_EXPRESSION = 9
_JAW_JOINT = 1
_BLIND = ("mouth_interior", "eyes")
"""Regions that hide what is behind them, but whose look does not belong to the skin: eyeballs turn, teeth come and go."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """All unknowns of one frame."""

    camera_from_head: NDArray[np.float64]
    """(4, 4) rigid."""
    jaw: NDArray[np.float64]
    """(3,) rotation vector, radians."""
    expression: NDArray[np.float64]
    """psi (e,)."""
    shape: NDArray[np.float64]
    """beta (s,), coefficients of the medium-scale layer behind the model's."""
    log_focal: float = 0.0
    """Logarithm of the focal length's ratio to the given camera's."""

    @property
    def coordinates(self) -> NDArray[np.float64]:
        """All unknowns (unknowns,); the rigid motion counts from where it is, so its six are zero."""
        return np.r_[np.zeros(6), self.jaw, self.expression, self.shape, self.log_focal]

    def camera(self, given: Camera) -> Camera:
        """The given camera with this focal length, in its own axes."""
        matrix = given.matrix.copy()
        matrix[[0, 1], [0, 1]] *= np.exp(self.log_focal)
        return replace(given, matrix=matrix, camera_from_world=np.eye(4))


@dataclass(frozen=True, eq=False)
class Slopes:
    """Derivatives of a surface by p unknowns, in the camera's axes."""

    columns: NDArray[np.int64]
    """(p,) which unknowns."""
    vertices: NDArray[np.float32]
    """(p, n, 3) metres per unit."""
    normals: NDArray[np.float32]
    """(p, n, 3) of unit normals."""


class FaceSurface:
    """Face, lips, and the mouth's and eyes' inside of a head model; n vertices, m triangles."""

    def __init__(
        self,
        model: HeadModel,
        expressions: int | None = None,
        shapes: int | None = None,
        *,
        harmonics: int = 0,
        harmonic_m: float = 2e-3,
        person: MonocularPerson | None = None,
    ) -> None:
        """`expressions` and `shapes` limit how many of the leading coefficients are unknown (all by default).

        `harmonics` of the medium-scale layer (see `medium_layer`) follow the model's shapes as further shapes, three each, with
        a deviation of `harmonic_m`. Of a known `person` neither is unknown. Raises `InputError` for a model that does not tell
        where its face is, and for a person of another head model.
        """
        if "face" not in model.regions:
            raise InputError(
                f"head model {model.name} has regions {', '.join(sorted(model.regions)) or 'none'}",
                expected="a region named face",
                remedy="Load the model with its regions, or mark its face.",
            )
        blind = _joined(model, [name for name in _BLIND if name in model.regions])
        kept = model.regions["face"] | blind | _joined(model, [name for name in model.regions if name.startswith("lip")])
        self.model, (self.triangles, self.vertices) = model, submesh(model.triangles, kept[model.triangles].all(axis=1))
        """`vertices` (n,) are indices into the model's."""
        self.blind = blind[self.vertices]
        self.expressions = min(len(model.expression_basis), expressions if expressions is not None else 10**9)
        self.person, rest = person, model.vertices.astype(np.float64) if person is None else person.neutral(model)
        if person is not None:
            shapes = harmonics = 0
        self.model_shapes = min(len(model.shape_basis), shapes if shapes is not None else 10**9)
        self._mean = rest[self.vertices]
        self._expression = np.ascontiguousarray(model.expression_basis[: self.expressions, self.vertices], np.float32)
        own = np.asarray(model.shape_basis[: self.model_shapes, self.vertices], np.float32)
        self._shape = np.concatenate([own, medium_layer(self._mean, self.triangles, harmonics, harmonic_m)])
        self.shapes = len(self._shape)
        self._corrective = model.pose_basis[9 * _JAW_JOINT : 9 * _JAW_JOINT + 9, self.vertices].astype(np.float64)
        self._corrected = bool(np.any(self._corrective))
        self._jaw_weight = model.skinning_weights[self.vertices, _JAW_JOINT + 1].astype(np.float64)
        regress = model.joint_regressor[_JAW_JOINT].astype(np.float64)
        # joints are the model's: the layer beyond it moves none
        self._joint = regress @ (model.vertices if person is None else model.identity(person.shape))
        self._joint_slopes = np.zeros((self.shapes, 3))
        known = model.shape_basis[: self.model_shapes]
        self._joint_slopes[: self.model_shapes] = np.einsum("n,snc->sc", regress, known, optimize=True)
        self.number = np.full(len(model.vertices), -1)
        self.number[self.vertices] = np.arange(len(self.vertices))

    def at(self, chosen: NDArray) -> FaceSurface:
        """The same face at some of its vertices (k,) alone, in their order: without triangles, normals or a layer to tell."""
        part = copy(self)
        part.vertices, part.blind, part.triangles = self.vertices[chosen], self.blind[chosen], self.triangles[:0]
        part._mean, part._corrective, part._jaw_weight = self._mean[chosen], self._corrective[:, chosen], self._jaw_weight[chosen]
        part._expression = np.ascontiguousarray(self._expression[:, chosen])
        part._shape = np.ascontiguousarray(self._shape[:, chosen])
        return part

    def steadiness(self, jaw_rad: float, steady_m: float) -> NDArray[np.float64]:
        """(n,) 0 to 1: how well each vertex tells the head's rigid motion, whatever the face does.

        Half where expressions of unit variance, and a jaw that turns by so much, move it by `steady_m`, root mean square.
        """
        square = (self._expression.astype(np.float64) ** 2).sum(axis=(0, 2))
        square += (jaw_rad * self._jaw_weight * np.linalg.norm(self._mean - self._joint, axis=1)) ** 2
        return 1.0 / (1.0 + square / steady_m**2)

    @property
    def unknowns(self) -> int:
        """How many unknowns a frame has in all."""
        return FIRST_EXPRESSION + self.expressions + self.shapes + 1

    @property
    def expression_columns(self) -> slice:
        """Of psi among the unknowns."""
        return slice(FIRST_EXPRESSION, FIRST_EXPRESSION + self.expressions)

    @property
    def shape_columns(self) -> slice:
        """Of beta among the unknowns."""
        return slice(FIRST_EXPRESSION + self.expressions, self.unknowns - 1)

    def shape(self, estimate: Estimate) -> NDArray[np.float64]:
        """The model's shape coefficients (s,) of an estimate, or of the person that is known."""
        return estimate.shape[: self.model_shapes] if self.person is None else self.person.shape

    def layer(self, estimate: Estimate) -> NDArray[np.float32]:
        """The medium-scale layer (N, 3) of an estimate on the whole head of N vertices, metres at rest; joints stay put."""
        if self.person is not None:
            return self.person.layer
        out, chosen = np.zeros((len(self.number), 3), np.float32), slice(self.model_shapes, None)
        out[self.vertices] = np.tensordot(estimate.shape[chosen].astype(np.float32), self._shape[chosen], 1)
        return out

    def at_rest(self, camera_from_head: NDArray) -> Estimate:
        """The mean head, placed."""
        return Estimate(np.asarray(camera_from_head, float), np.zeros(3), np.zeros(self.expressions), np.zeros(self.shapes))

    def in_head(self, estimate: Estimate) -> NDArray[np.float64]:
        """Vertices (n, 3) in the head's frame."""
        rest, joint = self._rest(estimate)
        rotation = rotation_matrices(estimate.jaw)
        return rest + self._jaw_weight[:, None] * ((rest - joint) @ (rotation - np.eye(3)).T)

    def in_camera(self, estimate: Estimate) -> NDArray[np.float64]:
        """Vertices (n, 3) in the camera's axes."""
        return transform(estimate.camera_from_head, self.in_head(estimate))

    def normals(self, vertices: NDArray) -> NDArray[np.float64]:
        """Unit vertex normals (n, 3) of vertices (n, 3)."""
        return vertex_normals(vertices, self.triangles)

    def slopes(self, estimate: Estimate, *, shape: bool = False, focal: bool = False, normals: bool = True) -> Slopes:
        """Derivatives of `in_camera` and its `normals` by turn, shift, jaw and expression; by shape and focal length where asked.

        Those of normals cost most; without `normals` they are zero.

        A longer lens moves a pixel as a head that grows across the view does: that motion stands for it (exact without
        distortion).
        """
        columns = np.r_[: self.shape_columns.stop if shape else self.expression_columns.stop]
        columns = np.r_[columns, [self.unknowns - 1] if focal else []].astype(np.int64)
        out = np.empty((len(columns), len(self.vertices), 3), np.float32)
        vertices = self.in_camera(estimate)
        arms = vertices - vertices.mean(axis=0)
        for k, axis in enumerate(np.eye(3)):
            out[k], out[3 + k] = np.cross(axis, arms), axis
        head_rotation = estimate.camera_from_head[:3, :3]
        rest, joint = self._rest(estimate)
        rotation, turned = rotation_derivatives(estimate.jaw)
        local = np.eye(3) + self._jaw_weight[:, None, None] * (rotation - np.eye(3))
        for k in range(3):
            moved = self._jaw_weight[:, None] * ((rest - joint) @ turned[k].T)
            if self._corrected:
                moved += np.einsum("nij,fnj,f->ni", local, self._corrective, turned[k].ravel(), optimize=True)
            out[6 + k] = moved @ head_rotation.T
        blended = (head_rotation @ local).astype(np.float32)
        _carry(self._expression, blended, out[self.expression_columns])
        if shape:
            own = out[self.shape_columns]
            _carry(self._shape, blended, own)
            drift = self._joint_slopes @ (np.eye(3) - rotation).T @ head_rotation.T
            own += (drift[:, None] * self._jaw_weight[:, None]).astype(np.float32)
        turned_normals = np.zeros_like(out) if normals else np.broadcast_to(np.float32(0.0), out.shape)
        if focal:
            out[-1] = vertices * [1.0, 1.0, 0.0]
        if normals:
            _normal_slopes(vertices, self.triangles, out[: len(out) - focal], turned_normals)
        return Slopes(columns, out, turned_normals)

    def moved(self, estimate: Estimate, step: NDArray) -> Estimate:
        """The estimate after a step of all unknowns."""
        middle = self.in_camera(estimate).mean(axis=0)
        turn = rotation_matrices(np.asarray(step[:3], float))
        push = rigid(turn, middle - turn @ middle + step[3:6])
        return Estimate(
            push @ estimate.camera_from_head,
            estimate.jaw + step[JAW],
            estimate.expression + step[self.expression_columns],
            estimate.shape + step[self.shape_columns],
            estimate.log_focal + float(step[-1]),
        )

    def _rest(self, estimate: Estimate) -> tuple[NDArray, NDArray]:
        """Vertices (n, 3) before the jaw turns, and the jaw's joint (3,)."""
        rest = self._mean + np.tensordot(estimate.expression.astype(np.float32), self._expression, 1)
        joint = self._joint
        if self.shapes:
            rest += np.tensordot(estimate.shape.astype(np.float32), self._shape, 1)
            joint = joint + estimate.shape @ self._joint_slopes
        if self._corrected:
            rest += np.tensordot((rotation_matrices(estimate.jaw) - np.eye(3)).ravel(), self._corrective, 1)
        return rest, joint


def _joined(model: HeadModel, names: list[str]) -> NDArray[np.bool_]:
    out = np.zeros(len(model.vertices), bool)
    for name in names:
        out |= model.regions[name]
    return out


@njit(cache=True, fastmath=True)
def _carry(basis, blended, out):
    """Basis (b, n, 3) turned by each vertex's matrix (n, 3, 3) into `out`."""
    for b in range(basis.shape[0]):
        for v in range(basis.shape[1]):
            x, y, z = basis[b, v, 0], basis[b, v, 1], basis[b, v, 2]
            for i in range(3):
                out[b, v, i] = blended[v, i, 0] * x + blended[v, i, 1] * y + blended[v, i, 2] * z


@njit(cache=True, fastmath=True)
def _normal_slopes(vertices, triangles, slopes, out):
    """Derivatives of unit vertex normals from those of vertices (p, n, 3).

    With s the sum of the cross products about a vertex, dn = (1 - n n^T) ds / |s|.
    """
    n = len(vertices)
    edges = np.empty((len(triangles), 6), np.float32)
    sums = np.zeros((n, 3), np.float32)
    for f in range(len(triangles)):
        a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
        for i in range(3):
            edges[f, i] = vertices[b, i] - vertices[a, i]
            edges[f, 3 + i] = vertices[c, i] - vertices[a, i]
        ux, uy, uz, vx, vy, vz = edges[f, 0], edges[f, 1], edges[f, 2], edges[f, 3], edges[f, 4], edges[f, 5]
        for k in (a, b, c):
            sums[k, 0] += uy * vz - uz * vy
            sums[k, 1] += uz * vx - ux * vz
            sums[k, 2] += ux * vy - uy * vx
    inverse = np.empty(n, np.float32)
    for k in range(n):
        length = np.sqrt(sums[k, 0] ** 2 + sums[k, 1] ** 2 + sums[k, 2] ** 2)
        inverse[k] = 1.0 / length if length > 0.0 else 0.0
        for i in range(3):
            sums[k, i] *= inverse[k]
    for p in range(slopes.shape[0]):
        d, o = slopes[p], out[p]
        for f in range(len(triangles)):
            a, b, c = triangles[f, 0], triangles[f, 1], triangles[f, 2]
            ux, uy, uz, vx, vy, vz = edges[f, 0], edges[f, 1], edges[f, 2], edges[f, 3], edges[f, 4], edges[f, 5]
            sx, sy, sz = d[b, 0] - d[a, 0], d[b, 1] - d[a, 1], d[b, 2] - d[a, 2]
            tx, ty, tz = d[c, 0] - d[a, 0], d[c, 1] - d[a, 1], d[c, 2] - d[a, 2]
            x = sy * vz - sz * vy + uy * tz - uz * ty
            y = sz * vx - sx * vz + uz * tx - ux * tz
            z = sx * vy - sy * vx + ux * ty - uy * tx
            for k in (a, b, c):
                o[k, 0] += x
                o[k, 1] += y
                o[k, 2] += z
        for k in range(n):
            nx, ny, nz = sums[k, 0], sums[k, 1], sums[k, 2]
            along = nx * o[k, 0] + ny * o[k, 1] + nz * o[k, 2]
            o[k, 0] = (o[k, 0] - along * nx) * inverse[k]
            o[k, 1] = (o[k, 1] - along * ny) * inverse[k]
            o[k, 2] = (o[k, 2] - along * nz) * inverse[k]
