"""A USD mesh whose points are sampled over time, as frames in metres with y up."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.expressions.mesh_frames import MeshFrames, decoded, refuse_other_count
from headcap.meshes.topology import polygon_fans

_Y_FROM_Z_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def read_usd_frames(path: Path, prim: str | None = None) -> MeshFrames:
    """Frames at the time samples of the one UsdGeomMesh with animated points, or of the prim named.

    The stage's metersPerUnit, upAxis and timeCodesPerSecond and the prim's own transforms are applied. Raises `InputError` for
    files that cannot be opened, no or several animated meshes, and points whose number changes.
    """
    from pxr import Tf, Usd, UsdGeom

    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as error:
        raise InputError(f"{path} cannot be opened", expected="a USD file", remedy="Export it again.") from error
    mesh = _animated_mesh(path, stage, prim)
    codes = mesh.GetPointsAttr().GetTimeSamples()
    corners, sizes = mesh.GetFaceVertexIndicesAttr().Get(codes[0]), mesh.GetFaceVertexCountsAttr().Get(codes[0])
    triangles = polygon_fans(np.array(corners), np.array(sizes))
    unit_m = UsdGeom.GetStageMetersPerUnit(stage)
    axes = _Y_FROM_Z_UP if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z else np.eye(3)
    count = len(mesh.GetPointsAttr().Get(codes[0]))

    def frames():
        for code in codes:
            points = np.array(mesh.GetPointsAttr().Get(code), np.float64)
            refuse_other_count(f"{path.name} at time {code:g}", len(points), f"time {codes[0]:g}", count, "points")
            yield unit_m * _placed(mesh, code, points) @ axes.T

    times = np.array(codes) / stage.GetTimeCodesPerSecond()
    return MeshFrames(decoded(frames(), len(codes), count), times, path.name, triangles, in_metres=True)


def _placed(mesh, code: float, points: NDArray) -> NDArray[np.float64]:
    """Points (n, 3) in the stage's world; USD multiplies rows from the left."""
    world = np.array(mesh.ComputeLocalToWorldTransform(code))
    return points @ world[:3, :3] + world[3, :3]


def _animated_mesh(path: Path, stage, prim: str | None):
    from pxr import UsdGeom

    meshes = [UsdGeom.Mesh(found) for found in stage.Traverse() if found.IsA(UsdGeom.Mesh)]
    animated = [mesh for mesh in meshes if mesh.GetPointsAttr().GetNumTimeSamples() > 1]
    names = [str(mesh.GetPath()) for mesh in animated]
    if prim is not None:
        animated = [mesh for mesh, name in zip(animated, names, strict=True) if name == prim]
    if len(animated) == 1:
        return animated[0]
    if not names:
        raise InputError(
            f"{path.name} has {len(meshes)} meshes, none with points sampled over time",
            expected="one mesh with animated points",
            remedy="Bake skinning and blend shapes into points and export it again.",
        )
    raise InputError(
        f"{path.name} has the animated meshes {', '.join(names)}",
        expected="one" if prim is None else f"one called {prim}",
        remedy="Name the prim of the head.",
    )
