"""The head model of the neck paper, section 3: identity, expression, pose correctives, speech, and skinning about two joints.

The model is stateless and immutable: every stage is a function of what it is given, of any batch shape, and a changed model is
another model. Frame of the head: metres, y up, z out of the face. The larynx (eq. 1, 2) belongs to the room `neck` and enters
as a `RestOffset`.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_arrays, save_arrays
from headcap.errors import InputError
from headcap.geometry.rotations import rotation_derivatives
from headcap.heads.skinning import (
    JOINTS,
    bone_derivatives,
    bone_transforms,
    pose_features,
    skin,
    unskin,
    vertex_transforms,
)
from headcap.meshes.subdivision import Subdivision
from headcap.meshes.topology import submesh
from headcap.registration.template import Template

KIND, SCHEMA = "head_model", 1
BASES = ("shape_basis", "expression_basis", "pose_basis", "speech_basis")
POSE_FEATURES = 9 * len(JOINTS)
_BLOCK = 64
"""Frames per matrix product: larger ones gain nothing and leave the cache."""


@dataclass(frozen=True)
class HeadCoefficients:
    """What poses and shapes a head; each of any batch shape (...) that broadcasts against the others, None for zero.

    A vector may be shorter than its basis: the rest is zero.
    """

    shape: NDArray | None = None
    """beta (..., s), weights of the shape basis."""
    expression: NDArray | None = None
    """psi (..., e)."""
    pose: NDArray | None = None
    """theta (..., 2, 3), rotation vectors of neck and jaw, radians."""
    speech: NDArray | None = None
    """phi (..., p)."""
    placement: NDArray | None = None
    """world_from_head (..., 4, 4), rigid."""

    def arrays(self) -> tuple[NDArray | None, ...]:
        """Shape, expression, pose, speech, placement."""
        return self.shape, self.expression, self.pose, self.speech, self.placement

    def frames(self, chosen: slice) -> HeadCoefficients:
        """Some frames of coefficients whose batch has one axis; what has no batch stays as it is."""
        arrays = zip(self.arrays(), _TAILS, strict=True)
        return HeadCoefficients(*(array if array is None or np.ndim(array) == tail else array[chosen] for array, tail in arrays))


_TAILS = (1, 1, 2, 1, 2)
"""Axes of each of the coefficients behind its batch."""


@dataclass(frozen=True, eq=False)
class RestOffset:
    """Displacement of some vertices at rest, the larynx's above all."""

    vertices: NDArray
    """(k,) distinct indices."""
    values: NDArray
    """(..., k, 3) metres."""

    def frames(self, chosen: slice) -> RestOffset:
        """Some frames of an offset whose batch has one axis."""
        return self if self.values.ndim == 2 else RestOffset(self.vertices, self.values[chosen])


