"""transforms.json of nerfstudio and instant-ngp: world_from_camera with OpenGL camera axes (x right, y up, z backward).

The top-left pixel's centre is (0.5, 0.5), half a pixel more than in `Rig`; metres.
"""

import json
from pathlib import Path

import numpy as np

from headcap.artifacts import atomic_path
from headcap.cameras import Camera, Rig
from headcap.cameras.formats.lenses import five, pinhole, require_no_skew
from headcap.geometry.transforms import invert

HALF = 0.5
# between OpenCV's and OpenGL's camera axes, either way
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def read(path: Path) -> Rig:
    """Read one camera per frame; lens values common to all frames may stand at the top."""
    document = json.loads(path.read_text())
    return Rig(tuple(_camera({**document, **frame}) for frame in document["frames"]))


def _camera(entry: dict) -> Camera:
    matrix = pinhole(entry["fl_x"], entry.get("fl_y", entry["fl_x"]), entry["cx"] - HALF, entry["cy"] - HALF)
    distortion = five([entry.get(name, 0.0) for name in ("k1", "k2", "p1", "p2", "k3")])
    camera_from_world = invert(np.array(entry["transform_matrix"], float) @ FLIP)
    name = Path(entry["file_path"]).stem
    return Camera(name, int(entry["w"]), int(entry["h"]), matrix, distortion, camera_from_world)


def write(rig: Rig, path: Path) -> None:
    """Write one frame per camera, called images/<name>.png."""
    require_no_skew(rig, "transforms.json")
    frames = []
    for camera in rig:
        k, d = camera.matrix, camera.distortion
        lens = {"fl_x": k[0, 0], "fl_y": k[1, 1], "cx": k[0, 2] + HALF, "cy": k[1, 2] + HALF}
        lens |= dict(zip(("k1", "k2", "p1", "p2", "k3"), d, strict=True))
        frames.append(
            {
                "file_path": f"images/{camera.name}.png",
                "w": camera.width,
                "h": camera.height,
                **{name: float(value) for name, value in lens.items()},
                "transform_matrix": (invert(camera.camera_from_world) @ FLIP).tolist(),
            }
        )
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps({"camera_model": "OPENCV", "frames": frames}, indent=1) + "\n")
