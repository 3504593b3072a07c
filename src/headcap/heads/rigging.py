"""Joints and blend weights for a head that brings none: neck and jaw, smooth, from its regions."""

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from headcap.meshes.laplacian import Factor, bilaplacian, cotangent_laplacian, vertex_areas

_CORNER_FREE_M = 0.007
_JAW_GAP_DEG = 7.0
"""Free band on each side of the line from the hinge to the lips' meeting, in which cheeks stretch."""


def skinning_weights(
    vertices: NDArray, triangles: NDArray, regions: dict[str, NDArray], joints: NDArray, mouth: NDArray
) -> NDArray[np.float64]:
    """Weights (n, 3) of trunk, neck and jaw at rest (n, 3): biharmonic between what surely follows a bone and what does not.

    `joints` (2, 3) are neck and jaw, `mouth` (3, 3) the right corner, the middle of the lip line and the left corner.
    """
    follow = _Interpolator(vertices, triangles)
    y, bottom = vertices[:, 1], vertices[:, 1].min()
    chin = (regions["face"] & (vertices[:, 2] > joints[1, 2] + 0.03)) | regions["scalp"] & (y > joints[1, 1])
    # the skull's base: what lies above the neck all around; the trunk: a rim at the cut
    head = follow(chin | (~regions["neck"] & (y > joints[1, 1])), y < bottom + 0.12 * (joints[0, 1] - bottom))
    jaw = follow(*_jaw_constraints(vertices, regions, joints[1], mouth))
    return np.stack([1.0 - head, head * (1.0 - jaw), head * jaw], axis=1)


def joint_regressor(vertices: NDArray, joints: NDArray, supports: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Rows (K, n) that give joints (K, 3) from vertices (n, 3), each supported by its mask (K, n).

    The least-norm weights that sum to one and reproduce the joint: they commute with every affine change of the head.
    """
    out = np.zeros((len(joints), len(vertices)))
    for row, joint, support in zip(out, joints, supports, strict=True):
        conditions = np.concatenate([np.ones((1, support.sum())), (vertices[support] - joint).T])
        row[support] = np.linalg.lstsq(conditions, np.array([1.0, 0.0, 0.0, 0.0]), rcond=None)[0]
    return out


def joint_supports(vertices: NDArray, regions: dict[str, NDArray], joints: NDArray) -> NDArray[np.bool_]:
    """(2, n) vertices that tell where the joints are: a ring of the neck, the skin about both of the jaw's hinges."""
    neck = regions["neck"] & (np.abs(vertices[:, 1] - joints[0, 1]) < 0.025)
    side = np.abs(vertices - joints[1])
    hinge = (side[:, 1] < 0.03) & (side[:, 2] < 0.03) & ~regions.get("mouth_interior", np.zeros(len(vertices), bool))
    return np.stack([neck, hinge])


class _Interpolator:
    """Bounded biharmonic interpolation between ones and zeros, held softly so that their rims are rounded."""

    def __init__(self, vertices: NDArray, triangles: NDArray) -> None:
        areas = vertex_areas(vertices, triangles)
        self._energy = bilaplacian(cotangent_laplacian(vertices, triangles, least_weight=1e-4), areas)
        self._areas = areas

    def __call__(self, ones: NDArray[np.bool_], zeros: NDArray[np.bool_]) -> NDArray[np.float64]:
        """(n,) in [0, 1]; ones win where both are told."""
        # a hold as strong as bending over 6 mm: (1 / 6 mm)^4 per area
        hold = (ones | zeros) * self._areas / 0.006**4
        system = self._energy + sparse.diags_array(hold + 1e-9 * hold.max())
        return np.clip(Factor(system).solve(hold * ones), 0.0, 1.0)


def _jaw_constraints(
    vertices: NDArray, regions: dict[str, NDArray], hinge: NDArray, mouth: NDArray
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """What surely turns with the jaw and what surely does not (n,)."""
    lower = regions["lips_lower"] | regions["lips_inner_lower"]
    upper = regions["lips_upper"] | regions["lips_inner_upper"]
    corner = np.min([np.linalg.norm(vertices - end, axis=1) for end in (mouth[0], mouth[2])], axis=0) < _CORNER_FREE_M
    elevation = np.degrees(np.arctan2(vertices[:, 1] - hinge[1], vertices[:, 2] - hinge[2]))
    shut = np.degrees(np.arctan2(mouth[1, 1] - hinge[1], mouth[1, 2] - hinge[2]))
    forward = vertices[:, 2] > hinge[2] + 0.25 * (mouth[1, 2] - hinge[2])
    bone = regions["face"] & forward & (elevation < shut - _JAW_GAP_DEG) & ~upper
    skull = (elevation > shut + _JAW_GAP_DEG) | (vertices[:, 2] < hinge[2] - 0.01) | regions["scalp"] | regions["ears"]
    throat = regions["neck"] & (vertices[:, 1] < vertices[bone, 1].min() - 0.028)
    return (bone | lower) & ~corner, (skull | throat | upper) & ~corner & ~lower
