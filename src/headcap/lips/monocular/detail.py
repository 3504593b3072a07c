"""Fine detail on the meshes of a tracked clip: shading-based refinement, frame by frame (lip paper, section 3.2)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from headcap.geometry.transforms import invert, transform
from headcap.heads import HeadModel
from headcap.lips.clips import Clip
from headcap.lips.monocular.photometric import Level
from headcap.lips.monocular.pictures import levels_of, resized
from headcap.lips.monocular.sequence import MonocularTrack
from headcap.lips.monocular.shading import ShadingSettings, painted_albedo, shaded_detail
from headcap.lips.monocular.surface import FaceSurface


def detailed_meshes(
    model: HeadModel, clip: Clip, track: MonocularTrack, meshes: Iterable[NDArray], settings: ShadingSettings | None = None
) -> Iterator[NDArray[np.float64]]:
    """Meshes (n, 3) of a clip's frames in the camera's world with the skin's fine detail put in, metres, one at a time.

    `meshes` are the base track's or corrected ones, NaN where there is no answer; `clip.camera` is the one that was tracked with.
    Skin is painted by the first frame that has an answer: detail is how the others differ from it, and it shows none itself.
    Eyes, the mouth's inside and what the camera does not see stay. Raises `InputError` for a track of another head model.
    """
    surface, settings = FaceSurface(model, 0, 0), settings or ShadingSettings()
    track.check(model)
    camera = replace(clip.camera, camera_from_world=np.eye(4))
    skin, albedo = np.where(surface.blind, 0.0, 1.0), None
    for light, picture, mesh in zip(track.light, clip.pictures(), meshes, strict=True):
        out = np.asarray(mesh, np.float64).copy()
        if not np.isfinite(out).all():
            yield out
            continue
        level: Level = levels_of(picture, [resized(camera, *camera.size)])[0]
        seen = transform(clip.camera.camera_from_world, out[surface.vertices])
        if albedo is None:
            albedo = painted_albedo(level, seen, surface.triangles, light, settings)
        refined = shaded_detail(level, seen, surface.triangles, light, albedo, skin, settings).vertices[: len(seen)]
        moved = transform(invert(clip.camera.camera_from_world), refined)
        out[surface.vertices[~surface.blind]] = moved[~surface.blind]
        yield out
