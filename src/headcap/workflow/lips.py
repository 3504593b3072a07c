"""`headcap lips`: videos in, faces with corrected lips out, and a page that shows them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from headcap.artifacts import digest_settings, write_manifest
from headcap.calibration.result import load_camera
from headcap.errors import InputError, InputErrors
from headcap.evaluation.lip_clip import LipClip, judge_clip
from headcap.evaluation.lip_clips import clip_figures
from headcap.evaluation.lip_errors import BASE
from headcap.evaluation.metrics import save_metrics
from headcap.heads.procedural import base_head
from headcap.lips.clips import Clip, video_clip
from headcap.lips.foreign_tracks import BaseTrack
from headcap.lips.kit import CorrectedClip, LipKit
from headcap.lips.monocular import FrameState, MonocularTrack, load_detections, unknown_camera
from headcap.lips.monocular.detail import detailed_meshes
from headcap.lips.monocular.shading import ShadingSettings
from headcap.lips.monocular.stage import track_clip
from headcap.recordings.video import VideoFrames
from headcap.registration.sequence import MeshSequence, save_chunk
from headcap.registration.template import Template
from headcap.report.lip_clip import ClipFiles, write_clip_report
from headcap.report.lip_clip_video import write_overlay
from headcap.report.lips_pictures import write_clip_side_by_side
from headcap.speech.words import Word, read_words


@dataclass(frozen=True)
class LipRequest:
    """What `headcap lips` was asked for."""

    video: Path
    kit: Path
    camera: Path | None = None
    """rig.json; without one the focal length is estimated."""
    camera_name: str | None = None
    detections: Path | None = None
    """Landmarks of a detector's, for the first frame or all."""
    person: Path | None = None
    """Another base track of the same person, best of a video in which the head turns."""
    detail: bool = False
    """Also write the corrected meshes with fine detail by shading."""
    words: Path | None = None
    """What was said and when, see `read_words`; without one a file beside the video, with .align for its ending, is taken."""


def lip_requests(
    videos: Sequence[Path],
    kit: Path,
    camera: Path | None = None,
    camera_name: str | None = None,
    detections: Path | None = None,
    words: Sequence[Path] = (),
    person: Path | None = None,
    detail: bool = False,
) -> list[LipRequest]:
    """A request for each video; of several each takes the file of words that has its name.

    Raises `InputError` for landmarks with several videos and for words of no video.
    """
    if detections is not None and len(videos) > 1:
        raise InputError(
            f"landmarks for {len(videos)} videos", expected="one video with --detections", remedy="Correct them one by one."
        )
    named = {path.stem: path for path in words}
    unknown = sorted(set(named) - {video.stem for video in videos})
    if (unknown and len(videos) > 1) or len(words) > len(videos):
        raise InputError(
            f"words of {', '.join(unknown) or 'more videos than there are'}",
            expected=f"at most one file each, called as {', '.join(video.stem for video in videos)}",
            remedy="Rename the files of --align.",
        )
    if len(videos) == 1 and words:
        named = {videos[0].stem: words[0]}
    given = (kit, camera, camera_name, detections, person, detail)
    return [LipRequest(video, *given, named.get(video.stem)) for video in videos]


@dataclass(frozen=True)
class LipAnswer:
    """What became of one or several videos."""

    lines: list[str]
    """What was answered and what was not, for a reader."""
    failures: dict[str, str]
    """By video, why there is no answer."""


def correct_videos(requests: Sequence[LipRequest], folder: Path) -> LipAnswer:
    """Correct videos with one kit and write a page, `lips.html`, and its figures, `metrics.json`.

    One video's files go to the folder itself, see `correct_video`; those of several each to a folder in it, by the video's name.
    Of several the others go on where one has no answer. Raises `InputError` as `correct_video` where there is one, and for
    several of one name; `InputErrors` where none has an answer.
    """
    names = [request.video.stem for request in requests]
    if len(set(names)) < len(names):
        raise InputError(
            f"videos called {', '.join(sorted(names))}", expected="names that differ", remedy="Correct these one by one."
        )
    kit = LipKit.load(requests[0].kit)
    if len(requests) == 1:
        lines = correct_video(requests[0], folder, kit)
        _write_page([folder], requests, {}, folder)
        return LipAnswer(lines, {})
    lines, errors = [], {}
    for name, request in zip(names, requests, strict=True):
        try:
            lines += [f"{name}: {line}" for line in correct_video(request, folder / name, kit)]
        except InputError as error:
            errors[name] = error
    answered = [folder / name for name in names if name not in errors]
    if not answered:
        raise InputErrors(list(errors.values()))
    failures = {name: str(error) for name, error in errors.items()}
    _write_page(answered, requests, failures, folder)
    return LipAnswer(lines, failures)


