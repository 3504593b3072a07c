"""`headcap lip-labels`: contours drawn by hand, begun, shown over their frames, and learnt from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import digest_settings, write_manifest
from headcap.calibration.result import load_camera
from headcap.errors import InputError
from headcap.lips.clips import Clip, video_clip
from headcap.lips.contours import (
    ContourSequence,
    adapt_detector,
    agreement,
    held_out_agreement,
    label_faults,
    label_files,
    label_picture,
    label_sheet,
    labelled_examples,
    load_labels,
    save_labelme,
    save_labels,
    starting_labels,
)
from headcap.lips.features import LipContours
from headcap.lips.kit import LipKit
from headcap.lips.mesh_contours import MeshContours
from headcap.lips.monocular import MonocularTrack
from headcap.recordings.video import VideoFrames
from headcap.recordings.writer import write_picture


def show_labels(video: Path, labels: Path, folder: Path) -> list[str]:
    """Draw labels over their frames, `frame_000012.png` each and `labels.png` of all; returns lines of what is wrong with them.

    Raises `InputError` as `load_labels`, for a video that cannot be read, and where no label is of one of its frames.
    """
    drawn = load_labels(labels)
    with VideoFrames(video) as frames:
        size, count = frames[0].shape[1::-1], len(frames)
        told = label_faults(drawn, count, size)
        tiles = {k: label_picture(frames[k], found, f"frame {k}") for k, found in sorted(drawn.items()) if 0 <= k < count}
    if not tiles:
        raise InputError(
            f"{labels} with labels of {len(drawn)} frames, none of them of {video.name}",
            expected=f"frame numbers from 0 to {count - 1}",
            remedy="Give the labels of this video.",
        )
    folder.mkdir(parents=True, exist_ok=True)
    for frame, tile in tiles.items():
        write_picture(folder / f"frame_{frame:06d}.png", tile)
    write_picture(folder / "labels.png", label_sheet(list(tiles.values())))
    return [*told, f"{len(tiles)} labelled frames, {_wrong(told)}"]


@dataclass(frozen=True)
class LabelRequest:
    """A video that `headcap lips` has followed."""

    video: Path
    kit: Path
    tracked: Path
    """Folder that it wrote: track.npz, camera.json, and contours.npz where any were found."""


@dataclass(frozen=True, eq=False)
class _Followed:
    """What those files hold."""

    kit: LipKit
    clip: Clip
    track: MonocularTrack
    contours: list[LipContours | None]

    @classmethod
    def of(cls, request: LabelRequest) -> _Followed:
        """Raises `InputError` for a folder that is not of this video and kit, and `ArtifactError`."""
        kit, folder = LipKit.load(request.kit), request.tracked
        clip = video_clip(request.video, load_camera(folder / "camera.json"))
        track = MonocularTrack.load(folder / "track.npz")
        track.check(kit.head)
        if len(track) != len(clip):
            raise InputError(
                f"{folder} holds a track of {len(track)} frames, {request.video.name} has {len(clip)}",
                expected="what `headcap lips` wrote of this video",
                remedy="Run it for this video, and name its folder.",
            )
        found = folder / "contours.npz"
        return cls(kit, clip, track, ContourSequence.load(found).contours() if found.exists() else [None] * len(track))

    def told(self, frame: int, mesh: NDArray) -> LipContours:
        """Contours that were found in a frame, else those that the base track's mesh (n, 3) would show."""
        head, found = self.kit.head, self.contours[frame]
        see = MeshContours.of(np.asarray(head.vertices, float), self.kit.space.mouth, head.regions)
        return starting_labels(found or see(np.asarray(mesh, float), self.clip.camera))