@dataclass(frozen=True, eq=False)
class HeadModel:
    """A head model; n vertices, m triangles, K = 2 joints. Floating arrays share one type, float32 or float64."""

    name: str
    vertices: NDArray
    """(n, 3) the mean or a person's neutral head, metres."""
    triangles: NDArray[np.int32]
    """(m, 3), counter-clockwise seen from outside."""
    shape_basis: NDArray
    """(s, n, 3) metres per unit of beta."""
    expression_basis: NDArray
    """(e, n, 3), E of eq. 4."""
    pose_basis: NDArray
    """(9 K, n, 3), P of eq. 4, in the order of `pose_features`."""
    speech_basis: NDArray
    """(p, n, 3), N of eq. 3; p = 0 before training."""
    joint_regressor: NDArray
    """(K, n): joints = regressor @ identity; rows sum to one."""
    skinning_weights: NDArray
    """(n, K + 1) of trunk, neck, jaw; rows sum to one."""
    uv: NDArray[np.float64] | None = None
    """(k, 2) texture coordinates as in `Template`, where the source has any."""
    uv_triangles: NDArray[np.int32] | None = None
    regions: dict[str, NDArray[np.bool_]] = field(default_factory=dict)
    """Vertex masks (n,): face, neck, front_neck, larynx (L), larynx_boundary (B), non_larynx (N), lips_outer, lips_inner and what
    else the source names."""
    landmarks: dict[str, int] = field(default_factory=dict)
    """Named vertices."""
    expression_names: tuple[str, ...] = ()
    """Names of the expression basis, where it has any."""

    def __post_init__(self) -> None:
        n, dtype = len(self.vertices), self.vertices.dtype
        wanted = {
            "vertices": (n, 3),
            "joint_regressor": (len(JOINTS), n),
            "skinning_weights": (n, len(JOINTS) + 1),
            "pose_basis": (POSE_FEATURES, n, 3),
        }
        wanted |= {name: (len(getattr(self, name)), n, 3) for name in BASES if name not in wanted}
        for name, shape in wanted.items():
            array = getattr(self, name)
            if array.shape != shape or array.dtype != dtype or dtype not in (np.float32, np.float64):
                raise _refused(self.name, f"{name} is {array.shape} {array.dtype}", f"{shape} {dtype}, float32 or float64")
        if (
            self.triangles.ndim != 2
            or self.triangles.shape[1] != 3
            or not (0 <= self.triangles.min() <= self.triangles.max() < n)
        ):
            raise _refused(self.name, f"triangles are {self.triangles.shape}", f"(m, 3) indices below {n}")
        for name in _NUMBERS:
            if (array := getattr(self, name)) is not None:
                object.__setattr__(self, name, _read_only(array))
        object.__setattr__(self, "regions", {name: _read_only(mask) for name, mask in self.regions.items()})
        wrong = [name for name, mask in self.regions.items() if mask.shape != (n,)]
        if wrong:
            raise _refused(self.name, f"regions {', '.join(wrong)} have another length", f"masks of {n} vertices")

    # -- stages ---------------------------------------------------------------------------------------------------------------

    def identity(self, shape: NDArray | None = None) -> NDArray:
        """Neutral heads T_0 (..., n, 3) for beta (..., s): T_0 = mean + S beta, as FLAME's."""
        if shape is None:
            return self.vertices
        shape = self._vector(shape, len(self.shape_basis), "shape")
        count = shape.shape[-1]
        flat = shape.reshape(_count(shape.shape[:-1]), count) @ self.shape_basis[:count].reshape(count, self.vertices.size)
        return flat.reshape((*shape.shape[:-1], *self.vertices.shape)) + self.vertices

    def joints(self, identity: NDArray | None = None) -> NDArray:
        """Joint positions J (..., K, 3) at rest, regressed from neutral heads (..., n, 3)."""
        return self.joint_regressor @ (self.vertices if identity is None else identity)

    def rest(self, coefficients: HeadCoefficients, offset: RestOffset | None = None) -> NDArray:
        """M of eq. 4 (..., n, 3): T_0 + B_P(theta) + B_E(psi) + B_N(phi) + the larynx's offset, before skinning."""
        batch = _batch_shape(coefficients, offset)
        out = np.empty((_count(batch), *self.vertices.shape), self.vertices.dtype)
        flat = _flattened(coefficients, batch)
        self._fill_rest(out, flat, self.identity(flat.shape), _flat_offset(offset, batch))
        return out.reshape((*batch, *self.vertices.shape))

    def skinned(self, rest: NDArray, joints: NDArray, pose: NDArray | None = None, placement: NDArray | None = None) -> NDArray:
        """W(M, J, theta, W) of eq. 5 (..., n, 3): rest heads (..., n, 3) turned about joints (..., K, 3) by pose (..., K, 3)."""
        rest, bones, batch = self._matched(rest, joints, pose, placement)
        out = np.empty((len(bones), *self.vertices.shape), self.vertices.dtype)
        return skin(rest, bones, self.skinning_weights, out).reshape((*batch, *self.vertices.shape))

    def evaluate(self, coefficients: HeadCoefficients, offset: RestOffset | None = None) -> NDArray:
        """M' of eq. 5 (..., n, 3), metres: all stages in turn, frames in blocks so that only the result grows with the batch."""
        batch = _batch_shape(coefficients, offset)
        flat, flat_offset = _flattened(coefficients, batch), _flat_offset(offset, batch)
        one_person = coefficients.shape is None or np.ndim(coefficients.shape) == 1
        identity = self.identity(coefficients.shape) if one_person else None
        out = np.empty((_count(batch), *self.vertices.shape), self.vertices.dtype)
        for start in range(0, len(out), _BLOCK):
            frames = slice(start, start + _BLOCK)
            part, block = flat.frames(frames), out[frames]
            base = identity if one_person else self.identity(part.shape)
            self._fill_rest(block, part, base, flat_offset and flat_offset.frames(frames))
            bones = bone_transforms(self._pose(part.pose), self.joints(base), part.placement)
            bones = np.broadcast_to(bones, (len(block), *bones.shape[-3:]))
            skin(block, bones, self.skinning_weights, block)
        return out.reshape((*batch, *self.vertices.shape))

    def unskinned(
        self, posed: NDArray, joints: NDArray, pose: NDArray | None = None, placement: NDArray | None = None
    ) -> NDArray:
        """The inverse of `skinned`: rest heads (..., n, 3) of posed ones (..., n, 3)."""
        posed, bones, batch = self._matched(posed, joints, pose, placement)
        posed = np.ascontiguousarray(np.broadcast_to(posed, (len(bones), *self.vertices.shape)))
        return unskin(posed, bones, self.skinning_weights).reshape((*batch, *self.vertices.shape))

    # -- derivatives ----------------------------------------------------------------------------------------------------------

    def pose_derivative(
        self, coefficients: HeadCoefficients, offset: RestOffset | None = None, vertices: NDArray | None = None
    ) -> NDArray:
        """Derivative (..., k, 3, 3 K) of skinned vertices (all, or the chosen indices (k,)) by the pose's components.

        Both ways in which the pose acts are in it: the bones turn, and the pose correctives change (eq. 4, 5).
        """
        chosen = slice(None) if vertices is None else np.asarray(vertices)
        pose = self._pose(coefficients.pose)
        identity = self.identity(coefficients.shape)
        rest = self.rest(coefficients, offset)[..., chosen, :]
        bones, slopes = bone_derivatives(pose, self.joints(identity), coefficients.placement)
        weights = self.skinning_weights[chosen]
        turned = np.einsum("vb,...qbij,...vj->...viq", weights, slopes[..., :3], rest, optimize=True)
        shifted = np.einsum("vb,...qbi->...viq", weights, slopes[..., 3])
        rotation = rotation_derivatives(pose)[1]
        basis = self.pose_basis.reshape(len(JOINTS), 9, *self.vertices.shape)[:, :, chosen]
        corrected = np.einsum("...kqf,kfvj->...vjkq", rotation.reshape((*rotation.shape[:-2], 9)), basis, optimize=True)
        corrected = corrected.reshape((*corrected.shape[:-2], -1))
        blended = vertex_transforms(bones, weights)[..., :3]
        return turned + shifted + np.einsum("...vij,...vjq->...viq", blended, corrected)

    def vertex_transforms(self, joints: NDArray, pose: NDArray | None = None, placement: NDArray | None = None) -> NDArray:
        """Blended bone transforms (..., n, 3, 4): their 3x3 part turns displacements at rest (any basis) into posed ones."""
        return vertex_transforms(bone_transforms(self._pose(pose), joints, placement), self.skinning_weights)

    # -- other models ---------------------------------------------------------------------------------------------------------

    def personal(self, identity: NDArray, name: str | None = None) -> HeadModel:
        """The model of one person: T_0 (n, 3) in the mean's place, and no shape basis."""
        identity = np.asarray(identity, self.vertices.dtype)
        return replace(self, name=name or self.name, vertices=identity, shape_basis=self.shape_basis[:0])

    def astype(self, dtype: type) -> HeadModel:
        """The same model in float32 (to evaluate) or float64 (to check derivatives)."""
        names = ("vertices", *BASES, "joint_regressor", "skinning_weights")
        return replace(self, **{name: np.ascontiguousarray(getattr(self, name), dtype) for name in names})

    def subdivided(self, step: Subdivision) -> HeadModel:
        """The model on a finer mesh, everything carried by one operator (`meshes.subdivision`)."""
        changes = {name: step.carry_basis(getattr(self, name)) for name in BASES}
        if self.uv is not None:
            changes["uv"], changes["uv_triangles"] = step.carry_corners(self.triangles, self.uv, self.uv_triangles)
        return replace(
            self,
            vertices=step.carry(self.vertices),
            triangles=step.triangles,
            joint_regressor=step.carry_regressor(self.joint_regressor),
            skinning_weights=step.carry_weights(self.skinning_weights),
            regions={name: step.carry_mask(mask) for name, mask in self.regions.items()},
            **changes,
        )

    def part(self, kept: NDArray[np.bool_]) -> HeadModel:
        """The model of the vertices kept (n,) and the triangles between them; the joints stay where they are.

        Raises `InputError` where a joint is regressed from vertices that go.
        """
        if np.abs(self.joint_regressor[:, ~kept]).max(initial=0.0) > 1e-6:
            raise _refused(self.name, "joints are regressed from vertices that are cut away", "joints of the part that is kept")
        inside = kept[self.triangles].all(axis=1)
        triangles, used = submesh(self.triangles, inside)
        number = np.full(len(self.vertices), -1)
        number[used] = np.arange(len(used))
        changes = {name: np.ascontiguousarray(getattr(self, name)[:, used]) for name in (*BASES, "joint_regressor")}
        if self.uv is not None:
            changes["uv_triangles"] = self.uv_triangles[inside]
        return replace(
            self,
            vertices=self.vertices[used],
            triangles=triangles,
            skinning_weights=self.skinning_weights[used],
            regions={name: mask[used] for name, mask in self.regions.items()},
            landmarks={name: int(number[v]) for name, v in self.landmarks.items() if number[v] >= 0},
            **changes,
        )

    def template(self) -> Template:
        """The neutral head as a template to register; raises `InputError` where the model has no texture coordinates."""
        if self.uv is None:
            raise InputError(
                f"the head model {self.name} has no texture coordinates",
                expected="texture coordinates to register a scan with",
                remedy="Load it together with the file of its texture coordinates.",
            )
        regions = {name: mask.copy() for name, mask in self.regions.items()}
        arrays = (self.vertices.astype(np.float64), self.triangles.copy(), self.uv.copy(), self.uv_triangles.copy())
        return Template(*arrays, regions, dict(self.landmarks))

    # -- files ----------------------------------------------------------------------------------------------------------------

    @cached_property
    def digest(self) -> str:
        """sha256 of everything the model computes with: what a trained regressor must agree on."""
        return _digest(getattr(self, name) for name in _NUMBERS if name not in ("uv", "uv_triangles"))

    @cached_property
    def topology_digest(self) -> str:
        """sha256 of the triangles: what maps and masks over the vertices must agree on."""
        return _digest([np.array(len(self.vertices)), self.triangles])

    def to_arrays(self) -> tuple[dict[str, NDArray], dict]:
        """Arrays and plain record that tell the model; `from_arrays` is the inverse."""
        arrays = {name: getattr(self, name) for name in _NUMBERS if getattr(self, name) is not None}
        arrays |= {f"region/{name}": mask for name, mask in self.regions.items()}
        return arrays, {"name": self.name, "landmarks": self.landmarks, "expression_names": list(self.expression_names)}

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray], meta: dict) -> HeadModel:
        """The model that `to_arrays` told."""
        regions = {name.removeprefix("region/"): array for name, array in arrays.items() if name.startswith("region/")}
        numbers = {name: array for name, array in arrays.items() if not name.startswith("region/")}
        names = tuple(meta["expression_names"])
        return cls(name=meta["name"], regions=regions, landmarks=meta["landmarks"], expression_names=names, **numbers)

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.head_model/1`."""
        save_arrays(path, KIND, SCHEMA, *self.to_arrays())

    @classmethod
    def load(cls, path: Path | str) -> HeadModel:
        """Read what `save` wrote; raises `ArtifactError`."""
        return cls.from_arrays(*load_arrays(path, KIND, SCHEMA))

    # -- within ---------------------------------------------------------------------------------------------------------------

    @cached_property
    def _stacked(self) -> NDArray:
        """(e + 9 K + p, 3 n): one matrix product serves expression, pose correctives and speech."""
        parts = (self.expression_basis, self.pose_basis, self.speech_basis)
        return np.concatenate([part.reshape(len(part), self.vertices.size) for part in parts])

    def _vector(self, vector: NDArray, length: int, name: str) -> NDArray:
        vector = np.asarray(vector, self.vertices.dtype)
        if vector.ndim == 0 or vector.shape[-1] > length:
            raise _refused(self.name, f"{name} coefficients are {vector.shape}", f"(..., {length}) or fewer")
        return vector

    def _pose(self, pose: NDArray | None) -> NDArray:
        pose = np.zeros((len(JOINTS), 3)) if pose is None else np.asarray(pose)
        if pose.shape[-2:] != (len(JOINTS), 3):
            raise _refused(
                self.name, f"the pose is {pose.shape}", f"(..., {len(JOINTS)}, 3) rotation vectors of {', '.join(JOINTS)}"
            )
        return pose.astype(self.vertices.dtype, copy=False)

    def _blend_weights(self, coefficients: HeadCoefficients) -> NDArray | None:
        """Weights (..., e + 9 K + p) of `_stacked`, None where all are zero by omission."""
        given = []
        if coefficients.expression is not None:
            given.append((0, self._vector(coefficients.expression, len(self.expression_basis), "expression")))
        if coefficients.pose is not None:
            given.append((len(self.expression_basis), pose_features(self._pose(coefficients.pose))))
        if coefficients.speech is not None:
            first = len(self.expression_basis) + POSE_FEATURES
            given.append((first, self._vector(coefficients.speech, len(self.speech_basis), "speech")))
        if not given:
            return None
        batch = np.broadcast_shapes(*(vector.shape[:-1] for _, vector in given))
        weights = np.zeros((*batch, len(self._stacked)), self.vertices.dtype)
        for first, vector in given:
            weights[..., first : first + vector.shape[-1]] = vector
        return weights

    def _fill_rest(self, out: NDArray, flat: HeadCoefficients, identity: NDArray, offset: RestOffset | None) -> None:
        """Eq. 4 into `out` (frames, n, 3); the product of the bases goes straight there."""
        weights = self._blend_weights(flat)
        if weights is None:
            out[:] = identity
        elif weights.ndim == 1:
            out[:] = identity + (weights @ self._stacked).reshape(self.vertices.shape)
        else:
            np.matmul(weights, self._stacked, out=out.reshape(len(out), -1))
            out += identity
        if offset is not None:
            out[:, offset.vertices] += offset.values

    def _matched(
        self, heads: NDArray, joints: NDArray, pose: NDArray | None, placement: NDArray | None
    ) -> tuple[NDArray, NDArray, tuple[int, ...]]:
        """Heads (frames or 1, n, 3) and bones (frames, K + 1, 3, 4) of one batch, and its shape."""
        heads, bones = np.asarray(heads, self.vertices.dtype), bone_transforms(self._pose(pose), joints, placement)
        batch = np.broadcast_shapes(heads.shape[:-2], bones.shape[:-3])
        bones = np.broadcast_to(bones, (*batch, *bones.shape[-3:])).reshape(-1, *bones.shape[-3:])
        heads = _flat(heads, batch, 2).reshape(-1, *self.vertices.shape)
        return np.ascontiguousarray(heads), bones, batch


_NAMES = ("name", "regions", "landmarks", "expression_names")
_NUMBERS = tuple(entry.name for entry in fields(HeadModel) if entry.name not in _NAMES)


def _batch_shape(given: HeadCoefficients, offset: RestOffset | None) -> tuple[int, ...]:
    shapes = [np.shape(array)[:-tail] for array, tail in zip(given.arrays(), _TAILS, strict=True) if array is not None]
    return np.broadcast_shapes((), *shapes, () if offset is None else offset.values.shape[:-2])


def _count(batch: tuple[int, ...]) -> int:
    return int(np.prod(batch, dtype=int))


def _flat(array: NDArray | None, batch: tuple[int, ...], tail: int) -> NDArray | None:
    """An array of any batch shape as (frames, ...); one without a batch stays without."""
    if array is None or np.ndim(array) == tail:
        return array
    array = np.asarray(array)
    rest = array.shape[array.ndim - tail :]
    return np.broadcast_to(array, (*batch, *rest)).reshape(_count(batch), *rest)


def _flattened(given: HeadCoefficients, batch: tuple[int, ...]) -> HeadCoefficients:
    return HeadCoefficients(*(_flat(array, batch, tail) for array, tail in zip(given.arrays(), _TAILS, strict=True)))


def _flat_offset(offset: RestOffset | None, batch: tuple[int, ...]) -> RestOffset | None:
    return offset and RestOffset(offset.vertices, _flat(offset.values, batch, 2))


def _read_only(array: NDArray) -> NDArray:
    """A view that cannot be written through: models share arrays."""
    view = array.view()
    view.flags.writeable = False
    return view


def _digest(arrays) -> str:
    sum_ = hashlib.sha256()
    for array in arrays:
        sum_.update(f"{array.shape}{array.dtype}".encode())
        sum_.update(np.ascontiguousarray(array).tobytes())
    return sum_.hexdigest()


def _refused(name: str, found: str, expected: str) -> InputError:
    remedy = "Check where the model or its coefficients come from."
    return InputError(f"head model {name}: {found}", expected=expected, remedy=remedy)
