"""An expression basis as glTF 2.0 morph targets, with weights as an animation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import atomic_path
from headcap.expressions.basis import ExpressionBasis
from headcap.expressions.basis_gltf import OWN_GENERATOR
from headcap.expressions.weight_curves import WeightCurves
from headcap.meshes.normals import vertex_normals

_FLOAT, _UINT = 5126, 5125
_VERTICES, _INDICES = 34962, 34963
"""Targets of a buffer view: what the graphics card is to take it for."""


class _Binary:
    """Accessors that are appended to one buffer."""

    def __init__(self) -> None:
        self.accessors, self.views, self.parts, self.length = [], [], [], 0

    def add(self, array: NDArray, kind: str, component: int, target: int | None = None, *, bounds: bool = False) -> int:
        """Number of the accessor of a contiguous array (n,) or (n, width)."""
        from pygltflib import Accessor

        view = self._view(array, target)
        accessor = Accessor(bufferView=view, byteOffset=0, componentType=component, count=len(array), type=kind)
        return self._known(accessor, array if bounds else None)

    def add_sparse(self, array: NDArray, *, bounds: bool) -> int:
        """Number of an accessor (n, 3) that names the rows which are not zero, where that is shorter."""
        from pygltflib import Accessor, AccessorSparseIndices, AccessorSparseValues, Sparse

        rows = np.flatnonzero(array.any(axis=1))
        if 16 * len(rows) >= 12 * len(array):
            return self.add(array, "VEC3", _FLOAT, _VERTICES, bounds=bounds)
        # zero all over but where it names rows: no view lies below
        accessor = Accessor(bufferView=None, byteOffset=None, componentType=_FLOAT, count=len(array), type="VEC3")
        if len(rows):
            indices = self._view(rows.astype("<u4"), None)
            values = self._view(np.ascontiguousarray(array[rows]), None)
            accessor.sparse = Sparse(
                count=len(rows),
                indices=AccessorSparseIndices(bufferView=indices, byteOffset=0, componentType=_UINT),
                values=AccessorSparseValues(bufferView=values, byteOffset=0),
            )
        return self._known(accessor, array if bounds else None)

    def _known(self, accessor, array: NDArray | None) -> int:
        if array is not None:
            flat = array.reshape(len(array), -1)
            accessor.min, accessor.max = flat.min(axis=0).tolist(), flat.max(axis=0).tolist()
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def _view(self, array: NDArray, target: int | None) -> int:
        from pygltflib import BufferView

        data = np.ascontiguousarray(array).tobytes()
        self.views.append(BufferView(buffer=0, byteOffset=self.length, byteLength=len(data), target=target))
        padding = -len(data) % 4
        self.parts.append(data + b"\0" * padding)
        self.length += len(data) + padding
        return len(self.views) - 1


def write_gltf_shapes(path: Path | str, basis: ExpressionBasis, curves: WeightCurves | None = None) -> None:
    """Write a basis as GLB: one mesh, a morph target per shape with its name in `extras.targetNames`, metres, y up.

    Vertices are the basis' own, in its order. Normals go along, of the targets too, or a viewer would light a moved face as if
    at rest; targets are sparse where few vertices move. `curves` become the animation of channel `weights`, linear between
    frames.
    """
    from pygltflib import GLTF2, Asset, Buffer, Node, Scene

    binary = _Binary()
    mesh = _mesh(basis, binary)
    animations = [] if curves is None else [_animation(curves.of(basis.names), binary)]
    gltf = GLTF2(
        asset=Asset(version="2.0", generator=OWN_GENERATOR),
        scene=0,
        scenes=[Scene(nodes=[0])],
        nodes=[Node(mesh=0, name=mesh.name)],
        meshes=[mesh],
        animations=animations,
        accessors=binary.accessors,
        bufferViews=binary.views,
        buffers=[Buffer(byteLength=binary.length)],
    )
    gltf.set_binary_blob(b"".join(binary.parts))
    with atomic_path(path) as temporary:
        temporary.write_bytes(b"".join(gltf.save_to_bytes()))


def _mesh(basis: ExpressionBasis, binary: _Binary):
    from pygltflib import Attributes, Mesh, Primitive

    neutral = basis.neutral
    normals = _normals(neutral, basis.triangles)
    attributes = Attributes(
        POSITION=binary.add(neutral, "VEC3", _FLOAT, _VERTICES, bounds=True),
        NORMAL=binary.add(normals, "VEC3", _FLOAT, _VERTICES),
    )
    targets = []
    for displacement in basis.displacements:
        turned = _normals(neutral + displacement, basis.triangles) - normals
        targets.append(
            {
                "POSITION": binary.add_sparse(displacement, bounds=True),
                "NORMAL": binary.add_sparse(turned.astype(np.float32), bounds=False),
            }
        )
    indices = binary.add(basis.triangles.ravel().astype("<u4"), "SCALAR", _UINT, _INDICES)
    return Mesh(
        name="face",
        primitives=[Primitive(attributes=attributes, indices=indices, mode=4, targets=targets)],
        weights=[0.0] * len(basis),
        extras={"targetNames": list(basis.names)},
    )


def _normals(vertices: NDArray, triangles: NDArray) -> NDArray[np.float32]:
    """(n, 3) of length one; a vertex without an area about it looks forward."""
    normals = vertex_normals(vertices.astype(np.float64), triangles)
    lost = ~(np.abs(np.linalg.norm(normals, axis=1) - 1.0) < 1e-3)
    normals[lost] = (0.0, 0.0, 1.0)
    return normals.astype(np.float32)


def _animation(curves: WeightCurves, binary: _Binary):
    from pygltflib import Animation, AnimationChannel, AnimationChannelTarget, AnimationSampler

    # glTF's clock begins at zero
    times = (curves.time_s - curves.time_s[0]).astype("<f4")
    sampler = AnimationSampler(
        input=binary.add(times, "SCALAR", _FLOAT, bounds=True),
        output=binary.add(curves.weights.astype("<f4").ravel(), "SCALAR", _FLOAT),
        interpolation="LINEAR",
    )
    channel = AnimationChannel(sampler=0, target=AnimationChannelTarget(node=0, path="weights"))
    return Animation(name="performance", samplers=[sampler], channels=[channel])
