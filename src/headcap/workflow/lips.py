"""`headcap lips`: one video in, a face with corrected lips out."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from headcap.artifacts import digest_settings, write_manifest
from headcap.calibration.result import load_camera
from headcap.evaluation.lip_errors import BASE
from headcap.heads.procedural import base_head
from headcap.lips.clips import Clip, video_clip
from headcap.lips.kit import CorrectedClip, LipKit
from headcap.lips.monocular import FrameState, MonocularTrack, load_detections, unknown_camera
from headcap.lips.monocular.stage import track_clip
from headcap.recordings.video import VideoFrames
from headcap.registration.sequence import MeshSequence, save_chunk
from headcap.registration.template import Template
from headcap.report.lips_pictures import write_clip_side_by_side


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


def correct_video(request: LipRequest, folder: Path) -> list[str]:
    """Track, correct and write a video's face to a folder; returns lines of what was answered and what was not.

    Writes `track.npz`, `camera.json`, `track.png`, `contours.npz`, `corrected.json` with `corrected.npy` and
    `corrected.template.npz`, and `side_by_side.mp4`. Raises `InputError` as `video_clip`, `load_detections`, `track_video` and
    `LipKit.correct`.
    """
    kit, clip = LipKit.load(request.kit), _clip(request)
    detections = load_detections(request.detections) if request.detections else None
    folder.mkdir(parents=True, exist_ok=True)
    track_path, camera_path = folder / "track.npz", folder / "camera.json"
    track_clip(kit.head, clip, kit.monocular, track_path, camera_path, folder / "track.png", detections)
    track = MonocularTrack.load(track_path)
    seen = replace(clip, camera=load_camera(camera_path))
    corrected = kit.correct(seen, track)
    corrected.contours.save(folder / "contours.npz")
    _save_meshes(folder, kit, track, corrected, request)
    sequences = {BASE: corrected.take.base.world(corrected.take.base.meshes), "GR": corrected.meshes}
    mouth = corrected.take.space.mouth.vertices
    write_clip_side_by_side(folder / "side_by_side.mp4", seen, kit.head.triangles, sequences, mouth)
    return _told(track, corrected)


def _clip(request: LipRequest) -> Clip:
    if request.camera is not None:
        return video_clip(request.video, load_camera(request.camera, request.camera_name))
    with VideoFrames(request.video) as frames:
        height, width = frames[0].shape[:2]
    return replace(video_clip(request.video, unknown_camera(width, height)), focal_known=False)


def _save_meshes(folder: Path, kit: LipKit, track: MonocularTrack, corrected: CorrectedClip, request: LipRequest) -> None:
    sequence, positions = folder / "corrected.json", folder / "corrected.npy"
    save_chunk(positions, corrected.meshes)
    MeshSequence(request.video.stem, track.time_s, (positions,)).save(sequence)
    _template(kit, corrected).save(folder / "corrected.template.npz")
    given = (request.video, request.kit, request.camera, request.detections)
    write_manifest(
        sequence,
        kind="mesh_sequence",
        stage="lips",
        settings_digest=digest_settings(camera=request.camera_name),
        inputs=[path for path in given if path is not None],
        figures={"lips.answered": float(corrected.answered.mean())},
    )


def _template(kit: LipKit, corrected: CorrectedClip) -> Template:
    """The person's neutral head, as other programs want to know the meshes' topology."""
    head, base = kit.head, base_head()
    neutral = corrected.take.neutral
    if np.array_equal(head.triangles, base.triangles):
        return base.with_vertices(neutral)
    uv = np.zeros((1, 2))
    return Template(neutral, head.triangles, uv, np.zeros_like(head.triangles), dict(head.regions), dict(head.landmarks))


def _told(track: MonocularTrack, corrected: CorrectedClip) -> list[str]:
    frames, lost = len(track), int((~track.answered).sum())
    unseen = int((track.answered & ~corrected.contours.found).sum())
    restarted = sum(state is FrameState.RESTARTED for state in track.states)
    lines = [f"{int(corrected.answered.sum())} of {frames} frames corrected"]
    if lost:
        lines.append(f"the face was lost in {lost} frames and found again {restarted} times; these frames have no answer")
    if unseen:
        lines.append(f"lip contours were not found in {unseen} further frames; these frames have no answer")
    return lines