def correct_video(request: LipRequest, folder: Path, kit: LipKit | None = None) -> list[str]:
    """Track, correct and write a video's face to a folder; returns lines of what was answered and what was not.

    Writes `track.npz`, `camera.json`, `track.png`, `contours.npz`, `corrected.json` with `corrected.npy` and
    `corrected.template.npz`, `side_by_side.mp4`, `overlay.mp4` and `clip.npz`, and where asked for `detailed.json`. Raises
    `InputError` as `video_clip`, `load_detections`, `read_words`, `track_video` and `LipKit.correct`.
    """
    kit, clip, words = kit or LipKit.load(request.kit), _clip(request), _words(request)
    detections = load_detections(request.detections) if request.detections else None
    folder.mkdir(parents=True, exist_ok=True)
    track_path, camera_path = folder / "track.npz", folder / "camera.json"
    person = MonocularTrack.load(request.person).person if request.person else None
    track_clip(kit.head, clip, kit.monocular, track_path, camera_path, folder / "track.png", detections, person)
    track = MonocularTrack.load(track_path)
    seen = replace(clip, camera=load_camera(camera_path))
    corrected = kit.correct(seen, track)
    corrected.contours.save(folder / "contours.npz")
    given = (request.video, request.kit, request.camera, request.detections, request.person, request.words)
    save_corrected(folder, clip, kit, corrected, [path for path in given if path is not None], request.camera_name)
    if request.detail:
        _save_detail(folder, seen, kit, track, corrected)
    show_corrected(folder, seen, corrected, request.video)
    judge_clip(request.video.stem, kit.head, track, corrected, words).save(folder / "clip.npz")
    restarted = sum(state is FrameState.RESTARTED for state in track.states)
    return answer_lines(track, corrected, f"the face was lost in {{}} frames and found again {restarted} times")


def _save_detail(folder: Path, seen: Clip, kit: LipKit, track: MonocularTrack, corrected: CorrectedClip) -> None:
    """Write `detailed.json` with `detailed.npy`, in the topology of the corrected meshes."""
    positions = folder / "detailed.npy"
    save_chunk(
        positions, np.stack([mesh.astype(np.float32) for mesh in detailed_meshes(kit.head, seen, track, corrected.meshes)])
    )
    MeshSequence(f"{folder.name}_detailed", seen.time_s, (positions,)).save(folder / "detailed.json")
    write_manifest(
        folder / "detailed.json",
        kind="mesh_sequence",
        stage="lips",
        settings_digest=digest_settings(shading=ShadingSettings()),
        inputs=[folder / "corrected.json", folder / "track.npz"],
        figures={},
    )


def _write_page(folders: Sequence[Path], requests: Sequence[LipRequest], failures: dict[str, str], folder: Path) -> None:
    files = [ClipFiles(each / "clip.npz", each / "overlay.mp4", each / "corrected.json") for each in folders]
    save_metrics(folder / "metrics.json", clip_figures([LipClip.load(each.clip) for each in files]))
    settings = {"videos": [str(request.video) for request in requests], "regressor": str(requests[0].kit)}
    write_clip_report(files, failures, settings, folder / "lips.html")


def _words(request: LipRequest) -> tuple[Word, ...]:
    beside = request.video.with_suffix(".align")
    path = request.words or (beside if beside.exists() else None)
    return read_words(path) if path else ()


def _clip(request: LipRequest) -> Clip:
    if request.camera is not None:
        return video_clip(request.video, load_camera(request.camera, request.camera_name))
    with VideoFrames(request.video) as frames:
        height, width = frames[0].shape[:2]
    return replace(video_clip(request.video, unknown_camera(width, height)), focal_known=False)


def save_corrected(
    folder: Path, clip: Clip, kit: LipKit, corrected: CorrectedClip, inputs: Sequence[Path], camera_name: str | None = None
) -> None:
    """Write corrected meshes, `corrected.json`, `.npy` and `.template.npz`; the take is called as the first of the inputs."""
    sequence, positions = folder / "corrected.json", folder / "corrected.npy"
    save_chunk(positions, corrected.meshes)
    MeshSequence(inputs[0].stem, clip.time_s, (positions,)).save(sequence)
    _template(kit, corrected).save(folder / "corrected.template.npz")
    write_manifest(
        sequence,
        kind="mesh_sequence",
        stage="lips",
        settings_digest=digest_settings(camera=camera_name),
        inputs=list(inputs),
        figures={"lips.answered": float(corrected.answered.mean())},
    )


def show_corrected(folder: Path, clip: Clip, corrected: CorrectedClip, video: Path) -> None:
    """Write `side_by_side.mp4`, base track beside correction, and `overlay.mp4`, the correction over the video with its sound."""
    take = corrected.take
    sequences = {BASE: take.base.world(take.base.meshes), "GR": corrected.meshes}
    write_clip_side_by_side(folder / "side_by_side.mp4", clip, take.space.model.triangles, sequences, take.space.mouth.vertices)
    write_overlay(folder / "overlay.mp4", clip, corrected, video)


def answer_lines(track: BaseTrack, corrected: CorrectedClip, lost: str) -> list[str]:
    """Lines of how many frames have an answer and why others have none; `lost` says so of a number {} the base track lacks."""
    lacking, unseen = int((~track.answered).sum()), int((track.answered & ~corrected.contours.found).sum())
    lines = [f"{int(corrected.answered.sum())} of {len(corrected.answered)} frames corrected"]
    if lacking:
        lines.append(f"{lost.format(lacking)}; these frames have no answer")
    if unseen:
        lines.append(f"lip contours were not found in {unseen} further frames; these frames have no answer")
    return lines


def _template(kit: LipKit, corrected: CorrectedClip) -> Template:
    """The person's neutral head, as other programs want to know the meshes' topology."""
    head, base = kit.head, base_head()
    neutral = corrected.take.neutral
    if np.array_equal(head.triangles, base.triangles):
        return base.with_vertices(neutral)
    uv = np.zeros((1, 2))
    return Template(neutral, head.triangles, uv, np.zeros_like(head.triangles), dict(head.regions), dict(head.landmarks))
