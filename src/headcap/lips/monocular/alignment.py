"""A generic face drawn to the one in the picture by optical flow, where brightness alone would settle beside it.

Between a face of generic albedo and a picture, blotches and lamps differ more than a shift of a few pixels does. Both are
normalised locally in brightness and redness, so that what faces share (lips, nostrils, lids, irises, brows) stands out, and the
dense flow (DIS) between the two tells where each of these has to go.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.lips.monocular.finder import generic_colour, locally_normalised, looks_of
from headcap.lips.monocular.flow import flow_there_and_back
from headcap.lips.monocular.photometric import Level
from headcap.lips.monocular.problem import Appearance, Features
from headcap.lips.monocular.surface import Estimate, FaceSurface
from headcap.meshes.rasteriser import rasterise

_SCLERA, _IRIS, _IRIS_RADIUS_M = (1.2, 1.05, 0.8), (0.3, 0.3, 0.25), 0.006
"""Blue, green, red against the skin's: eyeballs are less red than any skin."""
_EYE_REACH_M = 0.005
_CONTRAST_SHARE = 0.125
"""Standard deviation of the window of the local normalisation over the face's width."""
_FLOOR_SHARE = 0.3
_CODE = 40.0
"""Grey values per standard deviation: pictures of flow are 8 bits deep."""
_RETURN_PX = 1.0
"""Flow there and back may miss by so much."""
_FACING = -0.4
_TELLING_SHARE = 0.5
"""Half of the places, those with most texture, are followed."""
_INDEPENDENT = 20
"""As many independent observations all places together are worth: neighbours move alike."""
_MOST = 400


@dataclass(frozen=True, eq=False)
class _Pair:
    """The rendered generic face and the picture, normalised, where the face lies."""

    drawn: NDArray[np.uint8]
    seen: NDArray[np.uint8]
    hit: NDArray[np.bool_]


def open_eyed_colour(surface: FaceSurface) -> NDArray[np.float64]:
    """(n, 3) blue, green, red of a generic face with white eyeballs and dark irises that look ahead."""
    colour, model = generic_colour(surface), surface.model
    eyes = model.regions.get("eyes", np.zeros(len(model.vertices), bool))[surface.vertices]
    colour[eyes] = _SCLERA
    rest = model.vertices[surface.vertices]
    for side in ("left", "right"):
        if any(f"eye_{end}_{side}" not in model.landmarks for end in ("inner", "outer", "top", "bottom")):
            continue
        ends = {end: model.vertices[model.landmarks[f"eye_{end}_{side}"]] for end in ("inner", "outer", "top", "bottom")}
        middle = [0.5 * (ends["inner"][0] + ends["outer"][0]), 0.5 * (ends["top"][1] + ends["bottom"][1])]
        colour[eyes & (np.linalg.norm(rest[:, :2] - middle, axis=1) < _IRIS_RADIUS_M)] = _IRIS
    return colour


def _shared_features(surface: FaceSurface) -> NDArray[np.bool_]:
    """(n,) nose, mouth and chin, as wide as the eyes: lids and brows are dark or bright as they like, hair frames cheeks."""
    model, rest = surface.model, surface.model.vertices[surface.vertices]
    marks = {name: model.vertices[vertex] for name, vertex in model.landmarks.items()}
    half = 0.5 * np.linalg.norm(marks["eye_outer_left"] - marks["eye_outer_right"])
    low_lid = min(marks[f"eye_bottom_{side}"][1] for side in ("left", "right"))
    return (np.abs(rest[:, 0]) < half) & (rest[:, 1] > marks["chin"][1]) & (rest[:, 1] < low_lid - _EYE_REACH_M)


def flow_features(surface: FaceSurface, level: Level, estimate: Estimate, appearance: Appearance, finest: int) -> Features | None:
    """Where a picture's flow sends places of the rendered face; None where too few of them are found.

    `finest` is the number of the level among those of `appearance`. Standard deviations make all places together worth
    `_INDEPENDENT` ones that are a pixel uncertain.
    """
    vertices = surface.in_camera(estimate)
    normals = surface.normals(vertices)
    pair = _normalised_pair(surface, level, estimate, vertices, appearance.colours(finest, normals))
    flow, missed_px = flow_there_and_back(pair.drawn, pair.seen)
    sound = (missed_px < _RETURN_PX) & pair.hit
    pixels = estimate.camera(level.camera).project(vertices)[0]
    place = np.rint(pixels).astype(int)
    height, width = pair.hit.shape
    inside = ((place >= 0) & (place < [width, height])).all(axis=1) & (normals[:, 2] < _FACING)
    chosen = np.flatnonzero(inside & _shared_features(surface))
    chosen = chosen[sound[place[chosen, 1], place[chosen, 0]]]
    if len(chosen) < _INDEPENDENT:
        return None
    texture = _texture(pair.drawn)[place[chosen, 1], place[chosen, 0]]
    chosen = chosen[texture > np.quantile(texture, 1 - _TELLING_SHARE)]
    chosen = chosen[:: max(1, len(chosen) // _MOST)]
    found = pixels[chosen] + flow[place[chosen, 1], place[chosen, 0]]
    return Features(chosen, found, float(np.sqrt(len(chosen) / _INDEPENDENT)), level.camera)


def _normalised_pair(surface: FaceSurface, level: Level, estimate: Estimate, vertices: NDArray, colours: NDArray) -> _Pair:
    raster = rasterise(estimate.camera(level.camera), vertices, surface.triangles, cull_back_faces=True)
    drawn = raster.interpolate(surface.triangles, colours)
    hit = raster.hit & np.isfinite(drawn).all(axis=2)
    mask, window_px = hit.astype(np.float32), _CONTRAST_SHARE * np.sqrt(hit.sum())
    whole = np.where(hit[..., None], drawn, level.picture).astype(np.float32)
    codes = []
    for picture in (whole, level.picture):
        bright, red = np.moveaxis(locally_normalised(looks_of(picture), mask, window_px, _FLOOR_SHARE), 2, 0)
        # lips are dark in one and red in the other: their difference shows them twice
        codes.append(np.clip(127 + _CODE * (bright - red), 0, 255).astype(np.uint8))
    return _Pair(*codes, hit)


def _texture(code: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(height, width) mean squared gradient about a pixel."""
    grey = code.astype(np.float32)
    squares = cv2.Sobel(grey, -1, 1, 0) ** 2 + cv2.Sobel(grey, -1, 0, 1) ** 2
    return cv2.GaussianBlur(squares, (0, 0), 2.0)
