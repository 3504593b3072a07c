"""How the subject moves while the cameras fire one after the other, told by the cameras' own disagreement.

Every view fixes the mesh at its own moment. Where the assumed motion within the frame is wrong, views that fired early and views
that fired late disagree about where the mesh is: a few weights of motion fields explain that in the least-squares sense, with
every vertex's own position left free.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from headcap.registration.photometric import Normal

SHRINKAGE = 0.02
"""Share of a weight's own information that pulls it to zero: keeps weights that the delays cannot tell apart small."""
DEPTH_DAMPING = 1e-3
"""Share of a vertex's mean information added on all axes: one view alone leaves its viewing direction open."""


def fit_motion(parts: list[Normal], fields: list[NDArray]) -> NDArray[np.float64]:
    """Weights (k,) of motion fields that make the views agree.

    `parts` are the views' normal equations at the mesh where each view assumes it; `fields` holds per view (k, n, 3) metres by
    which one unit of each weight moves the mesh at that view's moment.
    """
    total = parts[0]
    for part in parts[1:]:
        total = total + part
    inverse = _inverse_blocks(total.blocks)
    count = len(fields[0])
    own, gain, right = np.zeros((count, count)), np.zeros((count, *total.right.shape)), np.zeros(count)
    for part, field in zip(parts, fields, strict=True):
        _gather(part.blocks, part.right, np.ascontiguousarray(field), own, gain, right)
    solved = np.einsum("nij,knj->kni", inverse, gain)
    matrix = own - np.einsum("kni,lni->kl", solved, gain) + np.diag(SHRINKAGE * np.diag(own) + 1e-30)
    return np.linalg.solve(matrix, right - np.einsum("kni,ni->k", solved, total.right))


def shifted(part: Normal, motion: NDArray) -> Normal:
    """A view's normal equations after the mesh at its moment moved by (n, 3), to first order."""
    return Normal(part.blocks, part.right - part.apply(motion), part.residual)


@njit(cache=True)
def _gather(blocks, vertex_right, field, own, gain, right):
    """Add one view's share: its matrix between fields (k, k), its images of the fields (k, n, 3), its right-hand side (k,)."""
    image = np.zeros((len(field), 3))
    for v in range(len(blocks)):
        xx, xy, xz, yy, yz, zz = blocks[v]
        if xx + yy + zz == 0.0:
            continue
        for k in range(len(field)):
            x, y, z = field[k, v]
            image[k, 0], image[k, 1], image[k, 2] = xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z
            for i in range(3):
                gain[k, v, i] += image[k, i]
                right[k] += field[k, v, i] * vertex_right[v, i]
            for j in range(k + 1):
                own[k, j] += image[k, 0] * field[j, v, 0] + image[k, 1] * field[j, v, 1] + image[k, 2] * field[j, v, 2]
    for k in range(len(field)):
        for j in range(k):
            own[j, k] = own[k, j]


def _inverse_blocks(blocks: NDArray) -> NDArray:
    full = blocks[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    trace = np.trace(full, axis1=1, axis2=2)
    seen = trace > 0
    out = np.zeros_like(full)
    out[seen] = np.linalg.inv(full[seen] + DEPTH_DAMPING / 3 * trace[seen, None, None] * np.eye(3))
    return out
