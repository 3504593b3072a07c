"""A head model of some vertices alone: what landmarks, or the error over a region, need of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from headcap.heads import JOINTS, HeadModel
from headcap.heads.model import BASES


def model_of_vertices(model: HeadModel, chosen: NDArray) -> HeadModel:
    """The model of chosen vertices (k,), which may repeat, followed by one vertex at each joint, from which it is regressed.

    All stages of `HeadModel` give at the first k what the whole model gives at `chosen`: joints are linear in the identity, and
    so are the vertices that stand for them. It has one triangle that means nothing, and no regions.
    """
    regress, k = model.joint_regressor, len(chosen)
    joints = len(JOINTS)
    changes = {}
    for name in BASES:
        basis = getattr(model, name)
        at_joints = np.einsum("jn,snc->sjc", regress, basis) if name == "shape_basis" else np.zeros((len(basis), joints, 3))
        changes[name] = np.concatenate([basis[:, chosen], at_joints], axis=1).astype(basis.dtype)
    regressor = np.zeros((joints, k + joints), regress.dtype)
    regressor[:, k:] = np.eye(joints)
    weights = np.zeros((joints, joints + 1), model.skinning_weights.dtype)
    weights[:, 0] = 1.0
    return replace(
        model,
        vertices=np.concatenate([model.vertices[chosen], model.joints()]).astype(model.vertices.dtype),
        triangles=np.array([[0, 1, 2]], np.int32),
        joint_regressor=regressor,
        skinning_weights=np.concatenate([model.skinning_weights[chosen], weights]),
        uv=None,
        uv_triangles=None,
        regions={},
        landmarks={},
        **changes,
    )
