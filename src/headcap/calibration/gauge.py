"""The rig's own world frame: y up, z towards the frontal cameras, origin where the cameras look."""

import numpy as np
from numpy.typing import NDArray

from headcap.cameras import Rig
from headcap.geometry.transforms import rigid

Array = NDArray[np.float64]


def looked_at_point(rig: Rig) -> Array:
    """(3,) point nearest to all optical axes in the least-squares sense, in the rig's present world, metres."""
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for camera in rig:
        across = np.eye(3) - np.outer(camera.axis, camera.axis)
        normal += across
        right += across @ camera.centre
    # parallel axes leave the distance free: a faint pull to a point one spread of the centres ahead of them
    mean_axis = np.mean([camera.axis for camera in rig], axis=0)
    ahead = rig.centres.mean(0) + mean_axis * max(1e-3, float(np.ptp(rig.centres, axis=0).max()))
    pull = 1e-6 * len(rig)
    return np.linalg.solve(normal + pull * np.eye(3), right + pull * ahead)


def canonical_frame(rig: Rig) -> Array:
    """canonical_from_world (4, 4): origin `looked_at_point`, y the mean camera up, z towards the cameras' mean direction.

    x then points to the right in the image of a frontal camera. Cameras all around leave the front open: the first camera
    then stands in front.
    """
    origin = looked_at_point(rig)
    up = _unit(-np.sum([camera.camera_from_world[1, :3] for camera in rig], axis=0))
    directions = rig.centres - origin
    directions /= np.linalg.norm(directions, axis=1, keepdims=True) + 1e-12
    front = _across(directions.mean(0), up)
    if np.linalg.norm(front) < 0.05:
        front = _across(directions[0], up)
    if np.linalg.norm(front) < 1e-6:
        front = _across(-rig[0].axis, up)
    front = _unit(front)
    rotation = np.stack([np.cross(up, front), up, front])
    return rigid(rotation, -rotation @ origin)


def _across(vector: Array, axis: Array) -> Array:
    return vector - (vector @ axis) * axis


def _unit(vector: Array) -> Array:
    return vector / np.linalg.norm(vector)
