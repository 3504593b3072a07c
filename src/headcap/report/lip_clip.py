"""The page of single videos whose lips were corrected: overlay videos, residual, contours, lip gap, frames without an answer."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from headcap.evaluation.lip_clip import LipClip
from headcap.evaluation.lip_clips import clip_figures, closure_totals
from headcap.evaluation.lip_closures import WITHIN_S, ClosureTest
from headcap.evaluation.metrics import Figure
from headcap.recordings.video import VideoFrames
from headcap.report.lip_clip_figures import clip_curves, told_frames
from headcap.report.overlays import jpeg_uri
from headcap.report.page import Shown, drawing, write_page
from headcap.report.provenance import PageFoot


@dataclass(frozen=True)
class ClipFiles:
    """What was written of one clip."""

    clip: Path
    """`LipClip`."""
    overlay: Path
    """mp4."""
    sequence: Path
    """The corrected meshes, with their manifest."""


@dataclass(frozen=True)
class ClosureRow:
    """Lips shut by what was said, for a reader; gaps in mm, ranks as shares."""

    word: str
    sound: str
    time_s: float
    gaps: tuple[float, ...]
    """Least gap near, by method."""
    ranks: tuple[float, ...]
    shown: tuple[bool, ...]


@dataclass(frozen=True, eq=False)
class ClipStory:
    """One clip on the page."""

    clip: LipClip
    figures: Mapping[str, Figure]
    curves: Shown
    video: str
    """Data URI."""
    poster: str
    """Of a frame of it: the first closure, or one half through."""
    lost: str
    found_again: str
    uncorrected: str
    closures: tuple[ClosureRow, ...]


def write_clip_report(files: Sequence[ClipFiles], failures: Mapping[str, str], settings: Mapping, path: Path | str) -> None:
    """Write the page as one HTML file; `failures` says of each video without an answer why there is none."""
    clips = [LipClip.load(each.clip) for each in files]
    sequences = {f"{each.sequence.parent.name}/{each.sequence.name}": each.sequence for each in files}
    inputs = PageFoot.of(clip_figures(clips), sequences, settings)
    write_page(
        path,
        "lip_clip.html.j2",
        inputs,
        stories=[_story(clip, each) for clip, each in zip(clips, files, strict=True)],
        failures=dict(failures),
        totals=closure_totals(clips),
        within_ms=round(1e3 * WITHIN_S),
    )


def _story(clip: LipClip, files: ClipFiles) -> ClipStory:
    return ClipStory(
        clip,
        {figure.name: figure for figure in clip_figures([clip])},
        drawing(clip_curves(clip), "Dots: least gaps within 0.12 s; red: the face was lost; grey: lips not corrected"),
        "data:video/mp4;base64," + base64.b64encode(files.overlay.read_bytes()).decode(),
        _poster(clip, files.overlay),
        told_frames(clip.lost),
        told_frames(clip.found_again),
        told_frames(clip.uncorrected),
        _rows(clip, [clip.closure_test(method) for method in clip.methods]),
    )


def _poster(clip: LipClip, overlay: Path) -> str:
    moment = clip.closures[0].time_s if clip.closures else clip.time_s[len(clip) // 2]
    with VideoFrames(overlay) as frames:
        nearest = int(np.abs(frames.times_s - frames.times_s[0] - (moment - clip.time_s[0])).argmin())
        return jpeg_uri(frames[nearest][..., ::-1])


def _rows(clip: LipClip, tests: Sequence[ClosureTest | None]) -> tuple[ClosureRow, ...]:
    known = [test for test in tests if test is not None]
    return tuple(
        ClosureRow(
            closure.word,
            closure.sound,
            closure.time_s,
            tuple(float(test.least[k]) for test in known),
            tuple(float(test.rank[k]) for test in known),
            tuple(bool(test.shown[k]) for test in known),
        )
        for k, closure in enumerate(clip.closures)
    )
