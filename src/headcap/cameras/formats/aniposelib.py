"""aniposelib TOML: `[cam_0]` ... with matrix, distortions, rotation (vector) and translation, camera_from_world.

Integer pixel centres and axes as in `Rig`. The unit is that of the board; aniposelib's habit is millimetres, and this module
writes and reads them: `metadata.unit` tells, and a file without it is taken as millimetres.
"""

import tomllib
from pathlib import Path

import numpy as np
import tomli_w

from headcap.artifacts import atomic_path
from headcap.cameras import Camera, Rig
from headcap.cameras.formats.lenses import five
from headcap.errors import InputError
from headcap.geometry.transforms import from_vector, to_vector

UNITS_M = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


def read(path: Path) -> Rig:
    """Read a calibration of pinhole cameras."""
    document = tomllib.loads(path.read_text())
    unit = document.get("metadata", {}).get("unit", "mm")
    if unit not in UNITS_M:
        raise InputError(f"unit {unit!r} in {path.name}", expected="mm, cm or m", remedy="Correct metadata.unit.")
    entries = [entry for key, entry in document.items() if key != "metadata"]
    return Rig(tuple(_camera(entry, UNITS_M[unit]) for entry in entries))


def _camera(entry: dict, unit_m: float) -> Camera:
    if entry.get("fisheye", False):
        raise InputError(f"{entry['name']}: a fisheye lens", expected="pinhole cameras", remedy="Calibrate without fisheye.")
    pose = from_vector(np.r_[np.ravel(entry["rotation"]), np.ravel(entry["translation"]) * unit_m])
    width, height = entry["size"]
    matrix = np.array(entry["matrix"], float)
    return Camera(str(entry["name"]), int(width), int(height), matrix, five(entry["distortions"]), pose)


def write(rig: Rig, path: Path) -> None:
    """Write in millimetres, as aniposelib users have it."""
    document = {}
    for number, camera in enumerate(rig):
        vector = to_vector(camera.camera_from_world)
        document[f"cam_{number}"] = {
            "name": camera.name,
            "size": [camera.width, camera.height],
            "matrix": camera.matrix.tolist(),
            "distortions": camera.distortion.tolist(),
            "rotation": vector[:3].tolist(),
            "translation": (vector[3:] / UNITS_M["mm"]).tolist(),
            "fisheye": False,
        }
    document["metadata"] = {"adjusted": True, "error": 0.0, "unit": "mm"}
    with atomic_path(path) as temporary:
        temporary.write_text(tomli_w.dumps(document))
