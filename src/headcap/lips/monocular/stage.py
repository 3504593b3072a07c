"""A clip to files: the base track, the camera it was seen by, and a sheet of frames with the face drawn over them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import atomic_path
from headcap.calibration.result import save_cameras
from headcap.cameras import Camera, Rig
from headcap.heads import HeadModel
from headcap.lips.clips import Clip
from headcap.lips.monocular.overlay import draw_face
from headcap.lips.monocular.sequence import MonocularTrack, track_video
from headcap.lips.monocular.settings import MonocularSettings
from headcap.lips.monocular.surface import Estimate, FaceSurface

_SHOWN, _HEIGHT_PX = 8, 320


def track_clip(
    model: HeadModel,
    clip: Clip,
    settings: MonocularSettings,
    track: Path,
    camera: Path,
    picture: Path,
    detections: Mapping[int, NDArray] | None = None,
) -> dict[str, float]:
    """Follow the face through a clip, write track, camera and sheet, and return the track's figures.

    Raises `InputError` as `track_video`.
    """
    kept: dict[int, NDArray[np.uint8]] = {}
    shown = set(np.unique(np.linspace(0, len(clip) - 1, _SHOWN).round().astype(int)).tolist())

    def pictures() -> Iterator[NDArray[np.uint8]]:
        """All frames; those of the sheet are kept on their way."""
        for number, image in enumerate(clip.pictures()):
            if number in shown:
                kept[number] = image
            yield image

    found = track_video(model, clip.camera, pictures(), clip.time_s, detections, settings, focal_known=clip.focal_known)
    found.save(track)
    save_cameras(camera, Rig((found.camera(clip.camera),)))
    _save_picture(picture, sheet(model, clip.camera, found, kept, settings))
    return track_figures(found)


def track_figures(track: MonocularTrack) -> dict[str, float]:
    """Share of frames followed, median photometric residual (linear intensity), least correlation of rendering and picture."""
    answered = track.answered
    return {
        "lips.answered": float(answered.mean()),
        "lips.photometric_residual": float(np.median(track.residual[answered])),
        "lips.least_correlation": float(track.correlation[answered].min()),
    }


def sheet(
    model: HeadModel,
    camera: Camera,
    track: MonocularTrack,
    pictures: Mapping[int, NDArray[np.uint8]],
    settings: MonocularSettings,
) -> NDArray[np.uint8]:
    """Frames by number (height, width, 3) side by side, above as they are, below with the face that the track has there."""
    surface, columns = FaceSurface(model, settings.expressions, settings.shapes), []
    for number, picture in pictures.items():
        drawn = picture
        if track.answered[number]:
            drawn = draw_face(picture, surface, camera, _estimate(track, camera, number))
        columns.append(np.concatenate([picture, drawn]))
    share = _HEIGHT_PX / camera.height
    return cv2.resize(np.concatenate(columns, axis=1), None, fx=share, fy=share, interpolation=cv2.INTER_AREA)


def _estimate(track: MonocularTrack, camera: Camera, number: int) -> Estimate:
    camera_from_head = camera.camera_from_world @ track.placement[number]
    return Estimate(camera_from_head, track.jaw[number], track.expression[number], track.shape, float(np.log(track.focal_ratio)))


def _save_picture(path: Path, picture: NDArray[np.uint8]) -> None:
    coded = cv2.imencode(".png", picture)[1]
    with atomic_path(path) as temporary:
        temporary.write_bytes(coded.tobytes())
