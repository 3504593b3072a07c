"""The neutral scan: the outside of the resting subject in a topology of its own, noisy, coloured, in its own unit and place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from headcap.artifacts import atomic_path
from headcap.meshes.topology import submesh
from headcap.synthetic.densify import subdivide
from headcap.synthetic.rig import SUBJECT_STREAM, random_stream
from headcap.synthetic.sensor import encode
from headcap.synthetic.settings import ScanSettings
from headcap.synthetic.subject import Subject
from headcap.synthetic.texture import colours

_COLOUR_FOOTPRINT_MM = 0.4


def scan_from_world(settings: ScanSettings, seed: int) -> tuple[NDArray, float, NDArray]:
    """Rotation (3, 3), scale and shift (3,) in the scan's unit: scan = scale * R @ world + shift."""
    rotation = Rotation.from_rotvec(random_stream(seed, SUBJECT_STREAM, 2).normal(0, 0.5, 3)).as_matrix()
    return rotation, 1 / settings.unit_m, np.array(settings.placement_m) / settings.unit_m


def write_scan(path: Path | str, subject: Subject, settings: ScanSettings, seed: int) -> None:
    """Write the scan as binary PLY with vertex colours (sRGB)."""
    import open3d as o3d

    random = random_stream(seed, SUBJECT_STREAM, 1)
    rest = subject.rest_m
    triangles, used = submesh(subject.surface.triangles, subject.outside)
    operator, dense = subdivide(triangles, len(used))
    points = operator @ rest[used]
    # noise first: the simplification then decides by chance, and nothing of the subject's mesh is left in the scan's
    noisy = points + random.normal(0, settings.noise_mm / 1000, points.shape)
    mesh = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(noisy), o3d.utility.Vector3iVector(dense))
    mesh = mesh.simplify_quadric_decimation(settings.triangles)
    mesh.remove_degenerate_triangles()
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.triangles).astype(np.int32)
    colour = _paint(vertices, points, dense, operator @ subject.surface.look[used], subject, used)
    rotation, scale, shift = scan_from_world(settings, seed)
    _write_ply(path, scale * vertices @ rotation.T + shift, faces, colour)


def _paint(
    vertices: NDArray, points: NDArray, dense: NDArray, look: NDArray, subject: Subject, used: NDArray
) -> NDArray[np.uint8]:
    """sRGB colours (n, 3) of scan vertices from the nearest points of the subject; light is that of an even sky."""
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(points).query(vertices, k=3, workers=1)
    weight = 1 / np.maximum(distance, 1e-7)
    weight /= weight.sum(1, keepdims=True)
    material = np.zeros(len(subject.bare_m), np.uint8)
    material[subject.surface.triangles.ravel()] = np.repeat(subject.surface.material, 3)
    of_point = np.zeros(len(points), np.uint8)
    of_point[: len(used)] = material[used]
    of_point[dense[-3 * (len(dense) // 4) :].max(1)] = of_point[dense[-3 * (len(dense) // 4) :].min(1)]
    mixed = np.einsum("nk,nkc->nc", weight, look[nearest])
    linear = colours(mixed, of_point[nearest[:, 0]], subject.grain, _COLOUR_FOOTPRINT_MM)
    return encode(linear)


def _write_ply(path: Path | str, vertices: NDArray, triangles: NDArray, colour: NDArray) -> None:
    point = np.dtype([("xyz", "<f4", 3), ("rgb", "u1", 3)])
    face = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
    points, faces = np.empty(len(vertices), point), np.empty(len(triangles), face)
    points["xyz"], points["rgb"] = vertices, colour
    faces["count"], faces["corners"] = 3, triangles
    axes = "".join(f"property float {axis}\n" for axis in "xyz") + "".join(
        f"property uchar {c}\n" for c in ("red", "green", "blue")
    )
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n{axes}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    with atomic_path(path) as temporary, open(temporary, "wb") as handle:
        handle.write(header.encode() + points.tobytes() + faces.tobytes())
