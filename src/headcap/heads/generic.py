"""The embedded head model: the procedural base head with generic modes, two joints and smooth weights."""

from functools import lru_cache

import numpy as np

from headcap.heads import modes, rigging
from headcap.heads.model import POSE_FEATURES, HeadModel
from headcap.heads.procedural import base_head, lip_pairs
from headcap.heads.regions import with_lip_regions, with_neck_regions

NECK_JOINT_M = (0.0, -0.115, -0.030)
"""Middle of the cervical spine of the base head."""
JAW_JOINT_M = (0.0, -0.022, 0.006)
"""Middle between the jaw's hinges, below and before the ear canals."""


@lru_cache(maxsize=2)
def procedural_model(shapes: int = 30, expressions: int = 100, dtype: type = np.float32) -> HeadModel:
    """The base head (about 13 thousand vertices) as a model: what to start from without FLAME.

    Its shape and expression bases are generic smooth modes, not learned; pose correctives are zero and the speech basis empty
    until training.
    """
    head = base_head()
    vertices, joints = head.vertices, np.array([NECK_JOINT_M, JAW_JOINT_M])
    regions = with_lip_regions(head.regions)
    regions = with_neck_regions(vertices, head.triangles, regions, vertices[head.landmarks["larynx"]], joints[0])
    line = vertices[lip_pairs()].mean(axis=1)
    mouth = line[[0, len(line) // 2, -1]]
    moving = regions["face"] | regions["lips_inner"] | regions["mouth_interior"]
    model = HeadModel(
        name="procedural",
        vertices=vertices,
        triangles=head.triangles,
        shape_basis=modes.shape_modes(vertices, shapes),
        expression_basis=modes.surface_modes(vertices, head.triangles, moving & ~regions["eyes"], expressions),
        pose_basis=np.zeros((POSE_FEATURES, *vertices.shape)),
        speech_basis=np.zeros((0, *vertices.shape)),
        joint_regressor=rigging.joint_regressor(vertices, joints, rigging.joint_supports(vertices, regions, joints)),
        skinning_weights=rigging.skinning_weights(vertices, head.triangles, regions, joints, mouth),
        uv=head.uv,
        uv_triangles=head.uv_triangles,
        regions=regions,
        landmarks=head.landmarks,
    )
    return model.astype(dtype)
