"""Kalibr camchain YAML: cam0, cam1, ... with `T_cn_cnm1`, the pose of each camera from the one before it.

Integer pixel centres and axes as in `Rig`; metres. A chain has no world of its own, so `world_from_cam0` is written as an
additional key of cam0 (Kalibr ignores it); without it the first camera is the world.
"""

from pathlib import Path

import numpy as np
import yaml

from headcap.artifacts import atomic_path
from headcap.cameras import Camera, Rig
from headcap.cameras.formats.lenses import five, pinhole, require_no_k3, require_no_skew
from headcap.errors import InputError
from headcap.geometry.transforms import invert


def read(path: Path) -> Rig:
    """Read a camchain of pinhole cameras with radtan or no distortion."""
    chain = yaml.safe_load(path.read_text())
    keys = sorted((key for key in chain if key.startswith("cam")), key=lambda key: int(key[3:]))
    cameras, camera_from_world = [], np.eye(4)
    for key in keys:
        entry = chain[key]
        if entry["camera_model"] != "pinhole" or entry.get("distortion_model", "none") not in ("radtan", "none"):
            raise InputError(
                f"{key}: {entry['camera_model']} with {entry.get('distortion_model')}",
                expected="pinhole with radtan or none",
                remedy="Calibrate with `--models pinhole-radtan`.",
            )
        if "T_cn_cnm1" in entry:
            camera_from_world = np.array(entry["T_cn_cnm1"], float) @ camera_from_world
        elif "world_from_cam0" in entry:
            camera_from_world = invert(np.array(entry["world_from_cam0"], float))
        width, height = entry["resolution"]
        matrix, distortion = pinhole(*entry["intrinsics"]), five(entry.get("distortion_coeffs", []))
        cameras.append(Camera(str(entry.get("name", key)), width, height, matrix, distortion, camera_from_world))
    return Rig(tuple(cameras))


def write(rig: Rig, path: Path) -> None:
    """Write the cameras as a chain in the rig's order."""
    require_no_k3(rig, "Kalibr's radtan model")
    require_no_skew(rig, "Kalibr")
    chain, before = {}, None
    for number, camera in enumerate(rig):
        k = camera.matrix
        entry = {
            "camera_model": "pinhole",
            "intrinsics": [float(v) for v in (k[0, 0], k[1, 1], k[0, 2], k[1, 2])],
            "distortion_model": "radtan",
            "distortion_coeffs": [float(v) for v in camera.distortion[:4]],
            "resolution": [camera.width, camera.height],
            "name": camera.name,
            "rostopic": f"/{camera.name}/image_raw",
        }
        if before is None:
            entry["world_from_cam0"] = invert(camera.camera_from_world).tolist()
        else:
            entry["T_cn_cnm1"] = (camera.camera_from_world @ invert(before)).tolist()
        chain[f"cam{number}"], before = entry, camera.camera_from_world
    with atomic_path(path) as temporary:
        temporary.write_text(yaml.safe_dump(chain, sort_keys=False))
