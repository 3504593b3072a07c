"""An expression basis as UsdSkel blend shapes, with weights as time samples."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import atomic_path
from headcap.expressions.basis import ExpressionBasis
from headcap.expressions.weight_curves import WeightCurves

_ROOT = "/Head"
_JOINT = "root"


def write_usd_shapes(path: Path | str, basis: ExpressionBasis, curves: WeightCurves | None = None) -> None:
    """Write a basis as .usd, .usda or .usdc: a mesh with a blend shape per shape, metres, y up.

    Vertices are the basis' own, in its order; a shape names the points that it moves. USD wants a skeleton where shapes are: one
    joint that stays. Names that are none in USD are changed in prim paths alone; the binding tells them as they are. `curves`
    become time samples of `blendShapeWeights`, at time codes of their frame rate.
    """
    from pxr import Usd, UsdGeom, UsdSkel

    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdSkel.Root.Define(stage, _ROOT)
    stage.SetDefaultPrim(root.GetPrim())
    mesh = _mesh(stage, basis)
    targets = _blend_shapes(stage, basis)
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateBlendShapesAttr(list(basis.names))
    binding.CreateBlendShapeTargetsRel().SetTargets(targets)
    skeleton = _skeleton(stage, binding, len(basis.neutral))
    if curves is not None:
        _animate(stage, skeleton, curves.of(basis.names))
    with atomic_path(path) as temporary:
        stage.GetRootLayer().Export(str(temporary))


def _mesh(stage, basis: ExpressionBasis):
    from pxr import UsdGeom

    mesh = UsdGeom.Mesh.Define(stage, f"{_ROOT}/face")
    mesh.CreatePointsAttr(_vectors(basis.neutral))
    mesh.CreateFaceVertexCountsAttr([3] * len(basis.triangles))
    mesh.CreateFaceVertexIndicesAttr(_integers(basis.triangles.ravel()))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    # a box that holds every shape at full weight: what is culled by it would vanish
    reach = np.abs(basis.displacements).max(axis=(0, 1))
    mesh.CreateExtentAttr(_vectors(np.stack([basis.neutral.min(axis=0) - reach, basis.neutral.max(axis=0) + reach])))
    return mesh


def _blend_shapes(stage, basis: ExpressionBasis) -> list:
    from pxr import UsdSkel

    paths = []
    for name, displacement in zip(_prim_names(basis.names), basis.displacements, strict=True):
        shape = UsdSkel.BlendShape.Define(stage, f"{_ROOT}/face/{name}")
        moved = np.flatnonzero(displacement.any(axis=1))
        # no index at all would mean every point
        moved = moved if len(moved) else np.array([0])
        shape.CreateOffsetsAttr(_vectors(displacement[moved]))
        shape.CreatePointIndicesAttr(_integers(moved))
        paths.append(shape.GetPath())
    return paths


def _skeleton(stage, binding, points: int):
    from pxr import Gf, UsdSkel, Vt

    skeleton = UsdSkel.Skeleton.Define(stage, f"{_ROOT}/skeleton")
    skeleton.CreateJointsAttr([_JOINT])
    at_rest = Vt.Matrix4dArray([Gf.Matrix4d(1.0)])
    skeleton.CreateBindTransformsAttr(at_rest)
    skeleton.CreateRestTransformsAttr(at_rest)
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    binding.CreateJointIndicesPrimvar(True, 1).Set([0])
    binding.CreateJointWeightsPrimvar(True, 1).Set([1.0])
    return skeleton


def _animate(stage, skeleton, curves: WeightCurves) -> None:
    from pxr import UsdSkel, Vt

    rate = 1.0 / float(np.median(np.diff(curves.time_s))) if len(curves) > 1 else 1.0
    # 29.97 is no whole number, 30 up to rounding of the times is one
    rate = round(rate) if abs(rate - round(rate)) < 1e-6 * rate else rate
    codes = curves.time_s * rate
    codes = np.where(np.abs(codes - np.rint(codes)) < 1e-6, np.rint(codes), codes)
    stage.SetTimeCodesPerSecond(rate)
    stage.SetFramesPerSecond(rate)
    stage.SetStartTimeCode(float(codes[0]))
    stage.SetEndTimeCode(float(codes[-1]))
    animation = UsdSkel.Animation.Define(stage, f"{_ROOT}/performance")
    animation.CreateBlendShapesAttr(list(curves.names))
    attribute = animation.CreateBlendShapeWeightsAttr()
    for code, row in zip(codes.tolist(), curves.weights.astype(np.float32), strict=True):
        attribute.Set(Vt.FloatArray.FromNumpy(row), code)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])


def _prim_names(names: tuple[str, ...]) -> list[str]:
    taken, out = set(), []
    for name in names:
        plain = re.sub(r"\W", "_", name, flags=re.ASCII) or "shape"
        plain = f"_{plain}" if plain[0].isdigit() else plain
        unique, number = plain, 1
        while unique in taken:
            number += 1
            unique = f"{plain}_{number}"
        taken.add(unique)
        out.append(unique)
    return out


def _vectors(array: NDArray):
    from pxr import Vt

    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(array, np.float32))


def _integers(array: NDArray):
    from pxr import Vt

    return Vt.IntArray.FromNumpy(np.ascontiguousarray(array, np.int32))
