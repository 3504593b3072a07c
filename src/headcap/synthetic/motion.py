"""How muscles and articulators move a head: arcs about pivots, a hinge, lips around the teeth, lids around the eyes.

Nothing here is a weighted sum of shapes: tissue slides along arcs, angles and amounts multiply each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from headcap.synthetic.anatomy import Fields, Places

JAW_RAD, JAW_FORWARD_M, JAW_SIDE_M = 0.29, 0.006, 0.004
ARCH_M = 0.034
"""Radius of the dental arch that the lips lie on."""
_SIDEWAYS_RAD = 0.2
"""How far about the arch's centre a mouth is drawn to one side."""
_CURVATURE_M = 0.045
"""Radius of the arcs along which skin slides over the skull."""
_LID_REACH_M = 0.009
"""Lids fold within this distance of their edge."""
_LID_THICKNESS_M = 0.0003
_NECK_JOINTS = 7


@dataclass(frozen=True)
class Pull:
    """One muscle's pull on the skin about its insertion."""

    muscle: str
    vertices: NDArray[np.int64]
    weights: NDArray[np.float64]
    """(k,) Gaussian of the distance from the insertion."""
    pivot: NDArray[np.float64]
    axis: NDArray[np.float64]
    """(3,) unit axis of the arc through `pivot`."""
    angle_rad: float
    """At full contraction."""
    swell_m: float
    """How far the tissue bulges away from the pivot."""

    def apply(self, points: NDArray, contraction: float) -> None:
        """Move the points (n, 3) in place."""
        away = points[self.vertices] - self.pivot
        angle = contraction * self.angle_rad * self.weights
        moved = away + np.sin(angle)[:, None] * np.cross(self.axis, away)
        moved += (1 - np.cos(angle))[:, None] * np.cross(self.axis, np.cross(self.axis, away))
        radius = np.linalg.norm(away, axis=1, keepdims=True)
        swell = self.swell_m * contraction**1.5 * self.weights[:, None]
        points[self.vertices] = self.pivot + moved * (1 + swell / radius)


def build_pulls(points: NDArray, follows: NDArray, places: Places) -> tuple[Pull, ...]:
    """Muscles of the face, both sides; a row: muscle, insertion, direction, way in mm, radius in mm, swelling in mm.

    `follows` (n,) is how far each vertex follows them: 1 on the outer skin, 0 on what is no skin.
    """
    pulls = []
    for side, name in ((1, "left"), (-1, "right")):
        corner = places.mouth_left if side > 0 else places.mouth_right
        eye = places.eye_left if side > 0 else places.eye_right
        wing = np.array([0.014 * side, 0.45 * eye[1] + 0.55 * places.mouth[1], eye[2] + 0.022])
        for muscle, place, offset_mm, direction, way_mm, radius_mm, swell_mm in (
            (f"smile_{name}", corner, (2, 0, -2), (0.6, 0.75, -0.2), 10.0, 17.0, 0.0),
            (f"smile_{name}", corner, (20, 27, -14), (0.2, 1.0, 0.0), 3.0, 17.0, 3.2),
            (f"corner_down_{name}", corner, (2, -3, -2), (0.15, -1.0, -0.1), 8.0, 16.0, 0.0),
            (f"brow_raise_{name}", eye, (2, 25, 12), (0, 1, 0), 8.0, 15.0, 0.0),
            ("brow_frown", eye, (-15, 15, 14), (-0.8, -0.6, 0), 5.5, 12.0, 1.0),
            ("sneer", wing, (0, 0, 0), (0.25, 1, 0), 5.0, 10.0, 0.6),
            ("cheek_puff", corner, (18, 2, -16), (0, -1, 0), 0.0, 17.0, 9.0),
            ("blink", eye, (2, -16, 8), (-0.2, 1, 0), 2.2, 10.0, 0.5),
        ):
            flip = np.array([side, 1, 1])
            insertion = place + flip * np.array(offset_mm) / 1000
            pulls.append(
                _pull(points, follows, muscle, insertion, flip * np.array(direction, float), way_mm, radius_mm, swell_mm)
            )
    return tuple(pulls)


def _pull(
    points: NDArray,
    follows: NDArray,
    muscle: str,
    insertion: NDArray,
    direction: NDArray,
    way_mm: float,
    radius_mm: float,
    swell_mm: float,
) -> Pull:
    candidates = np.flatnonzero(follows == 1)
    nearest = points[candidates[np.argmin(np.linalg.norm(points[candidates] - insertion, axis=1))]]
    inward = -nearest * np.array([1.0, 0.3, 1.0])
    pivot = nearest + _CURVATURE_M * inward / np.linalg.norm(inward)
    axis = np.cross(nearest - pivot, direction)
    weights = np.exp(-0.5 * ((points - nearest) ** 2).sum(1) / (radius_mm / 1000) ** 2) * follows
    chosen = np.flatnonzero(weights > 1e-4)
    # the Gaussian is let down to zero where it is cut off
    weights = (weights[chosen] - 1e-4) / (1 - 1e-4)
    return Pull(muscle, chosen, weights, pivot, axis / np.linalg.norm(axis), way_mm / 1000 / _CURVATURE_M, swell_mm / 1000)


