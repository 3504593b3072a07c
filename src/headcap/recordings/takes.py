"""A take: one recording per camera, checked before anything is computed from it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from headcap.artifacts import load_json, save_json
from headcap.errors import InputError, InputErrors
from headcap.recordings.audio import read_audio
from headcap.recordings.freezes import find_freezes
from headcap.recordings.pictures import PictureSurvey, picture_problems, survey_pictures
from headcap.recordings.probe import Recording, probe
from headcap.recordings.settings import IngestSettings
from headcap.recordings.timing import timing

KIND, SCHEMA = "ingested_take", 1


@dataclass(frozen=True)
class IngestedTake:
    """The recordings of one take, in the session's camera order, found usable."""

    take: str
    kind: str
    recordings: tuple[Recording, ...]
    picture_digests: tuple[str, ...] = ()
    """Per recording: equal ones show the same pictures."""
    picture_changes: tuple[tuple[float, ...], ...] = ()
    """Per recording and frame, grey values by which the part that changed most differs from the frame before."""

    @property
    def cameras(self) -> tuple[str, ...]:
        """Names in the order of `recordings`."""
        return tuple(recording.camera for recording in self.recordings)

    def __getitem__(self, camera: str) -> Recording:
        return self.recordings[self.cameras.index(camera)]

    def save(self, path: Path | str) -> None:
        """Write as JSON artifact `headcap.ingested_take/1`."""
        recordings = [recording.to_json() for recording in self.recordings]
        content = {"take": self.take, "kind": self.kind, "recordings": recordings}
        pictures = {"picture_digests": list(self.picture_digests), "picture_changes": list(map(list, self.picture_changes))}
        save_json(path, KIND, SCHEMA, content | pictures)

    @classmethod
    def load(cls, path: Path | str) -> IngestedTake:
        """Read what `save` wrote; raises `ArtifactError`."""
        content = load_json(path, KIND, SCHEMA)
        recordings = tuple(Recording.from_json(document) for document in content["recordings"])
        changes = tuple(map(tuple, content.get("picture_changes", ())))
        return cls(content["take"], content["kind"], recordings, tuple(content["picture_digests"]), changes)


def ingest_take(
    take: str,
    kind: str,
    files: Mapping[str, Path | str | None],
    *,
    rate_hz: float,
    needs_sound: bool,
    min_duration_s: float | None = None,
    min_frames: int | None = None,
    settings: IngestSettings | None = None,
) -> IngestedTake:
    """Probe and check every camera's file of a take.

    `files` maps each camera of the session to its recording. `needs_sound` where the take is synchronised by a clap.
    Raises `InputErrors` with all problems of all cameras at once, each with value, expectation and remedy.
    """
    settings = settings or IngestSettings()
    problems, kept = [], []
    for camera, path in files.items():
        found, recording, survey = _check_recording(camera, path, take, needs_sound, settings)
        if recording is not None:
            found += _rate_problems(recording, rate_hz, settings) + _length_problems(recording, min_duration_s, min_frames)
            found += _gap_problems(recording, settings)
            kept.append((recording, survey))
        problems += found
    digests = tuple("" if survey.brightest < settings.black_level else survey.digest for _, survey in kept)
    problems += _copies({recording.camera: digest for (recording, _), digest in zip(kept, digests, strict=True) if digest}, take)
    changes = tuple(tuple(np.round(survey.change.astype(float), 2).tolist()) for _, survey in kept)
    ingested = IngestedTake(take, kind, tuple(recording for recording, _ in kept), digests, changes)
    problems += freezes_of(ingested, settings)
    if problems:
        raise InputErrors(problems)
    return ingested


def check_same_cameras(takes: Iterable[IngestedTake]) -> None:
    """Refuse a camera whose picture size or turn differs between takes, and a file given to two takes.

    One calibration holds for all takes of a session only as long as the lens, the sensor mode and the mount stay as they
    are. Raises `InputErrors`.
    """
    first: dict[str, tuple[str, Recording]] = {}
    shown: dict[str, tuple[str, str]] = {}
    problems = []
    for take in takes:
        for recording, digest in zip(take.recordings, take.picture_digests, strict=True):
            before_take, before = first.setdefault(recording.camera, (take.take, recording))
            if _geometry(before) != _geometry(recording):
                found = f"{recording.camera} shows {_geometry(recording)} in {take.take}"
                remedy = "Record all takes in one mode and orientation, or leave the camera out of the take"
                problems.append(InputError(found, expected=f"{_geometry(before)} as in {before_take}", remedy=remedy))
            other_take, other_camera = shown.setdefault(digest, (take.take, recording.camera))
            if other_take != take.take:
                found = f"{recording.camera} of {take.take} shows the same pictures as {other_camera} of {other_take}"
                problems.append(
                    InputError(found, expected="a recording of its own", remedy="Correct the file in the session file")
                )
    if problems:
        raise InputErrors(problems)


