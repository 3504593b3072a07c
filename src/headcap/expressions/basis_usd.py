"""Blend shapes of a USD file (UsdSkel) as an expression basis."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.expressions.basis import ExpressionBasis
from headcap.meshes.topology import polygon_fans

if TYPE_CHECKING:
    from pxr import Usd, UsdSkel

_Y_FROM_Z = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


def read_usd(path: Path | str, part: str | None = None) -> ExpressionBasis:
    """Shapes of the mesh with blend shapes, or of the one called `part` (its name or path); metres, y up, placed as it is shown.

    The stage's metersPerUnit and upAxis are heeded. Offsets that name their points move those alone. Names are those the mesh's
    binding gives; in-between shapes, which refine the way to a shape, are left out. Raises `InputError` for a file that is
    damaged, has no blend shapes, has them on several meshes, or whose offsets do not fit its points.
    """
    from pxr import Tf, Usd, UsdGeom

    path = Path(path)
    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        raise InputError(
            f"{path.name} cannot be read ({error})", expected="a whole USD file", remedy="Export it again."
        ) from error
    prim = _mesh_with_shapes(stage, path, part)
    mesh = UsdGeom.Mesh(prim)
    points = _array(mesh.GetPointsAttr().Get(), 3, np.float64)
    names, shapes = _shapes(prim, points, path)
    placement = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(prim)).T
    linear, shift = placement[:3, :3], placement[:3, 3]
    up = _Y_FROM_Z if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z else np.eye(3)
    metres = UsdGeom.GetStageMetersPerUnit(stage) * up
    triangles = polygon_fans(mesh.GetFaceVertexIndicesAttr().Get() or (), mesh.GetFaceVertexCountsAttr().Get() or ())
    inward = (mesh.GetOrientationAttr().Get() == UsdGeom.Tokens.leftHanded) != (np.linalg.det(linear) < 0)
    return ExpressionBasis(
        names,
        (points @ linear.T + shift) @ metres.T,
        shapes @ (metres @ linear).T,
        triangles[:, ::-1] if inward else triangles,
    )


def _mesh_with_shapes(stage: Usd.Stage, path: Path, part: str | None) -> Usd.Prim:
    from pxr import UsdGeom, UsdSkel

    meshes = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)]
    shaped = [prim for prim in meshes if UsdSkel.BindingAPI(prim).GetBlendShapeTargetsRel().GetTargets()]
    chosen = [prim for prim in shaped if part is None or part in (prim.GetName(), str(prim.GetPath()))]
    if len(chosen) == 1:
        return chosen[0]
    found = f"meshes with blend shapes in {path.name}: {', '.join(str(prim.GetPath()) for prim in shaped) or 'none'}"
    expected = part or "one, or the name of one"
    raise InputError(found, expected=expected, remedy="Name the face's mesh, or export it with its blend shapes.")


def _shapes(prim: Usd.Prim, points: NDArray, path: Path) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    from pxr import UsdSkel

    binding = UsdSkel.BindingAPI(prim)
    targets = binding.GetBlendShapeTargetsRel().GetTargets()
    names = tuple(binding.GetBlendShapesAttr().Get() or ())
    if len(names) != len(targets):
        names = tuple(target.name for target in targets)
    shapes = np.zeros((len(targets), *points.shape))
    for name, target, shape in zip(names, targets, shapes, strict=True):
        blend = UsdSkel.BlendShape(prim.GetStage().GetPrimAtPath(target))
        if not blend:
            raise InputError(f"{path.name} without {target}", expected="the shape it names", remedy="Export it again.")
        _move(shape, blend, f"{name} of {path.name}")
    return names, shapes


def _move(shape: NDArray, blend: UsdSkel.BlendShape, label: str) -> None:
    offsets = _array(blend.GetOffsetsAttr().Get(), 3, np.float64)
    numbers = blend.GetPointIndicesAttr().Get()
    places = np.arange(len(shape)) if not numbers else np.array(numbers, np.int64)
    if len(places) != len(offsets) or (len(places) and not 0 <= places.min() <= places.max() < len(shape)):
        raise InputError(
            f"{label}: {len(offsets)} offsets for {len(places)} of {len(shape)} points",
            expected="an offset for each point, or for each point that it names",
            remedy="Export the shape from the mesh that it is bound to.",
        )
    shape[places] = offsets


def _array(values, width: int, dtype: type) -> NDArray:
    return np.zeros((0, width), dtype) if values is None else np.array(values, dtype).reshape(-1, width)
