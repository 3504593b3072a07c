"""Lip contours as the files of labelme, a common editor of polygons: a folder of pictures, each with a JSON file beside it."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import atomic_path
from headcap.lips.contours.detector import CONTOURS
from headcap.lips.features import LipContours
from headcap.recordings.writer import write_picture

_CENTRE = 0.5
"""The editor's coordinates begin at the top-left pixel's corner, ours at its centre."""
_VERSION = "5.0.0"


def save_labelme(folder: Path | str, labels: Mapping[int, LipContours], pictures: Mapping[int, NDArray[np.uint8]]) -> None:
    """Write frames and their contours by frame number, `frame_000012.png` with `frame_000012.json`, for a person to edit.

    Pictures are (height, width, 3) uint8, BGR, contours closed polygons called outer and inner.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for frame, drawn in sorted(labels.items()):
        name = f"frame_{frame:06d}"
        write_picture(folder / f"{name}.png", pictures[frame])
        height, width = pictures[frame].shape[:2]
        content = {
            "version": _VERSION,
            "flags": {},
            "shapes": [_shape(contour, getattr(drawn, contour)) for contour in CONTOURS],
            "imagePath": f"{name}.png",
            "imageData": None,
            "imageHeight": height,
            "imageWidth": width,
        }
        with atomic_path(folder / f"{name}.json") as temporary:
            temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read_labelme(folder: Path) -> dict[int, dict[str, NDArray[np.float64]]]:
    """Rings (k, 2) of each frame by contour, pixels, from the JSON files of a folder; other files and shapes are passed over.

    The frame's number is the last one in the picture's name. Raises `ValueError` for a picture's name without a number.
    """
    frames: dict[int, dict[str, NDArray[np.float64]]] = {}
    for path in sorted(folder.glob("*.json")):
        content = json.loads(path.read_text(encoding="utf-8"))
        numbers = re.findall(r"\d+", Path(content["imagePath"].replace("\\", "/")).stem)
        if not numbers:
            raise ValueError(f"{path.name} is of {content['imagePath']}, whose name ends in no frame number")
        rings = frames.setdefault(int(numbers[-1]), {})
        shapes = (shape for shape in content["shapes"] if shape["label"] in CONTOURS)
        rings.update({shape["label"]: np.array(shape["points"], float) - _CENTRE for shape in shapes})
    if not frames:
        raise ValueError("no JSON file in the folder")
    return frames


def _shape(label: str, ring: NDArray) -> dict:
    points = np.round(ring + _CENTRE, 2).tolist()
    return {"label": label, "points": points, "group_id": None, "shape_type": "polygon", "flags": {}}
