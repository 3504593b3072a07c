"""Linear blend skinning about a tree of joints: bone transforms, their derivatives, and the kernels that apply them."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.geometry.rotations import rotation_derivatives, rotation_matrices

JOINTS = ("neck", "jaw")
PARENTS = (-1, 0)
"""The joint each joint hangs on; -1 is the trunk, which stays where the placement puts it."""


def pose_features(pose: NDArray) -> NDArray:
    """What the pose correctives are weighted by, (..., 9 K): R_k(theta) - I row by row, joint by joint (FLAME, eq. 4).

    `pose` (..., K, 3) holds rotation vectors, radians.
    """
    rotation = rotation_matrices(pose) - np.eye(3, dtype=pose.dtype)
    return rotation.reshape((*pose.shape[:-2], 9 * pose.shape[-2]))


def bone_transforms(pose: NDArray, joints: NDArray, placement: NDArray | None = None) -> NDArray:
    """Transforms (..., K + 1, 3, 4) that take the rest pose to the posed head: the trunk first, then each joint's bone.

    `pose` (..., K, 3) radians, `joints` (..., K, 3) metres at rest, `placement` (..., 4, 4) puts the head into the world
    (identity by default). A bone turns about its joint, after its parent has: G_k = G_parent(k) [R_k, J_k - R_k J_k].
    """
    locals_ = _about(rotation_matrices(pose), joints)
    return _chain(locals_, placement)[..., :3, :]


def bone_derivatives(pose: NDArray, joints: NDArray, placement: NDArray | None = None) -> tuple[NDArray, NDArray]:
    """Bone transforms (..., K + 1, 3, 4) and their derivatives (..., 3 K, K + 1, 3, 4) by the pose's components."""
    rotation, slopes = rotation_derivatives(pose)
    locals_ = _about(rotation, joints)
    bones = _chain(locals_, placement)
    n_joints = pose.shape[-2]
    out = np.zeros((*bones.shape[:-3], 3 * n_joints, n_joints + 1, 4, 4), bones.dtype)
    for joint in range(n_joints):
        slope = np.zeros((*out.shape[:-4], 3, 4, 4), bones.dtype)
        slope[..., :3, :3] = slopes[..., joint, :, :, :]
        slope[..., :3, 3] = -np.einsum("...qij,...j->...qi", slopes[..., joint, :, :, :], joints[..., joint, :])
        own = slice(3 * joint, 3 * joint + 3)
        out[..., own, joint + 1, :, :] = bones[..., PARENTS[joint] + 1, None, :, :] @ slope
        for child in range(joint + 1, n_joints):
            out[..., own, child + 1, :, :] = out[..., own, PARENTS[child] + 1, :, :] @ locals_[..., child, None, :, :]
    return bones[..., :3, :], out[..., :3, :]


def _about(rotation: NDArray, joints: NDArray) -> NDArray:
    """Rotations (..., K, 3, 3) about joints (..., K, 3) as (..., K, 4, 4)."""
    shape = np.broadcast_shapes(rotation.shape[:-2], joints.shape[:-1])
    out = np.zeros((*shape, 4, 4), rotation.dtype)
    out[..., :3, :3] = rotation
    out[..., :3, 3] = joints - np.einsum("...ij,...j->...i", rotation, joints)
    out[..., 3, 3] = 1.0
    return out


def _chain(locals_: NDArray, placement: NDArray | None) -> NDArray:
    n_joints = locals_.shape[-3]
    root = np.eye(4, dtype=locals_.dtype) if placement is None else np.asarray(placement, locals_.dtype)
    shape = np.broadcast_shapes(locals_.shape[:-3], root.shape[:-2])
    out = np.empty((*shape, n_joints + 1, 4, 4), locals_.dtype)
    out[..., 0, :, :] = root
    for joint in range(n_joints):
        out[..., joint + 1, :, :] = out[..., PARENTS[joint] + 1, :, :] @ locals_[..., joint, :, :]
    return out


def vertex_transforms(bones: NDArray, weights: NDArray) -> NDArray:
    """Blended transforms (..., n, 3, 4) of bones (..., K + 1, 3, 4) by weights (n, K + 1)."""
    return np.einsum("vb,...bij->...vij", weights, bones)


def skin(rest: NDArray, bones: NDArray, weights: NDArray, out: NDArray) -> NDArray:
    """Posed vertices into `out` (f, n, 3) from rest vertices (f or 1, n, 3), bones (f, K + 1, 3, 4), weights (n, K + 1).

    `out` may be `rest` itself.
    """
    _skin(rest, np.array(bones, rest.dtype), np.ascontiguousarray(weights, rest.dtype), out)
    return out


def unskin(posed: NDArray, bones: NDArray, weights: NDArray) -> NDArray:
    """The inverse of `skin`: vertices (f, n, 3) that these bones take to `posed` (f, n, 3)."""
    out = np.empty_like(posed)
    _unskin(posed, np.array(bones, posed.dtype), np.ascontiguousarray(weights, posed.dtype), out)
    return out


@njit(cache=True, inline="always")
def _blend(bones, weights, f, v, m):
    for i in range(3):
        for j in range(4):
            m[i, j] = 0.0
    for b in range(weights.shape[1]):
        w = weights[v, b]
        if w != 0.0:
            for i in range(3):
                for j in range(4):
                    m[i, j] += w * bones[f, b, i, j]


@njit(cache=True, fastmath=True)
def _skin(rest, bones, weights, out):
    many = len(rest) > 1
    m = np.empty((3, 4), rest.dtype)
    for f in range(len(out)):
        g = f if many else 0
        for v in range(out.shape[1]):
            _blend(bones, weights, f, v, m)
            x, y, z = rest[g, v, 0], rest[g, v, 1], rest[g, v, 2]
            for i in range(3):
                out[f, v, i] = m[i, 0] * x + m[i, 1] * y + m[i, 2] * z + m[i, 3]


@njit(cache=True)
def _unskin(posed, bones, weights, out):
    m = np.empty((3, 4), posed.dtype)
    for f in range(len(out)):
        for v in range(out.shape[1]):
            _blend(bones, weights, f, v, m)
            x, y, z = posed[f, v, 0] - m[0, 3], posed[f, v, 1] - m[1, 3], posed[f, v, 2] - m[2, 3]
            c0x, c0y, c0z = m[0, 0], m[1, 0], m[2, 0]
            c1x, c1y, c1z = m[0, 1], m[1, 1], m[2, 1]
            c2x, c2y, c2z = m[0, 2], m[1, 2], m[2, 2]
            ax, ay, az = c1y * c2z - c1z * c2y, c1z * c2x - c1x * c2z, c1x * c2y - c1y * c2x
            bx, by, bz = c2y * c0z - c2z * c0y, c2z * c0x - c2x * c0z, c2x * c0y - c2y * c0x
            cx, cy, cz = c0y * c1z - c0z * c1y, c0z * c1x - c0x * c1z, c0x * c1y - c0y * c1x
            inverse = 1.0 / (c0x * ax + c0y * ay + c0z * az)
            out[f, v, 0] = (ax * x + ay * y + az * z) * inverse
            out[f, v, 1] = (bx * x + by * y + bz * z) * inverse
            out[f, v, 2] = (cx * x + cy * y + cz * z) * inverse
