"""Frames are the same ones by number and by time in every container, however it is sought."""

from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from headcap.recordings import VideoFrames, probe

RATE, COUNT = 25, 60
HOPS = (0, 1, 2, 40, COUNT - 1, 3, 30, 29, 28, 13, 12, 11, 50, 51, 0)


def _numbered(number: int) -> np.ndarray:
    """A picture that carries its number as eight black and white stripes of 16 pixels, and looks different all over."""
    bits = np.repeat([(number >> bit) & 1 for bit in range(8)], 16) * 180 + 40
    return np.ascontiguousarray(np.broadcast_to(bits[None, :, None], (96, 128, 3)), np.uint8)


def _number(image: np.ndarray) -> int:
    return sum(1 << bit for bit in range(8) if image[40, 16 * bit + 8].mean() > 130)


def _write(path: Path, codec: str, *, bframes: int = 0, sound: str | None = None, pts: list[int] | None = None) -> Path:
    """`COUNT` frames at `pts` of 1/90000 s, by default `RATE` a second, a key frame each twelve, noise beside them as sound."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=RATE)
        stream.width, stream.height, stream.pix_fmt, stream.gop_size = 128, 96, "yuv420p", 12
        stream.bit_rate, stream.max_b_frames = 4_000_000, bframes
        voice = container.add_stream(sound, rate=44100, layout="mono") if sound else None
        if pts is not None:
            stream.time_base = stream.codec_context.time_base = Fraction(1, 90000)
        for k in range(COUNT):
            frame = av.VideoFrame.from_ndarray(_numbered(k), format="bgr24")
            frame.pts, frame.time_base = (pts[k], Fraction(1, 90000)) if pts is not None else (k, Fraction(1, RATE))
            container.mux(stream.encode(frame))
            if voice:
                _add_sound(container, voice, k)
        for each in (stream, voice):
            if each:
                container.mux(each.encode(None))
    return path


def _add_sound(container, voice, k: int) -> None:
    each = 44100 // RATE
    samples = np.random.default_rng(k).normal(0, 3000, (1, each)).astype(np.int16)
    block = av.AudioFrame.from_ndarray(samples, format="s16", layout="mono")
    block.sample_rate, block.pts, block.time_base = 44100, k * each, Fraction(1, 44100)
    container.mux(voice.encode(block))


@pytest.mark.parametrize(
    ("name", "written"),
    [
        ("program_stream.mpg", {"codec": "mpeg1video", "sound": "mp2"}),
        ("program_stream_with_b.mpg", {"codec": "mpeg1video", "bframes": 2, "sound": "mp2"}),
        ("transport_stream.ts", {"codec": "mpeg2video", "bframes": 2, "sound": "mp2"}),
        ("camcorder.mts", {"codec": "libx264", "bframes": 2}),
        ("open.mkv", {"codec": "libx264", "bframes": 2}),
        ("old.avi", {"codec": "mpeg4"}),
    ],
)
def test_frames_are_found_in_any_order(tmp_path: Path, name: str, written: dict) -> None:
    path = _write(tmp_path / name, **written)
    recording = probe(path)
    assert len(recording.frame_times_s) == COUNT
    np.testing.assert_allclose(np.diff(recording.frame_times_s), 1 / RATE, atol=1e-3)
    with VideoFrames(path, cached=1) as video:
        assert [_number(video[k]) for k in HOPS] == list(HOPS)
        assert [_number(image) for image in video] == list(range(COUNT))
        at_s = [recording.frame_times_s[k] + 0.3 / RATE for k in HOPS]
        assert [_number(video.at(t)) for t in at_s] == list(HOPS)


def test_reading_forward_decodes_each_frame_once(tmp_path: Path, monkeypatch) -> None:
    path = _write(tmp_path / "program_stream.mpg", "mpeg1video", sound="mp2")
    with VideoFrames(path, cached=1) as video:
        decoded, inner = [], video._decoder
        video._decoder = (decoded.append(frame.pts) or frame for frame in inner)
        monkeypatch.setattr(video, "_lands_on_key", lambda pts: pytest.fail("a seek"))
        assert [_number(image) for image in video] == list(range(COUNT))
        assert len(decoded) == len(set(decoded)) == COUNT


def test_a_variable_rate_shows_each_picture_at_its_own_time(tmp_path: Path) -> None:
    steps = np.tile([3000, 1500, 6000, 3000, 4500], COUNT // 5)
    pts = np.concatenate([[0], np.cumsum(steps)])[:COUNT].tolist()
    path = _write(tmp_path / "telephone.mp4", "libx264", bframes=2, pts=pts)
    with VideoFrames(path) as video:
        # the container rounds times to its own ticks
        np.testing.assert_allclose(video.times_s, np.array(pts) / 90000, atol=1e-4)
        assert [_number(image) for image in video] == list(range(COUNT))
        assert [_number(video.at(pts[k] / 90000 + 0.005)) for k in HOPS] == list(HOPS)


@pytest.mark.parametrize("turned_deg", [0, 90, 180, 270])
def test_pictures_stand_upright_whatever_way_the_telephone_was_held(
    tmp_path: Path, turned_deg: int, with_display_rotation: Callable[[bytes, int], bytes]
) -> None:
    path = _write(tmp_path / "held.mp4", "libx264")
    path.write_bytes(with_display_rotation(path.read_bytes(), turned_deg))
    recording = probe(path)
    assert recording.rotation_deg == turned_deg
    with VideoFrames(path) as video:
        shown = video[37]
        assert shown.shape == (recording.height, recording.width, 3)
        assert _number(np.rot90(shown, -turned_deg // 90)) == 37


@pytest.mark.real
def test_old_clips_of_talking_faces_are_read(test_data: Path) -> None:
    path = test_data / "talking_faces" / "bbaf2n.mpg"
    with av.open(str(path)) as container:
        expected = [frame.to_ndarray(format="bgr24") for frame in container.decode(video=0)]
    with VideoFrames(path, cached=1) as video:
        assert len(video) == len(expected) == 75
        np.testing.assert_allclose(video.times_s, np.arange(75) / 25, atol=1e-9)
        for number in (0, 74, 1, 13, 12, 11, 40, 39):
            assert np.array_equal(video[number], expected[number])
