"""A frontal face found from nothing: a generic face, rendered from the head model itself, matched at all places and sizes.

No weights and no pictures of people are needed: what faces share under most lights is that brows, eyes and mouth are darker than
the skin around them, and where they lie on a head. Pictures are normalised locally first, which takes lamps and complexion out.

How far its score can be trusted, at the usual threshold of 0.41: seven people in the middle of a sentence score 0.43 to 0.50, two
rehearsed heads under four sets of lamps from the front or above, and turned by 20 degrees, 0.43 to 0.53: all are found. Lit from
below (0.39, 0.40), turned by 40 degrees (0.36, 0.37), bald and without brows as a rendered head of another make (0.35) faces are
not found. Of 23 pictures without a face (heads from behind, boards, noise, streets, statues of a temple) none passes, the likest
with 0.405. The margins are narrow: a detector's points are better wherever there are any.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.geometry.transforms import rigid
from headcap.lips.monocular.pictures import linear_light
from headcap.lips.monocular.surface import FaceSurface
from headcap.meshes.rasteriser import rasterise

_TEMPLATE_PX = 36
"""Width of the matched face: brows and mouth are a few pixels high."""
_SIZE_STEP = 1.1
_LARGEST_SHARE, _SMALLEST_SHARE = 0.8, 0.25
"""Width of the face over the shorter side of the picture."""
_PITCHES_DEG = (-12.0, 0.0, 12.0)
_DISTANCE_M = 0.9
_CONTRAST_PX = 9.0
"""Standard deviation of the window of the local normalisation, in pixels of the matched face."""
_BROW_M = (0.024, 0.0055)
"""Half length and half height of a brow."""
_BROW_LIFT_M = 0.017
"""Of a brow over the upper lid's middle."""
_DARK = {"eyes": 0.35, "lid_rims": 0.35, "lips": 0.6, "mouth_interior": 0.15}
_BROW_DARK = 0.45
_REACH_ACROSS, _REACH_UP = 1.25, 0.75
"""What is matched, about the middle between the outer eye corners, over half their distance."""
_LAMP, _AMBIENT = np.array([0.0, -0.45, -0.89]), 0.4
"""Towards the usual lamp, from above the camera; and the light from all around."""
_DULL = -0.4
"""Redness of brows and eyes against the skin, in lips'."""
_WORTH = (1.0, 0.7)
"""Of brightness and redness in the comparison."""
_LEAST_SPREAD = 0.02
"""Of a logarithm: less is a sensor's noise."""
_APART = 0.6
"""Distance of two faces' middles, over the larger one's width, below which they are the same."""
_RIVAL_SCORE, _RIVAL_WIDTH = 0.75, 0.8
"""A second face scores so much of the likest one's score at least; and it is about as large from so much of its width on."""
RIVAL_SHARE = 0.92
"""Of the score that makes a first face, that makes a second one: beside a face, what is none was never liker than 0.36, and
second people not less than 0.39."""
FACING = np.diag([1.0, -1.0, -1.0])
"""Rotation of a head that looks into the camera."""


@dataclass(frozen=True, eq=False)
class FoundFace:
    """Where a face seems to be."""

    camera_from_head: NDArray[np.float64]
    """(4, 4) of the mean head."""
    score: float
    """Normalised cross-correlation with the generic face, -1 to 1."""
    middle_px: NDArray[np.float64]
    """(2,) of the face in the picture."""
    width_px: float


def generic_albedo(surface: FaceSurface) -> NDArray[np.float64]:
    """(n,) of a face of no one in particular: 1 on skin, less on brows, eyes, lips and inside the mouth."""
    model, out = surface.model, np.ones(len(surface.vertices))
    for name, mask in model.regions.items():
        for part, value in _DARK.items():
            if name.startswith(part):
                out[mask[surface.vertices]] = value
    rest = model.vertices[surface.vertices]
    for side in ("left", "right"):
        if f"eye_outer_{side}" in model.landmarks and f"eye_inner_{side}" in model.landmarks:
            ends = model.vertices[[model.landmarks[f"eye_{end}_{side}"] for end in ("outer", "inner")]]
            away = (rest - ends.mean(axis=0))[:, :2] - [0.0, _BROW_LIFT_M]
            inside = ((away / _BROW_M) ** 2).sum(axis=1)
            front = rest[:, 2] > ends[:, 2].min() - 0.02
            out -= front * (1.0 - _BROW_DARK) * np.exp(-(inside**2))
    return np.clip(out, 0.1, 1.0)


def generic_colour(surface: FaceSurface) -> NDArray[np.float64]:
    """(n, 3) blue, green, red of `generic_albedo`: lips keep more of their red than of the rest."""
    grey, lips = generic_albedo(surface), _redness(surface) > 0
    out = np.repeat(grey[:, None], 3, axis=1)
    out[lips] *= [0.95, 0.85, 1.2]
    return out


