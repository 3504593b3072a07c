"""Regions, landmarks and joints of a head that names none, carried over from the base head by a few anchors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from headcap.errors import InputError
from headcap.heads.generic import JAW_JOINT_M, NECK_JOINT_M
from headcap.heads.procedural import base_head
from headcap.heads.regions import with_lip_regions, with_neck_regions
from headcap.meshes.normals import vertex_normals

_NORMAL_M = 0.015
"""How far apart opposite normals put two places: lips that touch, or an ear and the skull behind it, are told apart by it."""
_LARYNX_BELOW_CHIN_M = 0.0545
"""Prominence below the chin's foremost point on the base head; scaled with the face."""
_SKIN = ("face", "neck", "scalp", "ears")


@dataclass(frozen=True, eq=False)
class Anatomy:
    """What was found on a head."""

    regions: dict[str, NDArray[np.bool_]]
    landmarks: dict[str, int]
    joints: NDArray[np.float64]
    """(2, 3) neck and jaw, metres."""
    mouth: NDArray[np.float64]
    """(3, 3) right corner, middle of the lip line, left corner."""


def find_anatomy(
    vertices: NDArray, triangles: NDArray, anchors: dict[str, int], known: dict[str, NDArray[np.bool_]] | None = None
) -> Anatomy:
    """Anatomy of an upright head (n, 3), metres, y up, z out of the face.

    `anchors` are vertices by the base head's landmark names; without any, nose and chin are found on the profile. With eight or
    more the base head is warped onto them, else it is scaled. `known` regions (n,) stand as they are.
    """
    vertices = np.asarray(vertices, np.float64)
    anchors = anchors or profile_landmarks(vertices)
    base = base_head()
    names = [name for name in anchors if name in base.landmarks]
    here = vertices[[anchors[name] for name in names]]
    there = base.vertices[[base.landmarks[name] for name in names]]
    nearest = _nearest_on_base(vertices, vertex_normals(vertices, triangles), _warp(here, there))
    regions = {name: base.regions[name][nearest] for name in base.regions if name != "larynx"}
    regions |= known or {}
    if known:
        regions |= {name: regions[name] & ~np.any(list(known.values()), axis=0) for name in _SKIN if name not in known}
    back = _warp(there, here)
    joints = back(np.array([NECK_JOINT_M, JAW_JOINT_M])) * [0.0, 1.0, 1.0]
    face = (here[:, 1].max() - here[:, 1].min()) / (there[:, 1].max() - there[:, 1].min())
    landmarks = _carried(vertices, back, anchors)
    larynx = _larynx(vertices, regions["neck"], vertices[landmarks["chin"]], _LARYNX_BELOW_CHIN_M * face)
    landmarks["larynx"] = larynx
    corners = [
        landmarks["mouth_corner_right"],
        landmarks["mouth_upper"],
        landmarks["mouth_lower"],
        landmarks["mouth_corner_left"],
    ]
    right, upper, lower, left = vertices[corners]
    regions = with_neck_regions(vertices, triangles, with_lip_regions(regions), vertices[larynx], joints[0])
    return Anatomy(regions, landmarks, joints, np.stack([right, 0.5 * (upper + lower), left]))


def profile_landmarks(vertices: NDArray) -> dict[str, int]:
    """Nose tip, chin, crown and back of the head on the midline of a head (n, 3); raises `InputError` where it is no head."""
    width = np.ptp(vertices[:, 0])
    middle = np.flatnonzero(np.abs(vertices[:, 0]) < 0.02 * width)
    if len(middle) < 20 or not 0.1 < width < 0.6:
        raise InputError(
            f"a mesh {width:.3g} m wide with {len(middle)} vertices on its midline",
            expected="an upright head in metres, symmetric about x = 0, z out of the face",
            remedy="Bring the model into this frame.",
        )
    profile = vertices[middle]
    nose = profile[profile[:, 2].argmax()]
    below = (profile[:, 1] < nose[1] - 0.055) & (profile[:, 1] > nose[1] - 0.085)
    found = {"nose_tip": profile[:, 2].argmax(), "crown": profile[:, 1].argmax(), "back_of_head": profile[:, 2].argmin()}
    if below.any():
        found["chin"] = np.flatnonzero(below)[profile[below, 2].argmax()]
    return {name: int(middle[at]) for name, at in found.items()}


def _warp(source: NDArray, target: NDArray):
    """A map of points (k, 3) that takes anchors to anchors: a smooth warp from eight on, else scale and shift of each axis."""
    if len(source) >= 8:
        return scipy.interpolate.RBFInterpolator(source, target, kernel="thin_plate_spline", degree=1, smoothing=1e-6)
    scale, shift = np.ones(3), np.zeros(3)
    for axis in (1, 2):
        scale[axis], shift[axis] = np.polyfit(source[:, axis], target[:, axis], 1)
    scale[0] = 0.5 * (scale[1] + scale[2])
    return lambda points: points * scale + shift


def _nearest_on_base(vertices: NDArray, normals: NDArray, base_from_head) -> NDArray[np.int64]:
    """(n,) the base head's vertex at each vertex, by place and by which way the skin faces."""
    base = base_head()
    facing = vertex_normals(base.vertices, base.triangles)
    tree = cKDTree(np.c_[base.vertices, 0.5 * _NORMAL_M * facing])
    return tree.query(np.c_[base_from_head(vertices), 0.5 * _NORMAL_M * normals])[1]


def _carried(vertices: NDArray, head_from_base, anchors: dict[str, int]) -> dict[str, int]:
    base = base_head()
    names = list(base.landmarks)
    places = head_from_base(base.vertices[[base.landmarks[name] for name in names]])
    nearest = cKDTree(vertices).query(places)[1]
    return dict(zip(names, nearest.tolist(), strict=True)) | anchors


def _larynx(vertices: NDArray, neck: NDArray, chin: NDArray, below_m: float) -> int:
    """The foremost vertex of the neck's midline at the larynx's usual height."""
    place = vertices - [0.0, chin[1] - below_m, 0.0]
    middle = vertices[neck, 2].mean() if neck.any() else np.inf
    candidates = np.flatnonzero(neck & (np.abs(place[:, 0]) < 0.01) & (vertices[:, 2] > middle))
    if len(candidates) == 0:
        raise InputError(
            "the head has no skin on the front of its neck", expected="a head with its neck", remedy="Use a model with a neck."
        )
    return int(candidates[(np.abs(place[candidates, 1]) + np.abs(place[candidates, 0])).argmin()])