@dataclass(frozen=True)
class Lids:
    """The lids of one eye: skin that turns about the eyeball's centre."""

    centre: NDArray[np.float64]
    vertices: NDArray[np.int64]
    closing_rad: NDArray[np.float64]
    """(k,) downward turn of each vertex when the eye is shut (upward where negative)."""
    keep_off_m: NDArray[np.float64]
    """(k,) least distance from the centre: the eyeball holds the lids off; 0 for the lids' inner edge."""

    def apply(self, points: NDArray, shut: float) -> None:
        """Turn the lids' points (n, 3) in place and lay them on the eyeball where they would sink in."""
        away = points[self.vertices] - self.centre
        angle = shut * self.closing_rad
        c, s = np.cos(angle), np.sin(angle)
        y, z = away[:, 1].copy(), away[:, 2].copy()
        away[:, 1], away[:, 2] = c * y - s * z, s * y + c * z
        distance = np.sqrt((away**2).sum(1))
        points[self.vertices] = self.centre + away * np.maximum(self.keep_off_m / distance, 1)[:, None]


def build_lids(points: NDArray, skin: NDArray, rim: NDArray, centre: NDArray, ball_radius_m: float) -> Lids:
    """Lids of the eye whose opening is bounded by the vertices `rim` (k,), in front of a ball."""
    edge = points[rim] - centre
    upper, lower = _envelope(edge, 1), _envelope(edge, -1)
    chosen = np.flatnonzero(skin & (np.linalg.norm(points - centre, axis=1) < 0.03) & (points[:, 2] > centre[2] + 0.001))
    x, y = (points[chosen] - centre)[:, :2].T
    top, bottom = np.interp(x, *upper), np.interp(x, *lower)
    radius = np.linalg.norm(edge, axis=1).mean()
    # the circle on which a point of the lid runs; flatter towards the corners
    circle = np.sqrt(np.maximum(radius**2 - x**2, (0.45 * radius) ** 2))
    gap = np.arcsin(np.clip(top / circle, -1, 1)) - np.arcsin(np.clip(bottom / circle, -1, 1))
    above = np.clip(1 - (y - top) / _LID_REACH_M, 0, 1)
    below = np.clip(1 - (bottom - y) / _LID_REACH_M, 0, 1)
    closing = np.where(
        y > 0.5 * (top + bottom), 0.84 * gap * above**2 * (3 - 2 * above), -0.13 * gap * below**2 * (3 - 2 * below)
    )
    # a positive turn about x carries the front of the eye downwards
    held_off = ball_radius_m + _LID_THICKNESS_M
    distance = np.linalg.norm(points[chosen] - centre, axis=1)
    return Lids(centre, chosen, closing, np.where(distance > held_off, held_off, 0.0))


def _envelope(edge: NDArray, side: int) -> tuple[NDArray, NDArray]:
    """The upper (side 1) or lower (-1) line of a closed rim as x rising and y."""
    right, left = np.argmin(edge[:, 0]), np.argmax(edge[:, 0])
    straight = np.interp(edge[:, 0], edge[[right, left], 0], edge[[right, left], 1])
    of_side = (edge[:, 1] - straight) * side >= -1e-12
    order = np.argsort(edge[of_side, 0])
    return edge[of_side][order, 0], edge[of_side][order, 1]


