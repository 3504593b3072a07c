from pathlib import Path

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.recordings.probe import Recording
from headcap.recordings.takes import IngestedTake
from headcap.sync.offsets import TimeOffsets
from headcap.sync.timeline import TakeTimeline, make_timeline

RATE = 50.0


def take_of(start_s: dict[str, float], frames: int = 10) -> tuple[IngestedTake, TimeOffsets]:
    """Recordings of equal length that start at given common times."""
    times = tuple(k / RATE for k in range(frames))
    recordings = tuple(Recording(camera, Path(f"{camera}.mp4"), 64, 96, RATE, times, 0, 48000) for camera in start_s)
    n = len(start_s)
    offsets = TimeOffsets("pose_01", tuple(start_s), tuple(start_s.values()), (0.0,) * n, (1.0,) * n, ("clap",) * n)
    return IngestedTake("pose_01", "pose", recordings), offsets


def test_frames_are_those_of_the_camera_that_starts_last() -> None:
    timeline = make_timeline(*take_of({"a": 0.0, "b": 0.031, "c": 0.012}))
    assert timeline.reference_camera == "b"
    np.testing.assert_allclose(timeline.time_s, 0.031 + timeline.frames / RATE)


def test_the_take_ends_where_too_few_cameras_have_a_picture_near() -> None:
    # b starts 31 ms late: its last frame is at 0.211 s, the last of a and c at 0.180 and 0.192 s. A frame counts where three
    # cameras have a picture within 20 ms: frame 8, at 0.191 s, has a's 11 ms away; frame 9 is 31 ms after a's last one
    timeline = make_timeline(*take_of({"a": 0.0, "b": 0.031, "c": 0.012}))
    assert timeline.frames.tolist() == list(range(9))
    assert len(make_timeline(*take_of({"a": 0.0, "b": 0.031, "c": 0.012}), min_cameras=2)) == 10


def test_frames_asked_for_are_given_or_refused() -> None:
    take, offsets = take_of({"a": 0.0, "b": 0.031, "c": 0.012})
    assert make_timeline(take, offsets, frames=(2, 5)).frames.tolist() == [2, 3, 4, 5]
    with pytest.raises(InputError, match="frames 2 to 9 asked for, but only 9 were photographed by 3 cameras"):
        make_timeline(take, offsets, frames=(2, 9))


def test_parts_and_spans_cover_the_take_once(tmp_path: Path) -> None:
    timeline = make_timeline(*take_of({"a": 0.0, "b": 0.0, "c": 0.0}))
    parts = [timeline.part(first, 4) for first in (0, 4, 8)]
    assert np.concatenate([part.frames for part in parts]).tolist() == timeline.frames.tolist()
    assert [timeline.span(first, 4) for first in (0, 4, 8)] == [(0, 3), (4, 7), (8, 9)]
    timeline.save(tmp_path / "timeline.json")
    loaded = TakeTimeline.load(tmp_path / "timeline.json")
    assert loaded.reference_camera == timeline.reference_camera
    np.testing.assert_array_equal(loaded.time_s, timeline.time_s)