def begin_labels(request: LabelRequest, target: Path, frames: Sequence[int] | None = None, count: int = 6) -> list[str]:
    """Write contours for a person to correct: a .json of all frames, or a folder of pictures that labelme opens and saves.

    They begin at what the detector found, or at what the base track shows where it found nothing; in `frames`, or in `count` of
    those that were followed, evenly spread. Returns lines that say which. Raises `InputError` for frames that the video does
    not have, where none of the frames was followed, and for a folder that was not made from this video.
    """
    followed = _Followed.of(request)
    wanted = _chosen(followed.track, frames, count)
    meshes = {k: mesh for k, mesh in enumerate(followed.track.meshes(followed.kit.head)) if k in wanted}
    known = [k for k in wanted if np.isfinite(meshes[k]).all()]
    if not known:
        raise InputError(
            f"the face was followed in none of frames {', '.join(map(str, wanted))}",
            expected="one of them at least",
            remedy="Name frames in which the base track shows the face, see track.png.",
        )
    labels = {k: followed.told(k, meshes[k]) for k in known}
    if target.suffix == ".json":
        target.absolute().parent.mkdir(parents=True, exist_ok=True)
        save_labels(target, labels)
    else:
        with VideoFrames(request.video) as opened:
            save_labelme(target, labels, {k: opened[k] for k in known})
    guessed = [k for k in known if followed.contours[k] is None]
    lines = [f"{len(known)} frames to correct: {', '.join(map(str, known))}"]
    lines += [f"where the base track has the lips, no contours being found: {', '.join(map(str, guessed))}"] if guessed else []
    left = [k for k in wanted if k not in known]
    return lines + ([f"left out, the face being lost there: {', '.join(map(str, left))}"] if left else [])


def adapt_kit(request: LabelRequest, labels: Path, target: Path) -> list[str]:
    """A kit whose contour detector has learnt from labelled frames of a video, for this person and light (section 3.2.2).

    Returns lines that say what is wrong with the labels, and how contours lie beside them before and after, each half of
    the frames by what the other half teaches. Raises `InputError` as `load_labels`, for labels of frames that the video lacks,
    where the face was lost in all of them, and for a folder that was not made from this video.
    """
    followed, drawn = _Followed.of(request), load_labels(labels)
    clip, kit = followed.clip, followed.kit
    finder = kit.finder
    meshes = followed.track.meshes(kit.head)
    examples = labelled_examples(request.video.stem, clip.pictures(), drawn, meshes, clip.camera, finder.locator)
    adapted = replace(kit, detector=adapt_detector(kit.detector, examples))
    before, after = agreement(finder, examples), held_out_agreement(finder, examples)
    figures = {"lip_labels.found_before": float(before.found.mean())}
    figures |= {} if after is None else {"lip_labels.found_after": float(after.found.mean())}
    target.absolute().parent.mkdir(parents=True, exist_ok=True)
    adapted.save(target)
    tracked = [request.tracked / name for name in ("track.npz", "camera.json")]
    write_manifest(
        target,
        kind="lip_kit",
        stage="lip_labels",
        settings_digest=digest_settings(),
        inputs=[request.video, request.kit, *tracked, *label_files(labels)],
        figures=figures,
    )
    faults = label_faults(drawn, len(clip), clip.camera.size)
    lines = [*faults, f"{len(examples)} of {len(drawn)} labelled frames learnt from, {_wrong(faults)}", f"before: {before}"]
    return [*lines, f"after, in frames left out of it: {after}"] if after else lines


def _chosen(track: MonocularTrack, frames: Sequence[int] | None, count: int) -> list[int]:
    """Frames to label, in order."""
    if frames is None:
        known = np.flatnonzero(track.answered)
        return np.unique(known[np.linspace(0, len(known) - 1, min(count, len(known))).round().astype(int)]).tolist()
    beyond = [k for k in frames if not 0 <= k < len(track)]
    if beyond:
        raise InputError(
            f"frame {beyond[0]} of a video of {len(track)}", expected=f"0 to {len(track) - 1}", remedy="Name frames that it has."
        )
    return sorted(set(frames))


def _wrong(faults: Sequence[str]) -> str:
    return "nothing wrong with them" if not faults else "1 thing wrong" if len(faults) == 1 else f"{len(faults)} things wrong"
