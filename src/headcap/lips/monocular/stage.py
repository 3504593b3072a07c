"""A clip to files: the base track, the camera it was seen by, and a sheet of frames with the face drawn over them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.calibration.result import save_cameras
from headcap.cameras import Camera, Rig
from headcap.errors import InputError
from headcap.heads import HeadModel
from headcap.lips.clips import Clip
from headcap.lips.monocular.identity import KeyFrame, identify, identity_surface, key_frames
from headcap.lips.monocular.overlay import draw_face
from headcap.lips.monocular.person import MonocularPerson
from headcap.lips.monocular.sequence import MonocularTrack, track_video
from headcap.lips.monocular.settings import MonocularSettings
from headcap.lips.monocular.surface import Estimate, FaceSurface
from headcap.recordings.writer import write_picture

_SHOWN, _HEIGHT_PX = 8, 320


def track_clip(
    model: HeadModel,
    clip: Clip,
    settings: MonocularSettings,
    track: Path,
    camera: Path,
    picture: Path,
    detections: Mapping[int, NDArray] | None = None,
    person: MonocularPerson | None = None,
) -> dict[str, float]:
    """Follow the face through a clip, write track, camera and sheet, and return the track's figures.

    A `person` who is known already is placed and not estimated. Raises `InputError` as `track_video`.
    """
    kept: dict[int, NDArray[np.uint8]] = {}
    shown = set(np.unique(np.linspace(0, len(clip) - 1, _SHOWN).round().astype(int)).tolist())

    def pictures() -> Iterator[NDArray[np.uint8]]:
        """All frames; those of the sheet are kept on their way."""
        for number, image in enumerate(clip.pictures()):
            if number in shown:
                kept[number] = image
            yield image

    found = followed_clip(model, replace(clip, open_pictures=pictures), settings, detections, person)
    found.save(track)
    save_cameras(camera, Rig((found.camera(clip.camera),)))
    write_picture(picture, sheet(model, clip.camera, found, kept, settings))
    return track_figures(found)


def person_of(tracks: Sequence[Path]) -> MonocularPerson | None:
    """Whom the first of some tracks shows, None without any; raises `ArtifactError`."""
    return MonocularTrack.load(tracks[0]).person if tracks else None


def followed_clip(
    model: HeadModel,
    clip: Clip,
    settings: MonocularSettings,
    detections: Mapping[int, NDArray] | None = None,
    person: MonocularPerson | None = None,
) -> MonocularTrack:
    """The track of a clip; where the head turns and nobody is known, once to see it turn and again with who that shows.

    Raises `InputError` as `track_video`.
    """
    given = (clip.time_s, detections, settings)
    track = track_video(model, clip.camera, clip.pictures(), *given, focal_known=clip.focal_known, person=person)
    numbers = [] if person else key_frames([_estimate(track, clip.camera, k) for k in range(len(track))], settings.identity)
    if not numbers:
        return track
    frames = [KeyFrame(picture, _estimate(track, clip.camera, k)) for k, picture in _pictures(clip, numbers)]
    surface = identity_surface(FaceSurface(model, settings.expressions, settings.shapes), settings)
    own = replace(clip.camera, camera_from_world=np.eye(4))
    found = identify(surface, own, frames, settings, focal_known=clip.focal_known)
    seen = replace(track, focal_ratio=float(np.exp(found.log_focal))).camera(clip.camera)
    try:
        again = track_video(model, seen, clip.pictures(), *given, person=found.person)
    except InputError:
        return track
    # somebody who is followed less well than from one frame alone is not who turned: hands, hair or a cut misled
    if again.answered.sum() < track.answered.sum():
        return track
    return replace(again, focal_ratio=float(np.exp(found.log_focal)))


def _pictures(clip: Clip, numbers: Sequence[int]) -> list[tuple[int, NDArray[np.uint8]]]:
    """Some of a clip's pictures with their numbers, in the order of the numbers."""
    wanted = set(numbers)
    read = {k: picture for k, picture in enumerate(clip.pictures()) if k in wanted}
    return [(k, read[k]) for k in numbers]


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
    surface, columns = FaceSurface(model, settings.expressions, person=track.person), []
    for number, picture in pictures.items():
        drawn = picture
        if track.answered[number]:
            estimate = replace(_estimate(track, camera, number), shape=np.zeros(0))
            drawn = draw_face(picture, surface, camera, estimate)
        columns.append(np.concatenate([picture, drawn]))
    share = _HEIGHT_PX / camera.height
    return cv2.resize(np.concatenate(columns, axis=1), None, fx=share, fy=share, interpolation=cv2.INTER_AREA)


def _estimate(track: MonocularTrack, camera: Camera, number: int) -> Estimate | None:
    """A frame's unknowns beside who the track says it is; None where the face is lost."""
    if not track.answered[number]:
        return None
    camera_from_head = camera.camera_from_world @ track.placement[number]
    log_focal = float(np.log(track.focal_ratio))
    return Estimate(camera_from_head, track.jaw[number], track.expression[number], track.shape, log_focal)
