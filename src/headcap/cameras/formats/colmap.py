"""COLMAP sparse model (text): cameras.txt, images.txt, points3D.txt.

The top-left pixel's centre is (0.5, 0.5), half a pixel more than in `Rig`; poses are camera_from_world with quaternions
w x y z. One image per camera, called by the camera's name.
"""

from pathlib import Path

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from headcap.artifacts import atomic_path
from headcap.cameras import Camera, Rig
from headcap.cameras.formats.lenses import five, pinhole, require_no_skew
from headcap.errors import InputError
from headcap.geometry.transforms import rigid

HALF = 0.5
# of each model: focal lengths and centre, then where OpenCV's k1 k2 p1 p2 k3 lie among the parameters
_MODELS = {
    "SIMPLE_PINHOLE": ((0, 0, 1, 2), ()),
    "PINHOLE": ((0, 1, 2, 3), ()),
    "SIMPLE_RADIAL": ((0, 0, 1, 2), (3,)),
    "RADIAL": ((0, 0, 1, 2), (3, 4)),
    "OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7)),
    "FULL_OPENCV": ((0, 1, 2, 3), (4, 5, 6, 7, 8)),
}


def read(path: Path) -> Rig:
    """Read a model folder, binary or text; cameras are called by their image's name without its ending."""
    model = pycolmap.Reconstruction(str(path))
    images = sorted(model.images.values(), key=lambda image: image.image_id)
    return Rig(tuple(_camera(image, model.cameras[image.camera_id]) for image in images))


def _camera(image: pycolmap.Image, lens: pycolmap.Camera) -> Camera:
    name = lens.model.name if hasattr(lens.model, "name") else str(lens.model)
    if name not in _MODELS or (name == "FULL_OPENCV" and np.abs(lens.params[9:]).max() > 0):
        raise InputError(
            f"{image.name}: lens model {name}", expected=f"one of {', '.join(_MODELS)}", remedy="Undistort it first."
        )
    (fx, fy, cx, cy), coefficients = _MODELS[name]
    p = lens.params
    pose = image.cam_from_world().matrix()
    return Camera(
        Path(image.name).stem,
        lens.width,
        lens.height,
        pinhole(p[fx], p[fy], p[cx] - HALF, p[cy] - HALF),
        five([p[i] for i in coefficients]),
        rigid(pose[:, :3], pose[:, 3]),
    )


def write(rig: Rig, path: Path) -> None:
    """Write a text model; FULL_OPENCV where a camera has k3, else OPENCV."""
    require_no_skew(rig, "a COLMAP model")
    cameras, images = ["# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]"], ["# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"]
    for number, camera in enumerate(rig, start=1):
        k, d = camera.matrix, camera.distortion
        model, extra = ("FULL_OPENCV", [*d, 0.0, 0.0, 0.0]) if d[4] else ("OPENCV", [*d[:4]])
        values = [k[0, 0], k[1, 1], k[0, 2] + HALF, k[1, 2] + HALF, *extra]
        cameras.append(f"{number} {model} {camera.width} {camera.height} {_numbers(values)}")
        x, y, z, w = Rotation.from_matrix(camera.camera_from_world[:3, :3]).as_quat(canonical=True)
        pose = _numbers([w, x, y, z, *camera.camera_from_world[:3, 3]])
        images += [f"{number} {pose} {number} {camera.name}.png", ""]
    for name, lines in (("cameras.txt", cameras), ("images.txt", images), ("points3D.txt", ["# no points"])):
        with atomic_path(path / name) as temporary:
            temporary.write_text("\n".join(lines) + "\n")


def _numbers(values: list[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
