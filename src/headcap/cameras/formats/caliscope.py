"""caliscope camera_array.toml: `[cameras.0]` ... with matrix, distortions, rotation and translation, camera_from_world.

Integer pixel centres and axes as in `Rig`; metres. Rotations are matrices in older files and vectors in newer ones, both are
read; matrices are written. `rotation_count` (quarter turns of the image before use) must be zero.
"""

import tomllib
from pathlib import Path

import numpy as np
import tomli_w
from scipy.spatial.transform import Rotation

from headcap.artifacts import atomic_path
from headcap.cameras import Camera, Rig
from headcap.cameras.formats.lenses import five
from headcap.errors import InputError
from headcap.geometry.transforms import rigid


def read(path: Path) -> Rig:
    """Read a camera array; cameras without a pose or marked `ignore` are left out."""
    entries = tomllib.loads(path.read_text())["cameras"]
    used = [(key, e) for key, e in entries.items() if not e.get("ignore", False) and "translation" in e]
    return Rig(tuple(_camera(key, entry) for key, entry in sorted(used, key=lambda item: _order(item[0]))))


def _order(key: str) -> tuple[int, str]:
    return (int(key), "") if key.isdigit() else (1 << 30, key)


def _camera(key: str, entry: dict) -> Camera:
    if entry.get("rotation_count", 0):
        raise InputError(
            f"camera {key}: rotation_count {entry['rotation_count']}",
            expected="0",
            remedy="Calibrate with upright images: turning them changes the lens.",
        )
    rotation = np.array(entry["rotation"], float)
    if rotation.size == 3:
        rotation = Rotation.from_rotvec(rotation.ravel()).as_matrix()
    # older files hold rotations with the few digits of a print; the nearest true rotation is meant
    u, _, vt = np.linalg.svd(rotation)
    pose = rigid(u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt, np.ravel(entry["translation"]))
    name = str(entry.get("name", f"cam_{key}"))
    width, height = entry["size"]
    return Camera(name, int(width), int(height), np.array(entry["matrix"], float), five(entry["distortions"]), pose)


def write(rig: Rig, path: Path) -> None:
    """Write a camera array, numbered in the rig's order."""
    cameras = {}
    for number, camera in enumerate(rig):
        cameras[str(number)] = {
            "cam_id": number,
            "name": camera.name,
            "size": [camera.width, camera.height],
            "rotation_count": 0,
            "ignore": False,
            "matrix": camera.matrix.tolist(),
            "distortions": camera.distortion.tolist(),
            "translation": camera.camera_from_world[:3, 3].tolist(),
            "rotation": camera.camera_from_world[:3, :3].tolist(),
        }
    with atomic_path(path) as temporary:
        temporary.write_text(tomli_w.dumps({"cameras": cameras}))
