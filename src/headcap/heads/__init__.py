"""The head model: identity, expression, pose, skinning; its sources FLAME, ICT-FaceKit and the procedural base head."""

from headcap.heads.flame import FlameSettings, load_flame
from headcap.heads.generic import procedural_model
from headcap.heads.ict import load_ict
from headcap.heads.model import HeadCoefficients, HeadModel, RestOffset
from headcap.heads.procedural import base_head
from headcap.heads.skinning import JOINTS

__all__ = [
    "JOINTS",
    "FlameSettings",
    "HeadCoefficients",
    "HeadModel",
    "RestOffset",
    "base_head",
    "load_flame",
    "load_ict",
    "procedural_model",
]
