"""`headcap lips --base-track`: the lips of a face that another program has tracked."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from headcap.calibration.result import load_camera, save_cameras
from headcap.cameras import Camera, Rig
from headcap.errors import InputError
from headcap.lips.base_files import BaseTrackFiles, load_base_track
from headcap.lips.clips import video_clip
from headcap.lips.foreign_tracks import BaseTrack
from headcap.lips.kit import LipKit
from headcap.workflow.lips import answer_lines, save_corrected, show_corrected

__all__ = ["BaseTrackFiles", "correct_base_track"]


def correct_base_track(
    videos: Sequence[Path], kit_file: Path, files: BaseTrackFiles, camera: Path | None, camera_name: str | None, folder: Path
) -> list[str]:
    """Correct what another tracker made of a video; returns lines of what was answered and what was not.

    Writes what `correct_video` does but the base track and its judgement: `camera.json`, `contours.npz`, `corrected.json` with
    `corrected.npy` and `corrected.template.npz`, `side_by_side.mp4`, `overlay.mp4`. Raises `InputError` for several videos,
    without a camera, where the meshes never show in its pictures, and as `load_base_track`, `video_clip` and `LipKit.correct`.
    """
    if len(videos) != 1 or camera is None:
        raise InputError(
            f"a base track with {len(videos)} videos and {'no' if camera is None else 'a'} camera",
            expected="one video, and --camera, in whose world the track's meshes stand",
            remedy="Write the camera that the other tracker assumed as rig.json; a world of its own is the identity.",
        )
    kit = LipKit.load(kit_file)
    clip = video_clip(videos[0], load_camera(camera, camera_name))
    track = load_base_track(files, kit.head, kit.space.mouth, clip.time_s)
    if not _in_view(kit, track, clip.camera):
        raise InputError(
            f"{files.track.name}: in no frame does the mouth lie in the picture of {clip.camera.name}",
            expected="meshes in metres, in the world of the camera's camera_from_world (x right, y down, z forward)",
            remedy="Turn the track's axes, or the camera's pose; trackers that draw with OpenGL have y up and z backward.",
        )
    folder.mkdir(parents=True, exist_ok=True)
    corrected = kit.correct(clip, track)
    corrected.contours.save(folder / "contours.npz")
    save_cameras(folder / "camera.json", Rig((clip.camera,)))
    save_corrected(folder, clip, kit, corrected, [videos[0], kit_file, camera, *files.given], camera_name)
    show_corrected(folder, clip, corrected, videos[0])
    return answer_lines(track, corrected, "the base track lacks {} frames")


def _in_view(kit: LipKit, track: BaseTrack, camera: Camera) -> bool:
    """Whether any frame's mouth lies in a camera's picture."""
    locate = kit.finder.locator
    return any(locate(np.asarray(mesh, float), camera) is not None for mesh in track.meshes(kit.head))
