"""Lip tattoos painted over with the lips of the same person untattooed (section 3.2.1, figure 5)."""

from headcap.lips.inpainting.figure import inpainting_figure
from headcap.lips.inpainting.moments import most_alike, most_unlike, slightly_open
from headcap.lips.inpainting.painter import LipPainter
from headcap.lips.inpainting.region import LipRegion
from headcap.lips.inpainting.settings import InpaintingSettings
from headcap.lips.inpainting.stage import BareLips, bare_lips, inpaint_take
from headcap.lips.inpainting.takes import MeshMotion, TrackedTake, TrackedTakeFiles
from headcap.lips.inpainting.texture import LipTexture, lip_texture

__all__ = [
    "BareLips",
    "InpaintingSettings",
    "LipPainter",
    "LipRegion",
    "LipTexture",
    "MeshMotion",
    "TrackedTake",
    "TrackedTakeFiles",
    "bare_lips",
    "inpaint_take",
    "inpainting_figure",
    "lip_texture",
    "most_alike",
    "most_unlike",
    "slightly_open",
]
