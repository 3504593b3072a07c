"""Hand-made expressions of a rehearsed person: in each one muscle acts and all others rest (quasi-eigen paper, section 5.3)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from headcap.expressions import ExpressionBasis
from headcap.heads.procedural import base_head
from headcap.synthetic.mesh_takes import MeshSubject
from headcap.synthetic.performance import ARTICULATORS, MUSCLES
from headcap.synthetic.sculptor import SculptorSettings, sculpt
from headcap.synthetic.subject import AT_REST

HAND_MADE = "expressions.npz"
"""What they are called among what is rehearsed."""
_NAMES = {
    "jaw": "jaw_open",
    "jaw_side": "jaw_left",
    "rounding": "lips_rounded",
    "spreading": "lips_spread",
    "closure": "lips_pressed",
    "tuck": "lip_tucked",
    "upper_roll": "upper_lip_rolled_in",
    "lower_roll": "lower_lip_rolled_in",
    "mouth_side": "mouth_left",
}
_LEAST_M = 0.2e-3
"""What moves no vertex so far has no shape: eyelids, which meshes without eyeballs do not close."""


def muscle_shapes(subject: MeshSubject) -> ExpressionBasis:
    """One shape per muscle and articulator, fully actuated, in the base head's topology.

    Of what moves both ways only one end: the other is nearly its opposite and would add a shape but no direction.
    """
    moved = {
        _NAMES.get(name, name): subject.mesh(AT_REST | {name: 1.0}) - subject.neutral_m for name in (*MUSCLES, *ARTICULATORS)
    }
    seen = {name: shape for name, shape in moved.items() if np.linalg.norm(shape, axis=1).max() >= _LEAST_M}
    return ExpressionBasis(tuple(seen), subject.neutral_m, np.array(list(seen.values())), base_head().triangles)


def write_hand_made(folder: Path, subject: MeshSubject, settings: SculptorSettings) -> None:
    """Write `expressions.npz` (artifact `headcap.expression_basis/1`): a person's shapes as a sculptor would make them."""
    sculpt(muscle_shapes(subject), settings, subject.seed).save(folder / HAND_MADE)
