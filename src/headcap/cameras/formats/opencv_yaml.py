"""OpenCV FileStorage YAML: per camera `<name>_K`, `_D`, `_R`, `_t`, `_size`, and the list `cameras`.

Integer pixel centres and axes as in `Rig`; R and t are camera_from_world; metres.
"""

from pathlib import Path

import cv2
import numpy as np

from headcap.artifacts import atomic_path
from headcap.cameras import Camera, Rig
from headcap.cameras.formats.lenses import five
from headcap.errors import InputError
from headcap.geometry.transforms import rigid


def read(path: Path) -> Rig:
    """Read a file that `write` wrote, or one with the same keys."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    try:
        listed = storage.getNode("cameras")
        names = [listed.at(i).string() for i in range(listed.size())]
        if not names:
            raise InputError(f"{path.name} lists no cameras", expected="a list `cameras`", remedy="Add their names.")
        return Rig(tuple(_camera(storage, name, f"camera_{i}") for i, name in enumerate(names)))
    finally:
        storage.release()


def _camera(storage: cv2.FileStorage, name: str, key: str) -> Camera:
    parts = {}
    for field in ("K", "D", "R", "t", "size"):
        parts[field] = storage.getNode(f"{key}_{field}").mat()
        if parts[field] is None:
            raise InputError(f"{name}: no {key}_{field}", expected="K, D, R, t and size of each camera", remedy="Add it.")
    width, height = (int(value) for value in np.ravel(parts["size"]))
    pose = rigid(parts["R"], np.ravel(parts["t"]))
    return Camera(name, width, height, parts["K"], five(parts["D"]), pose)


def write(rig: Rig, path: Path) -> None:
    """Write one file for the whole rig."""
    # the ending tells OpenCV the syntax, and atomic_path keeps it
    with atomic_path(path) as temporary:
        storage = cv2.FileStorage(str(temporary), cv2.FILE_STORAGE_WRITE)
        storage.startWriteStruct("cameras", cv2.FileNode_SEQ)
        for camera in rig:
            storage.write("", camera.name)
        storage.endWriteStruct()
        for i, camera in enumerate(rig):
            storage.write(f"camera_{i}_size", np.array([[camera.width, camera.height]], np.int32))
            storage.write(f"camera_{i}_K", np.array(camera.matrix))
            storage.write(f"camera_{i}_D", np.array(camera.distortion)[None])
            storage.write(f"camera_{i}_R", np.array(camera.camera_from_world[:3, :3]))
            storage.write(f"camera_{i}_t", np.array(camera.camera_from_world[:3, 3:]))
        storage.release()