def mistaken(found: FoundFace) -> list[NDArray[np.float64]]:
    """Places camera_from_head (4, 4) that look alike: the one found, and those where brows and eyes are taken for each other."""
    out = []
    for lift_m in (0.0, _BROW_LIFT_M, -_BROW_LIFT_M):
        moved = found.camera_from_head.copy()
        moved[:3, 3] += lift_m * moved[:3, 1]
        out.append(moved)
    return out


def find_faces(surface: FaceSurface, camera: Camera, picture: NDArray[np.uint8], least_score: float) -> list[FoundFace]:
    """Places in a picture (height, width, 3) that look like a face seen from the front, apart from each other, likest first.

    The likest one of all is among them whatever its score, the others score `least_score` and more; none in a picture too small
    for any. The camera's axes; lens distortion is passed over.
    """
    looks, found = looks_of(linear_light(picture)), []
    short = min(picture.shape[:2])
    for pitch_deg in _PITCHES_DEG:
        template = _Template.of(surface, pitch_deg)
        width = _LARGEST_SHARE * short
        while width > max(_SMALLEST_SHARE * short, 0.5 * _TEMPLATE_PX):
            found += template.places(looks, camera, width, least_score)
            width /= _SIZE_STEP
    return _apart(sorted(found, key=lambda face: -face.score))


def followed(faces: list[FoundFace]) -> tuple[FoundFace, list[FoundFace]]:
    """Of several faces, likest first, the one to follow, which is the largest, and the others.

    What scores far below the likest is no second face, however large it is. Raises `InputError` where two are about as large.
    """
    alike = [face for face in faces if face.score >= _RIVAL_SCORE * faces[0].score]
    largest, *others = sorted(alike, key=lambda face: -face.width_px)
    if others and others[0].width_px > _RIVAL_WIDTH * largest.width_px:
        places = " and ".join(f"({x:.0f}, {y:.0f})" for x, y in (largest.middle_px, others[0].middle_px))
        raise InputError(
            f"{len(alike)} faces of about one size, at {places} px",
            expected="one face, or one that is clearly the largest",
            remedy="Cut the picture down to one person, or give a detector's points of the one to follow.",
        )
    return largest, others


def _apart(faces: list[FoundFace]) -> list[FoundFace]:
    """Those of faces, likest first, that do not lie on a likelier one."""
    kept: list[FoundFace] = []
    for face in faces:
        if all(np.linalg.norm(face.middle_px - other.middle_px) > _APART * max(face.width_px, other.width_px) for other in kept):
            kept.append(face)
    return kept


