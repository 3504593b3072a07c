"""What is written is read again: pictures, their moments with gaps, and the sound."""

import cv2
import numpy as np
import pytest

from headcap.recordings.audio import read_audio
from headcap.recordings.video import VideoFrames
from headcap.recordings.writer import write_picture, write_video


@pytest.fixture
def pictures(rng):
    y, x = np.mgrid[:64, :96]
    waves = [np.sin(0.1 * (k + 1) * x + 0.07 * y + k) for k in range(3)]
    # skin's tint everywhere: colour has half the resolution, and waves of it would not come back
    return [np.rint(np.array([150, 120, 100]) + 80 * wave[..., None]).astype(np.uint8) for wave in waves]


@pytest.mark.parametrize("preset", ["veryfast", "ultrafast"])
def test_frames_come_back_at_their_moments(pictures, tmp_path, preset):
    path = tmp_path / "out.mp4"
    write_video(path, zip((0, 1, 4), pictures, strict=True), (96, 64), 25.0, crf=6, preset=preset)
    with VideoFrames(path) as video:
        np.testing.assert_allclose(video.times_s, [0, 0.04, 0.16], atol=1e-6)
        for k, picture in enumerate(pictures):
            # bytes are rounded three times on the way, and so is the codec's loss at this quality
            assert np.abs(video[k][..., ::-1].astype(float) - picture).mean() < 3


def test_frames_off_the_grid_keep_their_moments(pictures, tmp_path):
    path = tmp_path / "out.mp4"
    write_video(path, zip((3.25, 4.5, 6.0), pictures, strict=True), (96, 64), 25.0)
    with VideoFrames(path) as video:
        np.testing.assert_allclose(video.times_s, [0.13, 0.18, 0.24], atol=1e-6)


def test_sound_is_kept_and_silence_needs_none(pictures, tmp_path, rng):
    sound = (0.3 * np.sin(2 * np.pi * 440 * np.arange(24_000) / 48_000)).astype(np.float32)
    write_video(tmp_path / "heard.mp4", enumerate(pictures), (96, 64), 25.0, sound=sound)
    heard, rate_hz, _ = read_audio(tmp_path / "heard.mp4")
    assert rate_hz == 48_000
    assert np.corrcoef(heard[: len(sound)], sound[: len(heard)])[0, 1] > 0.98


def test_a_failure_leaves_no_file(pictures, tmp_path):
    def frames():
        yield 0, pictures[0]
        raise RuntimeError("camera lost")

    with pytest.raises(RuntimeError, match="camera lost"):
        write_video(tmp_path / "out.mp4", frames(), (96, 64), 25.0)
    assert not list(tmp_path.iterdir())


def test_a_picture_is_written_as_it_is(tmp_path):
    picture = np.random.default_rng(3).integers(0, 256, (7, 5, 3), dtype=np.uint8)
    write_picture(tmp_path / "one.png", picture[:, ::-1])
    assert np.array_equal(cv2.imread(str(tmp_path / "one.png")), picture[:, ::-1])
