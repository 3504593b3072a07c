"""Files of landmarks over time, as a face tracker's output is brought in.

JSON, artifact `headcap.landmarks/1`: `time_s`, a list of f rising moments; `points`, a list of k places on the head, each
`{"name": NAME}` for one of the model's own landmarks, or a name of your own with `"vertex": V`, with `"triangle": T,
"barycentric": [a, b, c]`, or with `"corners": [U, V, W]` (vertices) in place of the triangle; and `positions_m` (f lists of k
`[x, y, z]`, metres in any frame of the room) or `pixels` (f lists of k `[x, y]`; integer coordinates are pixel centres, y grows
downwards), null where a landmark was not seen.

CSV with a header, one row per landmark seen, in any order: `time_s,landmark,x_m,y_m,z_m` or `time_s,landmark,x_px,y_px`. A
landmark is the name of one of the model's, `vertex:V`, or `triangle:T:a:b:c`. Rows with the same `time_s` are one frame; what has
no row, or no numbers in it, was not seen.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import ArtifactError, load_json, save_json
from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.heads import HeadModel
from headcap.heads.landmark_table import LandmarkTable, coordinate, landmark_file
from headcap.neck.landmarks.landmarks import LandmarkPoints, Landmarks

KIND, SCHEMA = "landmarks", 1
_FORMS = {"positions_m": 3, "pixels": 2}
_COLUMNS = {3: ("x_m", "y_m", "z_m"), 2: ("x_px", "y_px")}


def load_landmarks(path: Path | str, model: HeadModel, camera: Camera | None = None) -> Landmarks:
    """Read landmarks (.json or .csv) on a head model; `camera` took the picture of those in pixels.

    Raises `ArtifactError` for a damaged file or another artifact, `InputError` for one of another ending, without landmarks, in
    pixels without a camera, in metres with one, or with landmarks that the model has not.
    """
    path = landmark_file(path)
    try:
        time_s, places, seen = _read_json(path) if path.suffix == ".json" else _read_csv(path)
        if seen.ndim == 3 and seen.shape[2] == 3 and camera is not None:
            raise InputError("landmarks in metres with a camera", expected="pixels, or no camera", remedy="Leave the camera out.")
        return Landmarks(_points(model, places), time_s, seen, camera)
    except InputError as error:
        raise InputError(f"{path}: {error.found}", expected=error.expected, remedy=error.remedy) from error


def save_landmarks(path: Path | str, landmarks: Landmarks) -> None:
    """Write as JSON artifact `headcap.landmarks/1`, every landmark with its vertex or the corners of its triangle."""
    points = landmarks.points
    form = "pixels" if landmarks.flat else "positions_m"
    rows = [[None if np.isnan(place).any() else place.tolist() for place in frame] for frame in landmarks.seen]
    places = []
    for name, corners, shares in zip(points.names, points.corners, points.shares, strict=True):
        on = {"vertex": int(corners[0])} if len(set(corners.tolist())) == 1 else None
        places.append({"name": name} | (on or {"corners": corners.tolist(), "barycentric": shares.tolist()}))
    save_json(path, KIND, SCHEMA, {"time_s": landmarks.time_s.tolist(), "points": places, form: rows})


def _read_json(path: Path) -> tuple[NDArray, list[dict], NDArray]:
    content = load_json(path, KIND, SCHEMA)
    forms = [form for form in _FORMS if form in content]
    if len(forms) != 1:
        raise InputError(
            f"{' and '.join(forms) or 'no coordinates'}", expected="positions_m or pixels", remedy="Give one of them."
        )
    try:
        time_s, places = np.array(content["time_s"], float), [dict(place) for place in content["points"]]
        size = _FORMS[forms[0]]
        missing = [np.nan] * size
        rows = [[missing if place is None else place for place in frame] for frame in content[forms[0]]]
        return time_s, places, np.array(rows, float).reshape(len(rows), -1, size)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise ArtifactError(f"{path} holds no whole landmarks ({error}); write it again") from error


def _read_csv(path: Path) -> tuple[NDArray, list[dict], NDArray]:
    table = LandmarkTable.read(path)
    axes = next((axes for axes in _COLUMNS.values() if table.has("time_s", "landmark", *axes)), None)
    if axes is None:
        raise InputError(
            f"columns {', '.join(table.columns) or 'none'}",
            expected="time_s, landmark and x_m, y_m, z_m, or time_s, landmark and x_px, y_px",
            remedy="Name the columns in the first row.",
        )
    times, told = table.column("time_s", float), table.column("landmark", str.strip)
    places = np.array([table.column(axis, coordinate) for axis in axes]).T
    names, (time_s, frame) = list(dict.fromkeys(told)), np.unique(times, return_inverse=True)
    seen = np.full((len(time_s), len(names), len(axes)), np.nan)
    seen[frame, [names.index(name) for name in told]] = places
    return time_s, [_place_of(name) for name in names], seen


def _place_of(name: str) -> dict:
    """A CSV's landmark as JSON has it."""
    kind, *numbers = name.split(":")
    try:
        if kind == "vertex" and len(numbers) == 1:
            return {"name": name, "vertex": int(numbers[0])}
        if kind == "triangle" and len(numbers) == 4:
            return {"name": name, "triangle": int(numbers[0]), "barycentric": [float(n) for n in numbers[1:]]}
    except ValueError as error:
        raise InputError(f"landmark {name!r}", expected="vertex:V or triangle:T:a:b:c", remedy="Correct it.") from error
    return {"name": name}


def _points(model: HeadModel, places: list[dict]) -> LandmarkPoints:
    if not places:
        raise InputError("no landmarks", expected="one at least", remedy="Look at the tracker's output.")
    return LandmarkPoints.joined([_point(model, place) for place in places])


def _point(model: HeadModel, place: dict) -> LandmarkPoints:
    name = str(place.get("name", ""))
    try:
        if "vertex" in place:
            return LandmarkPoints.of_vertices(model, [int(place["vertex"])], [name or f"vertex {place['vertex']}"])
        if "triangle" in place:
            return LandmarkPoints.of_triangles(model, [int(place["triangle"])], np.array([place["barycentric"]], float), [name])
        if "corners" in place:
            corners = np.array([place["corners"]], np.int64).reshape(1, 3)
            return LandmarkPoints((name,), corners, np.array([place["barycentric"]], float).reshape(1, 3)).checked(model)
    except (KeyError, TypeError) as error:
        raise InputError(f"landmark {place}", expected="its vertex, or triangle and barycentric", remedy="Correct it.") from error
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"landmark {place}", expected="numbers", remedy="Correct it.") from error
    return LandmarkPoints.named(model, [name])