def freezes_of(
    take: IngestedTake, settings: IngestSettings | None = None, *, start_s: Mapping[str, float] | None = None
) -> list[InputError]:
    """Cameras whose pictures rest for a while although the others' change; see `find_freezes`.

    With `start_s`, common time of each camera's own zero (a few milliseconds are good enough), short freezes and those in
    takes with pauses are found as well. A recording of which not all frames decode is told of elsewhere.
    """
    settings = settings or IngestSettings()
    rate_hz = float(np.median([recording.rate_hz for recording in take.recordings] or [1.0]))
    changes = {
        recording.camera: (np.array(recording.frame_times_s), np.array(change))
        for recording, change in zip(take.recordings, take.picture_changes, strict=False)
        if len(change) == len(recording.frame_times_s) and max(change) >= settings.frozen_level
    }
    remedy = "Restart the camera and record again; else cut the take (frames) or leave the camera out of it"
    return [
        InputError(
            f"{freeze.camera} ({take[freeze.camera].path}) is frozen from {freeze.from_s:.2f} to {freeze.until_s:.2f} s:"
            f" {freeze.frames} frames repeat one picture while {freeze.cameras_moving} of {freeze.cameras_compared} other"
            " cameras see motion",
            expected=f"no more than {settings.frozen_min_s:g} s",
            remedy=remedy,
        )
        for freeze in find_freezes(changes, rate_hz, settings, start_s=start_s)
    ]


def _geometry(recording: Recording) -> str:
    turned = f" turned by {recording.rotation_deg} degrees" if recording.rotation_deg else ""
    return f"{recording.width}x{recording.height}{turned}"


def _check_recording(
    camera: str, path: Path | str | None, take: str, needs_sound: bool, settings: IngestSettings
) -> tuple[list[InputError], Recording | None, PictureSurvey | None]:
    """Problems of one file that need no other file; recording and survey are None where it cannot be read at all."""
    if path is None or not Path(path).is_file():
        remedy = "Correct the path, or list the camera as absent from this take"
        found = f"{camera} has no recording in {take} ({path or 'no file given'})"
        return [InputError(found, expected="one file per camera", remedy=remedy)], None, None
    try:
        recording = replace(probe(path, camera), camera=camera)
        survey = survey_pictures(recording)
    except InputError as error:
        return [InputError(f"{camera} of {take}: {error.found}", expected=error.expected, remedy=error.remedy)], None, None
    problems = picture_problems(recording, survey, settings)
    if needs_sound:
        problems += _sound_problems(recording, settings)
    return problems, recording, survey


def _sound_problems(recording: Recording, settings: IngestSettings) -> list[InputError]:
    name = f"{recording.camera} ({recording.path})"
    remedy = "Switch on the camera's microphone, or give this take's offsets by hand"
    if recording.audio_rate_hz is None:
        return [InputError(f"{name} has no sound", expected="sound, for the clap", remedy=remedy)]
    try:
        samples, rate, _ = read_audio(recording.path, None)
    except InputError as error:
        return [InputError(f"{recording.camera}: {error.found}", expected=error.expected, remedy=error.remedy)]
    peak = float(np.abs(samples[: round(settings.sound_checked_s * rate)]).max())
    if peak >= settings.silence_level:
        return []
    expected = f"more than {settings.silence_level:g}, for the clap"
    return [InputError(f"{name} is silent: the loudest sample is {peak:.1g} of full scale", expected=expected, remedy=remedy)]


def _rate_problems(recording: Recording, rate_hz: float, settings: IngestSettings) -> list[InputError]:
    if abs(recording.rate_hz / rate_hz - 1) <= settings.rate_tolerance:
        return []
    found = f"{recording.camera} ({recording.path}) runs at {recording.rate_hz:.3f} frames per second"
    remedy = "Set the camera's rate, or the session's `rate_hz` if all cameras ran so"
    return [InputError(found, expected=f"{rate_hz:g} as the session says", remedy=remedy)]


def _length_problems(recording: Recording, min_duration_s: float | None, min_frames: int | None) -> list[InputError]:
    name, problems = f"{recording.camera} ({recording.path})", []
    remedy = "Record it again, or ask for fewer frames in the session file"
    frames = len(recording.frame_times_s)
    # half a frame of grace: the last frame's duration is not written in every file
    if min_duration_s is not None and recording.duration_s < min_duration_s - 0.5 / recording.rate_hz:
        found = f"{name} lasts {recording.duration_s:.2f} s"
        problems.append(InputError(found, expected=f"at least {min_duration_s:.2f} s", remedy=remedy))
    if min_frames is not None and frames < min_frames:
        problems.append(InputError(f"{name} has {frames} frames", expected=f"at least {min_frames}", remedy=remedy))
    return problems


def _gap_problems(recording: Recording, settings: IngestSettings) -> list[InputError]:
    """Missing frames in a row are one error, of the longest gap; shorter ones are bridged by later stages."""
    longest = max(timing(recording).gaps, key=lambda gap: gap.missing_frames, default=None)
    if longest is None or longest.missing_frames / recording.rate_hz <= settings.gap_max_s:
        return []
    until_s = recording.frame_times_s[longest.after_frame + 1]
    found = (
        f"{recording.camera} ({recording.path}) has no pictures from {longest.time_s:.2f} to {until_s:.2f} s:"
        f" {longest.missing_frames} frames in a row are missing"
    )
    remedy = "Copy the file again; if the camera itself lost them, cut the take (frames) or leave the camera out of it"
    return [InputError(found, expected=f"gaps of at most {settings.gap_max_s:g} s", remedy=remedy)]


def _copies(digests: dict[str, str], take: str) -> list[InputError]:
    """Cameras whose pictures are the same as an earlier camera's."""
    seen: dict[str, str] = {}
    problems = []
    for camera, digest in digests.items():
        original = seen.setdefault(digest, camera)
        if original != camera:
            found = f"{camera} of {take} shows the same pictures as {original}"
            remedy = "One of the two was given the other's file: correct the session file"
            problems.append(InputError(found, expected="a recording of its own for each camera", remedy=remedy))
    return problems
