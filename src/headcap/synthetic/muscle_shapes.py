"""Shapes of a rehearsed person in which one muscle acts and all others rest, as the quasi-eigen paper has them sculpted (5.3)."""

from __future__ import annotations

import numpy as np

from headcap.expressions import ExpressionBasis
from headcap.heads.procedural import base_head
from headcap.synthetic.mesh_takes import MeshSubject
from headcap.synthetic.performance import ARTICULATORS, MUSCLES
from headcap.synthetic.subject import AT_REST

_BOTH_WAYS = {
    "jaw_side": ("jaw_left", "jaw_right"),
    "upper_roll": ("upper_lip_rolled_in", "upper_lip_rolled_out"),
    "lower_roll": ("lower_lip_rolled_in", "lower_lip_rolled_out"),
    "mouth_side": ("mouth_left", "mouth_right"),
}
"""Channels from -1 to 1, and what their two ends are called."""
_NAMES = {
    "jaw": "jaw_open",
    "rounding": "lips_rounded",
    "spreading": "lips_spread",
    "closure": "lips_pressed",
    "tuck": "lip_tucked",
}
_LEAST_M = 0.2e-3
"""What moves no vertex so far has no shape: eyelids, which meshes without eyeballs do not close."""


def muscle_shapes(subject: MeshSubject) -> ExpressionBasis:
    """One shape per muscle and articulator, fully actuated, in the base head's topology; two for what moves both ways."""
    names, displacements = [], []
    for channel in (*MUSCLES, *ARTICULATORS):
        for name, value in zip(_BOTH_WAYS.get(channel, (_NAMES.get(channel, channel),)), (1.0, -1.0), strict=False):
            moved = subject.mesh(AT_REST | {channel: value}) - subject.neutral_m
            if np.linalg.norm(moved, axis=1).max() >= _LEAST_M:
                names.append(name)
                displacements.append(moved)
    return ExpressionBasis(tuple(names), subject.neutral_m, np.array(displacements), base_head().triangles)
