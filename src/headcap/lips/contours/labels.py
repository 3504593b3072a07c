"""Lip contours drawn by hand, as files; and contours drawn over pictures, for the eye to judge."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import atomic_path
from headcap.errors import InputError
from headcap.lips.contours.detector import CONTOURS
from headcap.lips.contours.labelme import read_labelme
from headcap.lips.contours.search import resample_ring
from headcap.lips.features import LipContours

_OUTER_BGR, _INNER_BGR = (80, 220, 60), (60, 60, 255)
"""As in the paper's figure 8: the outer contour green, the inner one red."""
_SHIFT = 4


def load_labels(path: Path | str) -> dict[int, LipContours]:
    """Contours by frame number from a JSON or CSV file, see FORMATS.md.

    JSON: `{"frames": [{"frame": K, "outer": [[x, y], ...], "inner": [[x, y], ...]}, ...]}`; CSV with a header, one row per point
    in order: `frame,contour,x_px,y_px`, contour being outer or inner. Pixels, integer coordinates are pixel centres; rings run
    either way round and close by themselves. Raises `InputError` for a file of another ending or form, or a frame that lacks a
    contour. A folder is read as labelme's (`save_labelme`).
    """
    path = Path(path)
    readers = {".json": _read_json, ".csv": _read_csv}
    read = read_labelme if path.is_dir() else readers.get(path.suffix)
    if read is None:
        raise InputError(f"{path} of lip labels", expected="a file that ends in .json or .csv, or a folder", remedy="Convert it.")
    try:
        frames = read(path)
        return {frame: LipContours(rings["outer"], rings["inner"]) for frame, rings in frames.items()}
    except (KeyError, TypeError, ValueError, AttributeError, OSError) as error:
        raise InputError(
            f"{path}: {_told(error)}",
            expected="frames with an outer and an inner ring of [x, y] pixels",
            remedy="Label both contours of each frame; a shut mouth's inner one runs there and back along the line of contact.",
        ) from error


def label_files(path: Path | str) -> list[Path]:
    """The files that `load_labels` reads: the one, or all of a folder."""
    return sorted(Path(path).glob("*.json")) if Path(path).is_dir() else [Path(path)]


def save_labels(path: Path | str, labels: Mapping[int, LipContours]) -> None:
    """Write contours by frame number as JSON that `load_labels` reads and a person may edit."""
    frames = [
        {"frame": int(frame)} | {name: np.round(getattr(found, name), 2).tolist() for name in CONTOURS}
        for frame, found in sorted(labels.items())
    ]
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps({"frames": frames}) + "\n", encoding="utf-8")


def starting_labels(contours: LipContours, outer: int = 20, inner: int = 16) -> LipContours:
    """Contours with so few points that a hand can move each: half of them, evenly, on either side of the corners.

    A corner is the first point of a ring, the other one is that farthest from it. Of contours that a finder or a mesh told.
    """
    return LipContours(_thinned(contours.outer, outer), _thinned(contours.inner, inner))


def draw_contours(
    picture: NDArray[np.uint8],
    contours: LipContours | None,
    *,
    labels: LipContours | None = None,
    thickness: int = 1,
    dot_px: int = 1,
) -> NDArray[np.uint8]:
    """A picture (height, width, 3) uint8, BGR, with contours over it: outer green, inner red; labels beside them dotted.

    Where there are none the picture comes back as it is.
    """
    out = picture.copy()
    for found, dotted in ((labels, True), (contours, False)):
        if found is None:
            continue
        for ring, colour in ((found.outer, _OUTER_BGR), (found.inner, _INNER_BGR)):
            points = np.rint(ring * 2**_SHIFT).astype(np.int32)
            if dotted:
                for x, y in points.tolist():
                    cv2.circle(out, (x, y), dot_px * 2**_SHIFT, colour, -1, cv2.LINE_AA, _SHIFT)
            else:
                cv2.polylines(out, [points], True, colour, thickness, cv2.LINE_AA, _SHIFT)
    return out


def draw_labels(picture: NDArray[np.uint8], labels: LipContours) -> NDArray[np.uint8]:
    """A picture with labels as they were drawn: each point, and the line through them in their order, to check a label file."""
    return draw_contours(picture, labels, labels=labels, dot_px=3)


def _read_json(path: Path) -> dict[int, dict[str, NDArray]]:
    content = json.loads(path.read_text(encoding="utf-8"))
    return {int(entry["frame"]): {name: np.array(entry[name], float) for name in CONTOURS} for entry in content["frames"]}


def _read_csv(path: Path) -> dict[int, dict[str, NDArray]]:
    frames: dict[int, dict[str, list]] = {}
    with path.open(newline="", encoding="utf-8-sig") as handle:
        for row in csv.DictReader(handle, skipinitialspace=True):
            rings = frames.setdefault(int(row["frame"]), {})
            rings.setdefault(row["contour"].strip(), []).append([float(row["x_px"]), float(row["y_px"])])
    return {frame: {name: np.array(points) for name, points in rings.items()} for frame, rings in frames.items()}


def _thinned(ring: NDArray, count: int) -> NDArray[np.float64]:
    other = int(np.linalg.norm(ring - ring[0], axis=1).argmax())
    return resample_ring(ring, 2 * (count // 2), other)


def _told(error: Exception) -> str:
    return f"no {error.args[0]}" if isinstance(error, KeyError) else str(error)
