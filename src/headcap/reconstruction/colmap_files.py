"""COLMAP's dense workspace: images, cameras, tracks, and depth and normal maps in its file format.

    workspace/images/<camera>.png
    workspace/sparse/{cameras,images,points3D}.txt
    workspace/stereo/{patch-match.cfg,fusion.cfg}
    workspace/stereo/{depth_maps,normal_maps}/<camera>.png.geometric.bin

A map file is ASCII `width&height&channels&`, then little-endian float32 with x running fastest, then y, then channel.
Depth is camera z, <= 0 where unknown; normals are in the camera frame, towards the camera (z < 0).
COLMAP's sparse stage puts the centre of the top-left pixel at 0.5, its dense stage at 0; cameras are written for the dense
stage, so principal points stand as they are in `Camera.matrix`.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from headcap.artifacts import atomic_path
from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.reconstruction.maps import DepthMap

Tracks = list[tuple[NDArray, list[int]]]
"""Points (3,) in the world with the indices of the views that see them."""
TRACK_POINTS = 2000
"""Points that link views in a sparse model; `stereo_fusion` takes the overlap of views from them alone."""


def write_map(path: Path, values: NDArray) -> None:
    """Write a depth map (height, width) or a normal map (height, width, 3)."""
    values = values[..., None] if values.ndim == 2 else values
    height, width, channels = values.shape
    planar = np.ascontiguousarray(np.moveaxis(values, -1, 0), "<f4")
    with atomic_path(path) as temporary:
        temporary.write_bytes(f"{width}&{height}&{channels}&".encode() + planar.tobytes())


def read_map(path: Path) -> NDArray[np.float32]:
    """Read a map file: (height, width) for one channel, else (height, width, channels)."""
    content = Path(path).read_bytes()
    head = content[:64].split(b"&", 3)
    try:
        width, height, channels = (int(part) for part in head[:3])
        values = np.frombuffer(content[sum(len(part) + 1 for part in head[:3]) :], "<f4").reshape(channels, height, width)
    except ValueError as error:
        raise InputError(
            f"{path}: {len(content)} bytes beginning {content[:16]!r}",
            expected="a COLMAP map: width&height&channels& and as many float32",
            remedy="Run COLMAP's patch match again; the file may be cut short.",
        ) from error
    return values[0].copy() if channels == 1 else np.moveaxis(values, 0, -1).copy()


def write_workspace(
    folder: Path, cameras: Sequence[Camera], images_bgr: Sequence[NDArray], sources: Sequence[Sequence[int]], tracks: Tracks
) -> None:
    """Write images, sparse model and configurations; cameras without distortion, images at their size."""
    if any(camera.distortion.any() for camera in cameras):
        raise ValueError("a dense workspace holds distortion-free views")
    for part in ("images", "sparse", "stereo/depth_maps", "stereo/normal_maps"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    for camera, image in zip(cameras, images_bgr, strict=True):
        cv2.imwrite(str(folder / "images" / f"{camera.name}.png"), image)
    for name, text in _sparse_model(cameras, tracks).items():
        (folder / "sparse" / name).write_text(text)
    names = [f"{camera.name}.png" for camera in cameras]
    matched = [(name, chosen) for name, chosen in zip(names, sources, strict=True) if len(chosen)]
    config = "".join(f"{name}\n{', '.join(names[s] for s in chosen)}\n" for name, chosen in matched)
    (folder / "stereo" / "patch-match.cfg").write_text(config)
    (folder / "stereo" / "fusion.cfg").write_text("".join(f"{name}\n" for name, _ in matched))


def _sparse_model(cameras: Sequence[Camera], tracks: Tracks) -> dict[str, str]:
    lenses, images, points = [], [], []
    observed: list[list[str]] = [[] for _ in cameras]
    for number, (point, seen_by) in enumerate(tracks, start=1):
        track = []
        for view in seen_by:
            u, v = cameras[view].project(point)[0]
            track.append(f"{view + 1} {len(observed[view])}")
            observed[view].append(f"{float(u)!r} {float(v)!r} {number}")
        points.append(f"{number} {_numbers(point)} 128 128 128 0 {' '.join(track)}")
    for number, camera in enumerate(cameras, start=1):
        k = camera.matrix
        lens = _numbers([k[0, 0], k[1, 1], k[0, 2], k[1, 2]])
        lenses.append(f"{number} PINHOLE {camera.width} {camera.height} {lens}")
        x, y, z, w = Rotation.from_matrix(camera.camera_from_world[:3, :3]).as_quat(canonical=True)
        pose = _numbers([w, x, y, z, *camera.camera_from_world[:3, 3]])
        images += [f"{number} {pose} {number} {camera.name}.png", " ".join(observed[number - 1])]
    return {
        name: "\n".join(lines) + "\n"
        for name, lines in (("cameras.txt", lenses), ("images.txt", images), ("points3D.txt", points))
    }


def _numbers(values: Sequence[float] | NDArray) -> str:
    return " ".join(repr(float(value)) for value in values)


def ball_tracks(cameras: Sequence[Camera], centre: NDArray, radius: float) -> Tracks:
    """Stand-in points on a ball around the subject, each seen by the cameras that face it; links views before stereo."""
    index = np.arange(TRACK_POINTS) + 0.5
    polar, azimuth = np.arccos(1 - 2 * index / TRACK_POINTS), np.pi * (1 + 5**0.5) * index
    outward = np.stack([np.sin(polar) * np.cos(azimuth), np.cos(polar), np.sin(polar) * np.sin(azimuth)], 1)
    points = centre + radius * outward
    facing = np.array([((camera.centre - points) * outward).sum(1) > 0 for camera in cameras])
    return _tracks(cameras, points, facing)


def map_tracks(maps: Sequence[DepthMap]) -> Tracks:
    """Points of the depth maps themselves, each with the views whose maps agree within 1 %."""
    cameras = [depth_map.camera for depth_map in maps]
    points = np.concatenate([_some_points(depth_map, TRACK_POINTS // len(maps) + 1) for depth_map in maps])
    agrees = np.zeros((len(maps), len(points)), bool)
    for view, depth_map in enumerate(maps):
        pixels, z = depth_map.camera.project(points)
        inside = np.isfinite(pixels).all(1) & (pixels >= 0).all(1) & (pixels <= np.array(depth_map.camera.size) - 1).all(1)
        column, row = np.rint(pixels[inside]).astype(int).T
        agrees[view, inside] = np.abs(depth_map.depth[row, column] / z[inside] - 1) < 0.01
    return _tracks(cameras, points, agrees)


def _some_points(depth_map: DepthMap, count: int) -> NDArray:
    rows, columns = np.nonzero(depth_map.known)
    picked = np.linspace(0, len(rows) - 1, min(count, len(rows))).astype(int)
    z = depth_map.depth[rows[picked], columns[picked]].astype(float)
    local = np.stack([columns[picked], rows[picked], np.ones(len(picked))], 1) @ np.linalg.inv(depth_map.camera.matrix).T
    pose = depth_map.camera.camera_from_world
    return (local * z[:, None] - pose[:3, 3]) @ pose[:3, :3]


def _tracks(cameras: Sequence[Camera], points: NDArray, seen: NDArray[np.bool_]) -> Tracks:
    for view, camera in enumerate(cameras):
        pixels, _ = camera.project(points)
        with np.errstate(invalid="ignore"):
            seen[view] &= np.isfinite(pixels).all(1) & (pixels >= 0).all(1) & (pixels < np.array(camera.size)).all(1)
    return [(point, np.nonzero(column)[0].tolist()) for point, column in zip(points, seen.T, strict=True) if column.sum() >= 2]


def write_depth_maps(folder: Path, maps: Sequence[DepthMap]) -> None:
    """Write maps where COLMAP looks for them: `write_workspace` must have made the folder."""
    for depth_map in maps:
        file = f"{depth_map.name}.png.geometric.bin"
        write_map(folder / "stereo" / "depth_maps" / file, depth_map.depth)
        write_map(folder / "stereo" / "normal_maps" / file, depth_map.normal)


def read_depth_maps(folder: Path, cameras: Sequence[Camera], images_bgr: Sequence[NDArray]) -> list[DepthMap]:
    """Read geometric maps of distortion-free cameras; raises `InputError` where one is missing or all are empty."""
    maps = [_read_depth_map(folder, camera, image) for camera, image in zip(cameras, images_bgr, strict=True)]
    if not any(depth_map.known.any() for depth_map in maps):
        raise InputError(
            f"{folder}: all {len(maps)} depth maps are empty",
            expected="depths in most pixels of the subject",
            remedy="Some CUDA builds of COLMAP return empty maps without an error: use engine 'patchmatch'.",
        )
    return maps


def _read_depth_map(folder: Path, camera: Camera, image_bgr: NDArray) -> DepthMap:
    file = f"{camera.name}.png.geometric.bin"
    paths = [folder / "stereo" / part / file for part in ("depth_maps", "normal_maps")]
    for path in paths:
        if not path.is_file():
            raise InputError(f"{path} is missing", expected="a geometric map per view", remedy="Run COLMAP's patch match again.")
    depth, normal = (read_map(path) for path in paths)
    if depth.shape != (camera.height, camera.width) or normal.shape != (*depth.shape, 3):
        raise InputError(
            f"{paths[0]}: map of {depth.shape}",
            expected=f"{(camera.height, camera.width)}",
            remedy="Do not shrink images in COLMAP.",
        )
    known = np.isfinite(depth) & (depth > 0)
    depth = np.where(known, depth, 0).astype(np.float32)
    return DepthMap(
        camera=camera,
        depth=depth,
        normal=np.where(known[..., None], normal, 0).astype(np.float32),
        confidence=known.astype(np.float32),
        # COLMAP gives no variance: a pixel's width on the surface, so that nearer and longer lenses weigh more
        sigma=(depth / camera.matrix[0, 0]).astype(np.float32),
        colour=image_bgr[..., ::-1].copy(),
        chosen=known,
    )
