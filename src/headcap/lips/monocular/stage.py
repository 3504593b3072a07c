"""A clip to files: the base track, the camera it was seen by, and a sheet of frames with the face drawn over them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from headcap.calibration.result import save_cameras
from headcap.cameras import Camera, Rig
from headcap.errors import InputError
from headcap.heads import HeadModel
from headcap.lips.clips import Clip
from headcap.lips.monocular.identity import Identified, KeyFrame, identify, identity_surface, key_frames
from headcap.lips.monocular.overlay import draw_face
from headcap.lips.monocular.person import MonocularPerson
from headcap.lips.monocular.sequence import MonocularTrack, place_frames, track_video
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
    *,
    who_alone: bool = False,
) -> dict[str, float]:
    """Follow the face through a clip, write track, camera and sheet, and return the track's figures.

    A `person` who is known already is placed and not estimated; `who_alone` as `followed_clip` has it. Raises `InputError` as
    `track_video`.
    """
    kept: dict[int, NDArray[np.uint8]] = {}
    shown = set(np.unique(np.linspace(0, len(clip) - 1, _SHOWN).round().astype(int)).tolist())

    def pictures() -> Iterator[NDArray[np.uint8]]:
        """All frames; those of the sheet are kept on their way."""
        for number, image in enumerate(clip.pictures()):
            if number in shown:
                kept[number] = image
            yield image

    found = followed_clip(model, replace(clip, open_pictures=pictures), settings, detections, person, who_alone)
    if len(found) < len(clip):
        kept = {row: image for row, (_, image) in enumerate(_pictures(clip, np.searchsorted(clip.time_s, found.time_s).tolist()))}
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
    who_alone: bool = False,
) -> MonocularTrack:
    """The track of a clip; where the head turns and nobody is known, once to see it turn and again with who that shows.

    Where it is asked for `who_alone` that is, the track has those frames alone, each at its own time, that told it, as they told
    it; but all of them as ever where one of them does not look so. Raises `InputError` as `track_video`.
    """
    given = (clip.time_s, detections, settings)
    track = track_video(model, clip.camera, clip.pictures(), *given, focal_known=clip.focal_known, person=person)
    turn = None if person else _turned(model, clip, settings, track)
    if turn is None:
        return track
    ratio = float(np.exp(turn.found.log_focal))
    seen = replace(clip, camera=replace(track, focal_ratio=ratio).camera(clip.camera))
    again = turn.track(model, seen, settings) if who_alone else None
    if again is None:
        again = _led_through(model, seen, settings, detections, turn.found.person, int(track.answered.sum()))
    return track if again is None else replace(again, focal_ratio=ratio)


@dataclass(frozen=True, eq=False)
class _Turn:
    """Frames of a clip in which a head turns, and what they told together."""

    numbers: list[int]
    frames: list[KeyFrame]
    found: Identified

    def track(self, model: HeadModel, clip: Clip, settings: MonocularSettings) -> MonocularTrack | None:
        """These frames as they were told, in order; None where one of them does not look so."""
        order = np.argsort(self.numbers)
        pictures = [self.frames[k].picture for k in order]
        # the person is a part of the surface then, and the lens one of the camera
        told = [replace(self.found.estimates[k], shape=np.zeros(0), log_focal=0.0) for k in order]
        time_s = clip.time_s[np.sort(self.numbers)]
        try:
            track = place_frames(model, clip.camera, pictures, time_s, told, settings, self.found.person)
        except InputError:
            return None
        return track if track.answered.all() else None


def _turned(model: HeadModel, clip: Clip, settings: MonocularSettings, track: MonocularTrack) -> _Turn | None:
    """Who a head is that turns as tracked; None where it does not turn."""
    numbers = key_frames([_estimate(track, clip.camera, k) for k in range(len(track))], settings.identity)
    if not numbers:
        return None
    frames = [KeyFrame(picture, _estimate(track, clip.camera, k)) for k, picture in _pictures(clip, numbers)]
    surface = identity_surface(FaceSurface(model, settings.expressions, settings.shapes), settings)
    own = replace(clip.camera, camera_from_world=np.eye(4))
    return _Turn(numbers, frames, identify(surface, own, frames, settings, focal_known=clip.focal_known))


def _led_through(
    model: HeadModel,
    clip: Clip,
    settings: MonocularSettings,
    detections: Mapping[int, NDArray] | None,
    person: MonocularPerson,
    least: int,
) -> MonocularTrack | None:
    """The track of a clip with who was found, None where that leads through fewer than `least` frames.

    Somebody who is followed less well than from one frame alone is not who turned: hands, hair or a cut misled.
    """
    try:
        track = track_video(model, clip.camera, clip.pictures(), clip.time_s, detections, settings, person=person)
    except InputError:
        return None
    return track if track.answered.sum() >= least else None


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
