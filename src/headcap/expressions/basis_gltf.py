"""Morph targets of a glTF 2.0 file as an expression basis."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from headcap.errors import InputError
from headcap.expressions.basis import ExpressionBasis

if TYPE_CHECKING:
    from pygltflib import GLTF2, Accessor, Mesh, Primitive

OWN_GENERATOR = "headcap"
"""What writes files whose vertices are none that were split."""
_TYPES = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_TRIANGLES = 4


def read_gltf(path: Path | str, part: str | None = None) -> ExpressionBasis:
    """Shapes of the mesh with morph targets, or of the one called `part`; glTF's metres, y up, placed as its node says.

    The primitives of a mesh, one per material, are one surface. glTF splits vertices at texture seams and creases: those that are
    at one place in the neutral face and in every shape are one again, numbered by their first; lips that touch at rest part in
    some shape and stay two. Names are those of `extras.targetNames`, else shape_000... Raises `InputError` for a file that is
    damaged, has no morph targets, has them in several meshes, or names two alike.
    """
    path = Path(path)
    try:
        document = _Document(path)
        mesh = _mesh_with_shapes(document, path, part)
        arrays = [document.primitive(primitive) for primitive in mesh.primitives if primitive.targets]
        return _basis(document, mesh, arrays, path)
    except InputError:
        raise
    except Exception as error:  # what a damaged file breaks is anything
        raise InputError(
            f"{path.name} cannot be read ({error})", expected="a whole glTF file", remedy="Export it again."
        ) from error


class _Document:
    """A glTF file whose accessors are arrays."""

    def __init__(self, path: Path) -> None:
        from pygltflib import GLTF2

        self.gltf: GLTF2 = GLTF2().load(str(path))
        compressed = [name for name in self.gltf.extensionsRequired or () if "compression" in name]
        if compressed:
            raise InputError(
                f"{path.name} compressed by {', '.join(compressed)}", expected="plain accessors", remedy="Export uncompressed."
            )

    @cached_property
    def buffers(self) -> list[bytes]:
        """Bytes of each buffer: inside the file, beside it, or written into it as text."""
        gltf = self.gltf
        return [
            gltf.binary_blob() if buffer.uri is None else gltf.get_data_from_buffer_uri(buffer.uri) for buffer in gltf.buffers
        ]

    def primitive(self, primitive: Primitive) -> tuple[NDArray, NDArray, NDArray]:
        """Positions (n, 3), displacements (k, n, 3) and triangles (m, 3)."""
        if primitive.mode not in (None, _TRIANGLES):
            raise InputError(f"a primitive of mode {primitive.mode}", expected="triangles", remedy="Export triangles.")
        positions = self.array(self.gltf.accessors[primitive.attributes.POSITION])
        shapes = [self._target(target, positions.shape) for target in primitive.targets]
        if primitive.indices is None:
            corners = np.arange(len(positions))
        else:
            corners = self.array(self.gltf.accessors[primitive.indices])[:, 0]
        return positions.astype(np.float64), np.array(shapes, np.float32), corners.reshape(-1, 3).astype(np.int32)

    def _target(self, target, shape: tuple[int, ...]) -> NDArray:
        number = target.get("POSITION") if isinstance(target, dict) else target.POSITION
        # a target may bend normals or colours only
        return np.zeros(shape, np.float32) if number is None else self.array(self.gltf.accessors[number])

    def array(self, accessor: Accessor) -> NDArray:
        """(count, width) of an accessor, sparse or not; whole numbers that stand for shares become them (glTF 3.6.2.2)."""
        dtype, width = np.dtype(_TYPES[accessor.componentType]).newbyteorder("<"), _WIDTHS[accessor.type]
        if accessor.bufferView is None:
            out = np.zeros((accessor.count, width), dtype)
        else:
            out = self._view(accessor.bufferView, accessor.byteOffset or 0, accessor.count, width, dtype).copy()
        if accessor.sparse is not None:
            told, count = accessor.sparse, accessor.sparse.count
            kind = np.dtype(_TYPES[told.indices.componentType]).newbyteorder("<")
            places = self._view(told.indices.bufferView, told.indices.byteOffset or 0, count, 1, kind)[:, 0]
            out[places] = self._view(told.values.bufferView, told.values.byteOffset or 0, count, width, dtype)
        if accessor.normalized and dtype.kind in "iu":
            return np.maximum(out.astype(np.float32) / np.iinfo(dtype).max, -1.0)
        return out

    def _view(self, number: int, offset: int, count: int, width: int, dtype: np.dtype) -> NDArray:
        view = self.gltf.bufferViews[number]
        data, step = self.buffers[view.buffer], view.byteStride or width * dtype.itemsize
        first = (view.byteOffset or 0) + offset
        return np.ndarray((count, width), dtype, data, first, (step, dtype.itemsize))

    def placement(self, mesh: Mesh) -> NDArray[np.float64]:
        """(4, 4) of the first node that shows a mesh; a skinned one is placed by its joints alone (glTF 3.7.3.3)."""
        nodes = self.gltf.nodes or []
        parents = {child: i for i, node in enumerate(nodes) for child in node.children or ()}
        shown = [i for i, node in enumerate(nodes) if node.mesh is not None and self.gltf.meshes[node.mesh] is mesh]
        if not shown or nodes[shown[0]].skin is not None:
            return np.eye(4)
        out, at = np.eye(4), shown[0]
        while at is not None:
            out, at = _local(nodes[at]) @ out, parents.get(at)
        return out


def _local(node) -> NDArray[np.float64]:
    if node.matrix is not None:
        return np.array(node.matrix, float).reshape(4, 4).T
    out = np.eye(4)
    out[:3, :3] = Rotation.from_quat(node.rotation or [0.0, 0.0, 0.0, 1.0]).as_matrix() * np.array(node.scale or [1.0, 1.0, 1.0])
    out[:3, 3] = node.translation or [0.0, 0.0, 0.0]
    return out


def _mesh_with_shapes(document: _Document, path: Path, part: str | None) -> Mesh:
    meshes = document.gltf.meshes or []
    shaped = {mesh.name or f"mesh_{i}": mesh for i, mesh in enumerate(meshes) if any(p.targets for p in mesh.primitives)}
    if part is not None and part in shaped:
        return shaped[part]
    if part is None and len(shaped) == 1:
        return next(iter(shaped.values()))
    found = f"meshes with morph targets in {path.name}: {', '.join(shaped) or 'none'}"
    if part is not None or len(shaped) > 1:
        raise InputError(found, expected=part or "one, or the name of one", remedy="Name the face's mesh.")
    raise InputError(found, expected="one", remedy="Export the shapes as morph targets (shape keys).")


def _basis(document: _Document, mesh: Mesh, arrays: list[tuple], path: Path) -> ExpressionBasis:
    counts = {len(shapes) for _, shapes, _ in arrays}
    if len(counts) > 1:
        raise InputError(
            f"{path.name}: parts of {mesh.name} with {', '.join(map(str, sorted(counts)))} morph targets",
            expected="as many in each",
            remedy="Export it again.",
        )
    starts = np.cumsum([0, *(len(positions) for positions, _, _ in arrays)])
    positions = np.concatenate([part[0] for part in arrays])
    shapes = np.concatenate([part[1] for part in arrays], axis=1)
    triangles = np.concatenate([part[2] + start for part, start in zip(arrays, starts, strict=False)]).astype(np.int32)
    if not (document.gltf.asset.generator or "").startswith(OWN_GENERATOR):
        positions, shapes, triangles = whole(positions, shapes, triangles)
    placement = document.placement(mesh)
    return ExpressionBasis(
        _names(mesh, len(shapes)),
        positions @ placement[:3, :3].T + placement[:3, 3],
        shapes @ placement[:3, :3].T,
        triangles if np.linalg.det(placement[:3, :3]) > 0 else triangles[:, ::-1],
    )


def whole(positions: NDArray, shapes: NDArray, triangles: NDArray) -> tuple[NDArray, NDArray, NDArray[np.int32]]:
    """Vertices (n, 3) that are at one place in all shapes (k, n, 3) joined, in the order of their first, and triangles (m, 3)."""
    rows = np.concatenate([positions, *shapes], axis=1, dtype=np.float32)
    # equal numbers, equal bytes: minus zero is zero
    keys = np.ascontiguousarray(rows + np.float32(0)).view(f"V{rows.shape[1] * 4}")[:, 0]
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    kept = np.sort(first)
    joined = rank[inverse.ravel()][triangles].astype(np.int32)
    apart = (joined != np.roll(joined, 1, axis=1)).all(axis=1)
    return positions[kept], shapes[:, kept], joined[apart]


def _names(mesh: Mesh, count: int) -> tuple[str, ...]:
    told = (mesh.extras or {}).get("targetNames") or ()
    return tuple(map(str, told)) if len(told) == count else tuple(f"shape_{i:03}" for i in range(count))
