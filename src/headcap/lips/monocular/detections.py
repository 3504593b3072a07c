"""What a face detector of any make found: 68 points of the iBUG scheme or 478 (468) of the face mesh, from JSON or CSV files.

JSON: `{"frames": [{"frame": K, "points": [[x, y], ...]}, ...]}`, or a bare list of point lists, one per frame, null where nothing
was found. CSV with a header: one row per point, `frame,index,x_px,y_px`, or one row per frame, `frame,x_0,...,y_0,...` (other
columns are passed over). Integer coordinates are pixel centres, y grows downwards; right is the subject's.
"""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.geometry.transforms import rigid
from headcap.heads.landmark_table import LandmarkTable, coordinate, landmark_file
from headcap.lips.monocular.problem import Features
from headcap.lips.monocular.surface import FaceSurface

_IBUG = {
    "nose_bridge": 27, "nose_tip": 30, "subnasale": 33, "nose_wing_right": 31, "nose_wing_left": 35, "menton": 8,
    "eye_outer_right": 36, "eye_inner_right": 39, "eye_inner_left": 42, "eye_outer_left": 45,
    "mouth_corner_right": 48, "lip_upper_top": 51, "mouth_corner_left": 54, "lip_lower_bottom": 57,
    "mouth_upper": 62, "mouth_lower": 66,
}  # fmt: skip
_FACE_MESH = {
    "nose_bridge": 168, "nose_tip": 1, "subnasale": 2, "nose_wing_right": 98, "nose_wing_left": 327, "menton": 152,
    "eye_outer_right": 33, "eye_inner_right": 133, "eye_inner_left": 362, "eye_outer_left": 263,
    "eye_top_right": 159, "eye_bottom_right": 145, "eye_top_left": 386, "eye_bottom_left": 374,
    "mouth_corner_right": 61, "lip_upper_top": 0, "mouth_corner_left": 291, "lip_lower_bottom": 17,
    "mouth_upper": 13, "mouth_lower": 14,
}  # fmt: skip
SCHEMES = {68: _IBUG, 468: _FACE_MESH, 478: _FACE_MESH}
"""Index of each of our landmarks among a scheme's points."""
LEAST_LANDMARKS = 6
_PIXEL = ("x_px", "y_px")
_EYES = ("eye_outer_right", "eye_outer_left")


def load_detections(path: Path | str) -> dict[int, NDArray[np.float64]]:
    """Points (68, 468 or 478, 2) by frame number; NaN where a point, and no entry where a face, was not found.

    Raises `InputError` for a file of another ending or form, or another number of points.
    """
    path = landmark_file(path)
    try:
        frames = _read_json(path) if path.suffix == ".json" else _read_csv(path)
    except InputError as error:
        raise InputError(f"{path}: {error.found}", expected=error.expected, remedy=error.remedy) from error
    except (KeyError, TypeError, ValueError, AttributeError, OSError) as error:
        expected = "frames of [x, y] points, as the guide tells them"
        raise InputError(f"{path}: {error}", expected=expected, remedy="Export the detector's output again.") from error
    for frame, points in frames.items():
        if points.ndim != 2 or points.shape[1:] != (2,) or len(points) not in SCHEMES:
            raise InputError(
                f"{path}: frame {frame} has points of shape {points.shape}",
                expected="68 points (iBUG) or 478 (face mesh), each x and y",
                remedy="Export all points of the detector.",
            )
    return frames


def matched(surface: FaceSurface, points: NDArray, camera: Camera, noise_share: float) -> Features:
    """The surface's own landmarks among detected points (68, 468 or 478, 2) of a camera's picture.

    Their noise is that share of the distance between the outer eye corners. Raises `InputError` where fewer than six are left.
    """
    scheme, landmarks = SCHEMES[len(points)], surface.model.landmarks
    names = [name for name in scheme if name in landmarks and surface.number[landmarks[name]] >= 0]
    names = [name for name in names if np.isfinite(points[scheme[name]]).all()]
    if len(names) < LEAST_LANDMARKS:
        raise InputError(
            f"{len(names)} detected points are landmarks of {surface.model.name}",
            expected=f"{LEAST_LANDMARKS} at least",
            remedy="Give a frame that shows the face from the front, or a model with named landmarks.",
        )
    places = np.array([points[scheme[name]] for name in names], float)
    between = [points[scheme[name]] for name in _EYES]
    size = float(np.linalg.norm(between[1] - between[0]))
    size = size if np.isfinite(size) and size > 0 else float(np.ptp(places, axis=0).max())
    vertices = surface.number[[landmarks[name] for name in names]]
    return Features(vertices, places, max(noise_share * size, 0.3), camera)


def place(surface: FaceSurface, features: Features) -> NDArray[np.float64]:
    """camera_from_head (4, 4) of the mean head from its landmarks in a picture; raises `InputError` where there is none.

    Perspective from n points (SQPnP, Terzakis and Lourakis 2020).
    """
    camera, head = features.camera, surface.in_head(surface.at_rest(np.eye(4)))[features.vertices]
    found, turn, shift = cv2.solvePnP(
        head, features.pixels.reshape(-1, 1, 2), camera.matrix, camera.distortion, flags=cv2.SOLVEPNP_SQPNP
    )
    out = rigid(cv2.Rodrigues(turn)[0], np.ravel(shift)) if found else None
    if out is None or not np.isfinite(out).all() or out[2, 3] <= 0 or out[2, 2] >= 0:
        raise InputError(
            "the landmarks show no face that looks at the camera",
            expected="points of one face, x to the right and y downwards",
            remedy="Check the order and the axes of the detector's points.",
        )
    return out


def _read_json(path: Path) -> dict[int, NDArray]:
    content = json.loads(path.read_text(encoding="utf-8"))
    if isinstance(content, dict):
        return {int(entry["frame"]): _array(entry["points"]) for entry in content["frames"] if entry["points"] is not None}
    return {k: _array(points) for k, points in enumerate(content) if points is not None}


def _array(points: list) -> NDArray[np.float64]:
    return np.array([[np.nan, np.nan] if point is None else point[:2] for point in points], float)


def _read_csv(path: Path) -> dict[int, NDArray]:
    table = LandmarkTable.read(path)
    if table.has("frame", "index", "x_px", "y_px"):
        frames: dict[int, dict[int, tuple[float, float]]] = {}
        numbers, pixels = (table.column(name, int) for name in ("frame", "index")), [table.column(x, coordinate) for x in _PIXEL]
        for frame, index, *place in zip(*numbers, *pixels, strict=True):
            frames.setdefault(frame, {})[index] = tuple(place)
        return {frame: _filled(points) for frame, points in frames.items()}
    count = sum(name.startswith("x_") and name[2:].isdigit() for name in table.columns)
    axes = [[f"{axis}_{k}" for k in range(count)] for axis in "xy"]
    if count == 0 or not table.has("frame", *axes[0], *axes[1]):
        raise InputError(
            f"columns {', '.join(table.columns) or 'none'}",
            expected="frame, index, x_px, y_px, or frame, x_0, ..., y_0, ...",
            remedy="Name the columns in the first row.",
        )
    points = np.array([[table.column(name, coordinate) for name in names] for names in axes])
    return dict(zip(table.column("frame", int), points.transpose(2, 1, 0), strict=True))


def _filled(points: dict[int, list[float]]) -> NDArray[np.float64]:
    """Points by index as (68 or 478, 2), the smallest scheme that holds them, NaN where one is missing."""
    size = next((size for size in sorted(SCHEMES) if max(points) < size), max(points) + 1)
    out = np.full((size, 2), np.nan)
    out[list(points)] = list(points.values())
    return out
