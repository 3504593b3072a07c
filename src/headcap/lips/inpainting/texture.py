"""The untattooed lips as a texture: one moment of the bare person, seen by all cameras (section 3.2.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_arrays, save_arrays
from headcap.cameras import Rig
from headcap.errors import InputError
from headcap.lips.inpainting.region import LipRegion
from headcap.lips.inpainting.settings import InpaintingSettings
from headcap.lips.inpainting.views import TexelView, view_texels
from headcap.registration.template import Template

KIND, SCHEMA = "lip_texture", 1
_GAIN_ROUNDS = 20
_LEAST_SHARED = 200
"""Texels that tell a camera's gain; one that shares fewer with the others is left out."""


@dataclass(frozen=True, eq=False)
class LipTexture:
    """Colours of the bare region, as the camera to be painted into would show them."""

    region: LipRegion
    colours: NDArray[np.float32]
    """(height, width, 3) of the atlas, channels as the pictures', 0 to 255; filled in where no camera saw it."""
    known: NDArray[np.bool_]
    """(height, width) texels that a camera saw."""
    mesh: NDArray[np.float64]
    """(n, 3) metres, at the moment the pictures were taken."""
    settings: InpaintingSettings

    @property
    def of_texels(self) -> NDArray[np.float64]:
        """(t, 3) colours of the texels that lie on the skin."""
        return self.colours[tuple(self.region.texel.T)].astype(float)

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.lip_texture/1`."""
        arrays = {f"region/{field.name}": np.asarray(getattr(self.region, field.name)) for field in fields(LipRegion)}
        arrays |= {"colours": self.colours, "known": self.known, "mesh": self.mesh}
        save_arrays(path, KIND, SCHEMA, arrays, {"settings": self.settings.model_dump(mode="json")})

    @classmethod
    def load(cls, path: Path | str) -> LipTexture:
        """Read what `save` wrote; raises `ArtifactError`."""
        arrays, meta = load_arrays(path, KIND, SCHEMA)
        parts = {field.name: arrays[f"region/{field.name}"] for field in fields(LipRegion)}
        region = LipRegion(**parts | {"first_width": int(parts["first_width"])})
        settings = InpaintingSettings.model_validate(meta["settings"])
        return cls(region, arrays["colours"], arrays["known"], arrays["mesh"], settings)


def lip_texture(
    template: Template,
    mesh: NDArray,
    rig: Rig,
    pictures: Sequence[NDArray[np.uint8] | None],
    camera: str,
    settings: InpaintingSettings | None = None,
) -> LipTexture:
    """The untattooed lips from one moment without the tattoo: `mesh` (n, 3), metres, in the template's topology and the rig's
    world, and each camera's picture (height, width, 3) or None, as in `TakeFrames.images_at`.

    The mouth should be a little open. Texels are means over the cameras that see them, weighted by the squared cosine between
    normal and line of sight: what one pixel shows grows as the cosine falls, along one axis, and shine with it. Gains per camera
    and channel make the views agree with `camera`, into whose frames the texture will be painted. Raises `InputError` where that
    camera has no picture or does not see the mouth.
    """
    settings = settings or InpaintingSettings()
    region = LipRegion.of(template, settings)
    views = {c.name: view_texels(region, c, mesh, p) for c, p in zip(rig, pictures, strict=True) if p is not None}
    if camera not in views or (views[camera].weight > 0).sum() < _LEAST_SHARED:
        raise InputError(
            f"camera {camera} {'does not see the mouth' if camera in views else 'has no picture'} at the untattooed moment",
            expected="a frontal camera of the rig, whose takes are painted over",
            remedy="Name another camera, or another frame of the take without tattoo.",
        )
    gains = _gains(views, camera)
    total, weights = np.zeros((len(region.texel), 3)), np.zeros(len(region.texel))
    for name, gain in gains.items():
        view = views[name]
        total += view.weight[:, None] * gain * view.colours
        weights += view.weight
    colours = total / np.maximum(weights, 1e-12)[:, None]
    known = region.spread((weights > 0)[:, None].astype(float))[..., 0] > 0.5
    return LipTexture(region, fill(region.spread(colours), known), known, np.asarray(mesh, float), settings)


def _gains(views: dict[str, TexelView], reference: str) -> dict[str, NDArray[np.float64]]:
    """(3,) per camera: their logarithms make the weighted views agree where they see the same texels; the reference has 1."""
    names = list(views)
    weight = np.stack([views[name].weight for name in names])[..., None]
    logs = np.log(np.maximum(np.stack([views[name].colours for name in names]), 1.0))
    gains = np.zeros((len(names), 1, 3))
    for _ in range(_GAIN_ROUNDS):
        consensus = (weight * (logs + gains)).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-12)
        gains = (weight * (consensus - logs)).sum(axis=1, keepdims=True) / np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)
        gains -= gains[names.index(reference)]
    shared = [(np.sum((weight > 0)[:, :, 0], axis=0)[views[name].weight > 0] > 1).sum() for name in names]
    return {
        name: np.exp(gain[0])
        for name, gain, count in zip(names, gains, shared, strict=True)
        if name == reference or count >= _LEAST_SHARED
    }


def fill(values: NDArray, known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """An atlas (h, w, k) whose unknown texels take on what the known ones around them show: normalised averages that widen
    (Knutsson and Westin 1993, normalized convolution), the narrowest that reaches a texel counts."""
    out, missing = np.where(known[..., None], values, 0.0).astype(np.float32), ~known
    source, share = out.copy(), known.astype(np.float32)
    sigma = 1.0
    while missing.any() and sigma < 2 * max(known.shape):
        blurred = cv2.GaussianBlur(source, (0, 0), sigma).reshape(source.shape)
        near = cv2.GaussianBlur(share, (0, 0), sigma)
        reached = missing & (near > 0.05)
        out[reached] = blurred[reached] / near[reached][:, None]
        missing = missing & ~reached
        sigma *= 2
    return out
