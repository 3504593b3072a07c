from dataclasses import replace

import numpy as np
import pytest

from headcap.recordings import TakeFrames, VideoFrames, probe
from headcap.recordings.between import motion

RATE = 50


@pytest.fixture
def shifted(write_video):
    """Two cameras see a smooth pattern that moves by `path(t)` pixels; the second one starts 0.3 frames later."""

    def make(path, count: int = 12, dropped: tuple[int, ...] = (), *, decoded: bool = False):
        recordings, times, pictures = [], {}, {}
        for camera, start_s in (("cam0", 0.0), ("cam1", 0.3 / RATE)):
            numbers = [k for k in range(count) if k not in dropped]
            frames = [picture(path(start_s * RATE + k)) for k in numbers]
            recordings.append(probe(write_video(camera, frames, numbers=numbers)))
            times[camera] = start_s + np.array(recordings[-1].frame_times_s)
            pictures[camera] = frames
        made = TakeFrames(recordings, times)
        if not decoded:
            # the codec's own error (3 grey values) would hide what is measured
            made.frame = lambda camera, number: pictures[camera][number]
        return made

    return make


def picture(shift: float, height: int = 160, width: int = 192) -> np.ndarray:
    """Waves of 9 to 40 pixels moved to the right by `shift` pixels, exact at any fraction of a pixel."""
    y, x = np.mgrid[:height, :width].astype(float)
    x = x - shift
    waves = 40 * np.sin(x / 3.1 + y / 5) + 35 * np.sin(x / 6.5 - y / 4.3) + 25 * np.cos(y / 2.9 + x / 9)
    return np.repeat(np.clip(waves + 128, 0, 255)[..., None], 3, axis=2).astype(np.uint8)


def _error(image: np.ndarray, truth: np.ndarray) -> float:
    """Mean grey error away from the border, where new content enters."""
    return float(np.abs(image[16:-16, 16:-16].astype(float) - truth[16:-16, 16:-16]).mean())


def test_the_timeline_is_that_of_the_camera_that_starts_last(shifted) -> None:
    with shifted(lambda t: 0.0) as frames:
        timeline = frames.timeline()
        assert timeline.reference_camera == "cam1"
        np.testing.assert_allclose(timeline.time_s, (0.3 + np.arange(12)) / RATE, atol=1e-6)
        # the other camera has stopped before the last moment
        assert [frames.covers("cam0", t) for t in timeline.time_s] == [True] * 11 + [False]
        assert list(frames.images_at(timeline.time_s[-1])) == ["cam1"]


def test_a_moment_on_a_frame_gives_that_frame_untouched(shifted) -> None:
    with shifted(lambda t: 2.0 * t, decoded=True) as frames:
        np.testing.assert_array_equal(frames.at("cam0", 5.01 / RATE), frames.frame("cam0", 5))
        image, time_s = frames.nearest("cam0", 5.4 / RATE)
        assert time_s == pytest.approx(5 / RATE, abs=1e-6)
        np.testing.assert_array_equal(image, frames.frame("cam0", 5))


@pytest.mark.parametrize("fraction", [0.3, 0.5, 0.8])
def test_even_motion_is_brought_to_the_moment(shifted, fraction) -> None:
    with shifted(lambda t: 2.5 * t) as frames:
        truth = picture(2.5 * (5 + fraction))
        ours, nearest = frames.at("cam0", (5 + fraction) / RATE), frames.nearest("cam0", (5 + fraction) / RATE)[0]
        # the pattern's mean slope is 13 grey values per pixel: 0.1 px of flow error make 1.3, and half of that is left when
        # two frames are blended; the nearest frame is 0.5 px off or more
        assert _error(ours, truth) < 1.0
        assert _error(nearest, truth) > 6 * _error(ours, truth)


def test_motion_that_speeds_up_within_a_frame_is_followed(shifted) -> None:
    # 1.2 pixels per frame^2: straight motion would miss the middle by 1.2 / 8 = 0.15 px
    with shifted(lambda t: 0.6 * (t - 2) ** 2, count=8) as frames:
        truth = picture(0.6 * 2.5**2)
        bent = frames.at("cam0", 4.5 / RATE)
        frames._memory.clear()
        frames._motion = lambda camera, number, ahead: _straight(frames, camera, number, ahead)
        straight = frames.at("cam0", 4.5 / RATE)
        assert _error(bent, truth) < 0.7 * _error(straight, truth)


def _straight(frames: TakeFrames, camera: str, number: int, ahead: int):
    return motion(frames._flow(camera, number, ahead), None)


def test_what_stands_still_is_not_touched(shifted) -> None:
    with shifted(lambda t: 0.0) as frames:
        assert any(np.array_equal(frames.at("cam0", 5.5 / RATE), frames.frame("cam0", k)) for k in (5, 6))


def test_a_gap_of_dropped_frames(shifted) -> None:
    with shifted(lambda t: 1.0 * t, dropped=(5,)) as frames:
        # one missing frame is bridged: between frames 4 and 6 the pattern stands at 5
        assert frames.covers("cam0", 5 / RATE)
        assert _error(frames.at("cam0", 5 / RATE), picture(5.0)) < 1.0
    with shifted(lambda t: 1.0 * t, dropped=(4, 5, 6, 7)) as frames:
        assert not frames.covers("cam0", 5.5 / RATE)
        assert frames.covers("cam0", 3 / RATE)
        with pytest.raises(ValueError, match=r"cam0 has no picture at 0.1100 s"):
            frames.at("cam0", 5.5 / RATE)


def test_times_must_fit_the_recordings(shifted) -> None:
    with shifted(lambda t: 0.0) as frames:
        recordings = [frames._recordings["cam0"]]
        with pytest.raises(ValueError, match="rising common times"):
            TakeFrames(recordings, {"cam0": np.arange(5.0)})


@pytest.mark.real
def test_a_skipped_frame_of_a_real_head_is_made_again(test_data) -> None:
    recording = probe(test_data / "ict_rig" / "takes" / "expression_01" / "cam07.mp4")
    times = np.array(recording.frame_times_s)
    kept = [k for k in range(31, 50, 2)]
    thinned = replace(recording, rate_hz=recording.rate_hz / 2, frame_times_s=tuple(times[kept]))
    with VideoFrames(recording.path, cached=8) as video, TakeFrames([thinned], {"cam07": times[kept]}) as frames:
        frames.frame = lambda camera, number: video[kept[number]]
        truth, before = video[40].astype(float), video[39].astype(float)
        moving = np.abs(before - video[41]).max(axis=2) > 6
        ours = np.abs(frames.at("cam07", times[40]) - truth)[moving].mean()
        nearest = np.abs(before - truth)[moving].mean()
    # twice the interval that is ever bridged in use, so flow is at its worst
    assert ours < 0.5 * nearest
