"""Start poses for the bundle adjustment: board poses per camera, joined along a spanning tree."""

from __future__ import annotations

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree

from headcap.calibration.corners import BoardView
from headcap.calibration.grouping import BoardPose
from headcap.calibration.intrinsics import Lens
from headcap.errors import InputError
from headcap.geometry.transforms import invert, rigid, rotation_angle

Array = NDArray[np.float64]


def board_pose(lens: Lens, view: BoardView, corners: Array) -> tuple[Array, float]:
    """camera_from_board (4, 4) of one view and its rms residual in pixels (IPPE, both solutions refined)."""
    points, pixels = corners[view.corner], view.pixels.astype(float)
    found, rotations, translations, _ = cv2.solvePnPGeneric(points, pixels, lens.matrix, lens.distortion, flags=cv2.SOLVEPNP_IPPE)
    best, best_rms = np.eye(4), np.inf
    for rotation, translation in zip(rotations[:found], translations[:found], strict=True):
        rotation, translation = cv2.solvePnPRefineLM(points, pixels, lens.matrix, lens.distortion, rotation, translation)
        projected, _ = cv2.projectPoints(points, rotation, translation, lens.matrix, lens.distortion)
        rms = float(np.sqrt(((projected.reshape(-1, 2) - pixels) ** 2).sum(1).mean()))
        if rms < best_rms:
            best, best_rms = rigid(cv2.Rodrigues(rotation)[0], translation.ravel()), rms
    return best, best_rms


def start_poses(
    poses: list[BoardPose], lenses: Mapping[str, Lens], corners: Array, names: tuple[str, ...]
) -> tuple[dict[str, Array], list[Array]]:
    """camera_from_rig of every camera (the rig is the first camera) and rig_from_board of every pose.

    Cameras that see the board together are joined by the relative pose on which most shared poses agree; the joints with
    most agreement form the tree. Raises `InputError` naming cameras that share no board pose with the others.
    """
    single = [{c: board_pose(lenses[c], view, corners) for c, view in pose.views.items()} for pose in poses]
    joints = _joints(single, names)
    _check_connected(joints, names)
    camera_from_rig = _walk_tree(joints, names)
    return camera_from_rig, [_agreed_board_pose(seen, camera_from_rig) for seen in single]


def joined_board_pose(pose: BoardPose, lenses: Mapping[str, Lens], camera_from_rig: Mapping[str, Array], corners: Array) -> Array:
    """rig_from_board (4, 4) of one pose, from the view of it that agrees with most others."""
    return _agreed_board_pose({c: board_pose(lenses[c], view, corners) for c, view in pose.views.items()}, camera_from_rig)


def _joints(single: list[dict[str, tuple[Array, float]]], names: tuple[str, ...]) -> dict[tuple[int, int], tuple[Array, float]]:
    """For each pair of cameras (i < j): j_from_i and how many shared poses support it."""
    joints = {}
    for i, a in enumerate(names):
        for j in range(i + 1, len(names)):
            b = names[j]
            relative = [s[b][0] @ invert(s[a][0]) for s in single if a in s and b in s]
            if relative:
                joints[i, j] = _most_agreed(np.array(relative))
    return joints


def _most_agreed(relative: Array) -> tuple[Array, float]:
    """Of several (n, 4, 4) the one nearest to most others, and the sum of its agreement."""
    angle = rotation_angle(np.einsum("aij,bkj->abik", relative[:, :3, :3], relative[:, :3, :3]))
    shift = np.linalg.norm(relative[:, None, :3, 3] - relative[None, :, :3, 3], axis=2)
    size = np.median(np.linalg.norm(relative[:, :3, 3], axis=1)) + 1e-9
    # single-view poses of a small board are good to about two degrees and two percent
    support = np.exp(-((angle / 0.04) ** 2) - (shift / (0.04 * size)) ** 2).sum(1)
    best = int(np.argmax(support))
    return relative[best], float(support[best])


def _check_connected(joints: Mapping[tuple[int, int], tuple[Array, float]], names: tuple[str, ...]) -> None:
    rows, columns = zip(*joints, strict=True) if joints else ((), ())
    graph = csr_array((np.ones(len(joints)), (rows, columns)), shape=(len(names), len(names)))
    _, label = connected_components(graph, directed=False)
    main = np.bincount(label).argmax()
    lost = [name for name, part in zip(names, label, strict=True) if part != main]
    if lost:
        raise InputError(
            f"{', '.join(lost)}: no board pose shared with the other cameras",
            expected="every camera seeing the board together with another one",
            remedy="Hold the board still where this camera and a neighbour both see it; check its recording and start time.",
        )


def _walk_tree(joints: Mapping[tuple[int, int], tuple[Array, float]], names: tuple[str, ...]) -> dict[str, Array]:
    rows, columns = zip(*joints, strict=True) if joints else ((), ())
    cost = csr_array(([1 / (1e-6 + s) for _, s in joints.values()], (rows, columns)), shape=(len(names), len(names)))
    tree = minimum_spanning_tree(cost)
    order, parent = breadth_first_order(tree, 0, directed=False)
    placed = {0: np.eye(4)}
    for node in order[1:]:
        up = int(parent[node])
        low, high = min(up, node), max(up, node)
        high_from_low = joints[low, high][0]
        placed[int(node)] = (high_from_low if up == low else invert(high_from_low)) @ placed[up]
    return {name: placed[i] for i, name in enumerate(names)}


def _agreed_board_pose(seen: Mapping[str, tuple[Array, float]], camera_from_rig: Mapping[str, Array]) -> Array:
    """rig_from_board on which most cameras of the pose agree."""
    return _most_agreed(np.array([invert(camera_from_rig[c]) @ pose for c, (pose, _) in seen.items()]))[0]