@dataclass(frozen=True, eq=False)
class _Template:
    """The generic face at one pitch, normalised."""

    picture: NDArray[np.float32]
    mask: NDArray[np.float32]
    origin: NDArray[np.float64]
    """(2,) where the head's own origin is projected, in the template's pixels."""
    rotation: NDArray[np.float64]
    """Of the head in the camera's axes."""
    focal_px: float

    @classmethod
    def of(cls, surface: FaceSurface, pitch_deg: float) -> _Template:
        """The generic face before a camera, turned by `pitch_deg` about the camera's x axis, lit from `_LAMP`."""
        vertices = surface.in_head(surface.at_rest(np.eye(4)))
        turn = cv2.Rodrigues(np.array([np.radians(pitch_deg), 0.0, 0.0]))[0] @ FACING
        placed = vertices @ turn.T + [0.0, 0.0, _DISTANCE_M]
        wide = np.ptp(placed[:, 0] / placed[:, 2])
        focal, side = _TEMPLATE_PX / wide, 3 * _TEMPLATE_PX
        matrix = np.array([[focal, 0, side / 2], [0, focal, side / 2], [0, 0, 1]])
        view = Camera("template", side, side, matrix, np.zeros(5), np.eye(4))
        raster = rasterise(view.scaled(3), placed, surface.triangles)
        bright = generic_albedo(surface) * (_AMBIENT + (1 - _AMBIENT) * np.clip(surface.normals(placed) @ _LAMP, 0, 1))
        both = np.stack([np.log(np.maximum(bright, 0.02)), _redness(surface)], axis=1)
        drawn = np.nan_to_num(raster.interpolate(surface.triangles, both))
        hit = cv2.resize(raster.hit.astype(np.float32), (side, side), interpolation=cv2.INTER_AREA)
        drawn = (
            cv2.resize(drawn.astype(np.float32), (side, side), interpolation=cv2.INTER_AREA) / np.maximum(hit, 1e-3)[..., None]
        )
        inside = hit > 0.99
        # a fringe, a beard below the chin and the ears' side tell nothing: the middle of the face does
        inner = _inner(surface, placed, matrix, side)
        inside &= inner
        rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
        box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        normalised = _normalised(np.where(inside[..., None], drawn, 0.0).astype(np.float32), inside.astype(np.float32))
        origin = np.array([side / 2 - columns[0], side / 2 - rows[0]])
        return cls(normalised[box], np.repeat(inside[box].astype(np.float32)[..., None], 2, axis=2), origin, turn, focal)

    def places(self, looks: NDArray, camera: Camera, width_px: float, least_score: float) -> list[FoundFace]:
        """The best place of a face so wide, and the other local maxima of the score that reach `least_score`."""
        share = _TEMPLATE_PX / width_px
        size = round(looks.shape[1] * share), round(looks.shape[0] * share)
        if size[0] < self.picture.shape[1] or size[1] < self.picture.shape[0]:
            return []
        small = cv2.resize(looks, size, interpolation=cv2.INTER_AREA if share < 1 else cv2.INTER_LINEAR)
        scores = cv2.matchTemplate(_normalised(small), self.picture, cv2.TM_CCOEFF_NORMED, mask=self.mask)
        scores = np.where(np.isfinite(scores), scores, -1.0).astype(np.float32)
        peaks = (scores >= least_score) & (scores == cv2.dilate(scores, np.ones((_TEMPLATE_PX // 2,) * 2)))
        peaks.flat[int(scores.argmax())] = True
        return [self._face(camera, share, x, y, float(scores[y, x])) for y, x in np.argwhere(peaks)]

    def _face(self, camera: Camera, share: float, x: int, y: int, score: float) -> FoundFace:
        """The face whose box's corner lies at (x, y) of the picture made smaller to a share."""
        depth = _DISTANCE_M * camera.matrix[0, 0] * share / self.focal_px
        at = (np.array([x, y]) + self.origin + 0.5) / share - 0.5
        shift = np.append((at - camera.matrix[:2, 2]) * depth / camera.matrix[[0, 1], [0, 1]], depth)
        middle = (np.array([x, y]) + 0.5 * np.array(self.picture.shape[1::-1])) / share
        return FoundFace(rigid(self.rotation, shift), score, middle, _TEMPLATE_PX / share)


def _inner(surface: FaceSurface, placed: NDArray, matrix: NDArray, side: int) -> NDArray[np.bool_]:
    """(side, side) from over the brows to under the lower lip, and from cheekbone to cheekbone."""
    landmarks, number = surface.model.landmarks, surface.number
    pixels = placed[:, :2] / placed[:, 2:] * [matrix[0, 0], matrix[1, 1]] + matrix[:2, 2]
    eyes = pixels[number[[landmarks["eye_outer_right"], landmarks["eye_outer_left"]]]]
    low = 0.5 * (pixels[number[landmarks["chin"]], 1] + pixels[number[landmarks["lip_lower_bottom"]], 1])
    middle, half = eyes.mean(axis=0), 0.5 * np.ptp(eyes[:, 0])
    y, x = np.mgrid[:side, :side]
    return (np.abs(x - middle[0]) < _REACH_ACROSS * half) & (y > middle[1] - _REACH_UP * half) & (y < low)


def looks_of(linear: NDArray[np.float32]) -> NDArray[np.float32]:
    """Logarithms of brightness and of red over green (height, width, 2) of linear light (height, width, 3), blue first.

    Lamps and complexions become constants.
    """
    smooth = cv2.GaussianBlur(linear, (0, 0), 1.0) + 0.01
    return np.stack([np.log(smooth.mean(axis=2)), np.log(smooth[..., 2] / smooth[..., 1])], axis=2)


def _redness(surface: FaceSurface) -> NDArray[np.float64]:
    """(n,) 1 on lips, below 0 on brows and eyes, 0 on skin."""
    lips = np.zeros(len(surface.vertices))
    for name, mask in surface.model.regions.items():
        if name.startswith("lips"):
            lips[mask[surface.vertices]] = 1.0
    dark = generic_albedo(surface) < 0.8
    return np.where(lips > 0, lips, np.where(dark, _DULL, 0.0))


def _normalised(looks: NDArray, mask: NDArray | None = None) -> NDArray[np.float32]:
    """As the finder compares: channels by their worth."""
    mask = np.ones(looks.shape[:2], np.float32) if mask is None else mask
    return locally_normalised(looks, mask, _CONTRAST_PX, 0.1) * np.array(_WORTH, np.float32)


def locally_normalised(looks: NDArray, mask: NDArray, window_px: float, floor_share: float) -> NDArray[np.float32]:
    """Zero mean and unit deviation in a Gaussian window about each pixel, of the part where `mask` (height, width) is 1.

    Deviations below `floor_share` of the mean one count as that: smooth skin shall not become rough.
    """
    blur = lambda values: cv2.GaussianBlur(values, (0, 0), window_px)  # noqa: E731
    weight, out = np.maximum(blur(mask), 1e-3), np.empty_like(looks)
    for k in range(looks.shape[2]):
        values = looks[..., k]
        mean = blur(values * mask) / weight
        spread = np.sqrt(np.maximum(blur((values - mean) ** 2 * mask) / weight, 0.0))
        floor = max(floor_share * float(spread[mask > 0].mean()), _LEAST_SPREAD)
        out[..., k] = (values - mean) / np.maximum(spread, floor) * mask
    return out