def move_lips(points: NDArray, zone: NDArray, fields: Fields, places: Places, state: dict[str, float]) -> None:
    """Lips around the teeth, in place: rounding and spreading turn them about the arch, the rest opens, tucks, presses."""
    rounding, spreading, closure, tuck = (state[name] for name in ("rounding", "spreading", "closure", "tuck"))
    upper, lower = fields.upper_lip[zone], fields.lower_lip[zone]
    p = points[zone]
    half = 0.5 * (places.mouth_left[0] - places.mouth_right[0])
    away = p - places.mouth
    near = np.exp(
        -0.5 * ((away[:, 0] / (1.25 * half)) ** 2 + (away[:, 1] / 0.019) ** 2 + (np.minimum(away[:, 2] + 0.01, 0) / 0.02) ** 2)
    )
    # along the dental arch: the angle at its centre shrinks or grows, the arch stays
    centre_z = places.mouth[2] - ARCH_M
    angle = np.arctan2(p[:, 0], np.maximum(p[:, 2] - centre_z, 0.004))
    radius = np.hypot(p[:, 0], p[:, 2] - centre_z)
    turned = angle * (1 + near * (0.17 * spreading - 0.40 * rounding * (1 - 0.3 * spreading)))
    turned = turned + _SIDEWAYS_RAD * state["mouth_side"] * near
    radius = radius + near * (0.0065 * rounding**1.3 - 0.0012 * spreading)
    front = p[:, 2] - centre_z > 0.004
    p[:, 0] = np.where(front, radius * np.sin(turned), p[:, 0])
    p[:, 2] = np.where(front, centre_z + radius * np.cos(turned), p[:, 2])
    free = 1 - closure
    middle = np.exp(-((angle / 0.75) ** 2))
    raised = (0.0055 * state["upper_lip_raise"] + 0.0022 * rounding * state["jaw"] ** 0.5 + 0.0015 * tuck) * free
    dropped = (0.0060 * state["lower_lip_drop"] + 0.0028 * rounding * state["jaw"] ** 0.5) * free
    p[:, 1] += upper * raised * middle - lower * dropped * middle
    p[:, 2] += upper * 0.25 * raised + lower * 0.2 * dropped
    pressed = closure**2
    p[:, 2] -= 0.0022 * pressed * (upper + lower)
    p[:, 1] += 0.0008 * pressed * (lower - upper)
    p[:, 2] -= 0.0045 * tuck * lower * middle
    p[:, 1] += 0.0020 * tuck * lower * middle
    points[zone] = p


def turn_jaw(points: NDArray, zone: NDArray, fields: Fields, places: Places, state: dict[str, float]) -> None:
    """Open the jaw in place: each point turns about the hinge by its own share of the angle while the hinge slides forward.

    Closed lips hold on to each other: the lower lip then takes less of the turn.
    """
    share = fields.jaw[zone] * (1 - 0.93 * state["closure"] * fields.lower_lip[zone] ** 0.7)
    share = share * (1 - 0.55 * state["tuck"] * fields.lower_lip[zone])
    # the upper lip is drawn down a little by a wide-open or pressed mouth
    share = share + fields.upper_lip[zone] * (0.03 + 0.05 * state["closure"]) * (1 - share)
    turn_hinge(points, zone, share, places, state)


def turn_hinge(points: NDArray, zone: NDArray, share: NDArray, places: Places, state: dict[str, float]) -> None:
    """Turn points `zone` in place about the jaw's hinge, each by its share of the opening."""
    angle = JAW_RAD * state["jaw"] * share
    away = points[zone] - places.hinge
    c, s = np.cos(angle), np.sin(angle)
    y, z = away[:, 1].copy(), away[:, 2].copy()
    away[:, 1], away[:, 2] = c * y - s * z, s * y + c * z
    slide = np.sin(angle) / np.sin(JAW_RAD)
    away[:, 2] += 0.6 * JAW_FORWARD_M * slide
    away[:, 0] += JAW_SIDE_M * state["jaw_side"] * share
    points[zone] = places.hinge + away


def gaze_rotation(up_rad: float, left_rad: float) -> NDArray[np.float64]:
    """Turn (3, 3) of the eyeballs."""
    return Rotation.from_rotvec([up_rad, left_rad, 0.0]).as_matrix()


def neck_transforms(places: Places, turn: NDArray) -> NDArray[np.float64]:
    """Transforms (joints + 1, 3, 4) of the neck's bones from its base to the skull for a turn of the head (rotation vector)."""
    pivots = np.linspace(places.neck_low, places.neck_high, _NECK_JOINTS)
    rotation = np.eye(3)
    translation = np.zeros(3)
    out = [np.column_stack([rotation, translation])]
    step = Rotation.from_rotvec(turn / _NECK_JOINTS).as_matrix()
    for pivot in pivots:
        translation = rotation @ (pivot - step @ pivot) + translation
        rotation = rotation @ step
        out.append(np.column_stack([rotation, translation]))
    return np.array(out)


@njit(cache=True)
def bend_neck(points, share, transforms):
    """Carry points (n, 3) along, in place: between neighbouring bones by their share (n,) of the way up the neck."""
    last = len(transforms) - 1
    for k in range(len(points)):
        place = min(max(share[k], 0.0), 1.0) * last
        bone = min(int(place), last - 1)
        part = place - bone
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        for axis in range(3):
            a, b = transforms[bone, axis], transforms[bone + 1, axis]
            low = a[0] * x + a[1] * y + a[2] * z + a[3]
            high = b[0] * x + b[1] * y + b[2] * z + b[3]
            points[k, axis] = (1 - part) * low + part * high
