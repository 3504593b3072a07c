import av
import cv2
import numpy as np
import pytest

from headcap.errors import InputError
from headcap.recordings import VideoFrames, probe
from headcap.recordings.audio import read_audio
from headcap.recordings.probe import grid_rate_hz
from headcap.recordings.timing import timing


def _frames(count: int) -> list[np.ndarray]:
    """Frames that carry their own number as eight black and white stripes of 8 pixels."""
    bits = [[(k >> bit) & 1 for bit in range(8)] for k in range(count)]
    return [np.ascontiguousarray(np.broadcast_to(np.repeat(b, 8)[None, :, None] * 200 + 30, (96, 64, 3)), np.uint8) for b in bits]


def _number(image: np.ndarray) -> int:
    return sum(1 << bit for bit in range(8) if image[40, 8 * bit + 4].mean() > 130)


def test_times_are_presentation_times_of_the_grid(write_video) -> None:
    recording = probe(write_video("cam07", _frames(20), rate=50))
    assert recording.camera == "cam07"
    assert (recording.width, recording.height, recording.rotation_deg) == (64, 96, 0)
    assert recording.audio_rate_hz is None
    # times are multiples of 1/12800 s, so a grid of 50 Hz is exact
    np.testing.assert_allclose(recording.frame_times_s, np.arange(20) / 50, atol=1e-9)
    assert recording.rate_hz == pytest.approx(50, abs=1e-6)
    assert recording.duration_s == pytest.approx(0.4, abs=1e-6)


def test_dropped_frames_are_found_and_do_not_shift_the_others(write_video) -> None:
    numbers = [k for k in range(30) if k not in (7, 8, 19)]
    path = write_video("drops", [_frames(30)[k] for k in numbers], numbers=numbers)
    recording = probe(path)
    np.testing.assert_allclose(recording.frame_times_s, np.array(numbers) / 50, atol=1e-9)
    assert recording.rate_hz == pytest.approx(50, abs=1e-6)
    found = timing(recording)
    assert [(gap.after_frame, gap.missing_frames) for gap in found.gaps] == [(6, 2), (16, 1)]
    assert found.missing_frames == 3
    assert not found.variable_rate
    with VideoFrames(path) as video:
        assert _number(video.at(9 / 50)) == 9
        assert _number(video[7]) == 9


def test_a_variable_rate_is_found_and_carried(write_video) -> None:
    numbers = np.cumsum([0] + [1.0, 1.4, 0.7, 1.3, 1.0, 0.6] * 4)
    recording = probe(write_video("variable", _frames(25), numbers=numbers))
    # written times are rounded to 1/12800 s
    np.testing.assert_allclose(recording.frame_times_s, numbers / 50, atol=1 / 12800)
    assert timing(recording).variable_rate
    assert timing(recording).gaps == ()


def test_rate_is_refined_beyond_the_containers_time_base() -> None:
    # 59.94 Hz written in milliseconds: intervals are 16 or 17 ms, their median is off by 2 %
    times = np.round(np.arange(300) / 59.94, 3)
    # a slope over 300 frames rounded to 1 ms (0.3 ms rms) is good to 0.3 ms / (5 s * sqrt(300 / 12)) < 2e-5
    assert grid_rate_hz(times) == pytest.approx(59.94, rel=1e-4)


def test_frames_are_read_in_any_order(write_video) -> None:
    path = write_video("order", _frames(40), gop=10)
    with VideoFrames(path, cached=2) as video:
        assert len(video) == 40
        for number in (0, 1, 2, 25, 24, 39, 3, 4, 19, 20, 21, 0):
            assert _number(video[number]) == number
        assert [_number(image) for image in video] == list(range(40))
        with pytest.raises(IndexError):
            video[40]
        assert not video[3].flags.writeable


def test_a_turned_recording_is_shown_upright(write_video, tmp_path, with_display_rotation) -> None:
    upright = np.zeros((96, 64, 3), np.uint8)
    upright[:32, :32] = (0, 0, 255)
    # the sensor lay on its side: stored turned clockwise, and the file asks for a turn back
    stored = np.ascontiguousarray(np.rot90(upright, -1))
    plain = write_video("stored", [stored] * 6)
    turned = tmp_path / "turned.mp4"
    turned.write_bytes(with_display_rotation(plain.read_bytes(), 90))
    recording = probe(turned)
    assert recording.rotation_deg == 90
    assert (recording.width, recording.height) == (64, 96)
    with VideoFrames(turned) as video:
        assert video[2].shape == upright.shape
        # chroma is at half resolution and lossy: compare well inside the quarters
        assert cv2.absdiff(video[2][4:28, 4:28], upright[4:28, 4:28]).max() < 12
        assert video[2][40:, 40:].max() < 12


def test_a_trimmed_start_by_edit_list_is_honoured(write_video, tmp_path) -> None:
    path, cut = write_video("whole", _frames(30), gop=30), tmp_path / "cut.mp4"
    # a stream copy that starts between key frames keeps the key frame and hides what is before by an edit list
    with av.open(str(path)) as source, av.open(str(cut), "w") as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.size:
                packet.pts, packet.dts = packet.pts - 10 * 256, packet.dts - 10 * 256
                packet.stream = stream
                target.mux(packet)
    recording = probe(cut)
    assert recording.frame_times_s[0] == pytest.approx(0, abs=1e-6)
    with VideoFrames(cut) as video:
        assert _number(video[0]) == 10
        assert _number(video[5]) == 15


def test_sound_is_placed_on_the_pictures_clock(write_video, rng) -> None:
    sound = np.zeros(48000, np.float32)
    sound[24000:24600] = 0.5 * rng.standard_normal(600)
    path = write_video("clap", _frames(50), sound=sound)
    samples, rate, start_s = read_audio(path)
    assert rate == 48000
    loud = np.flatnonzero(np.abs(samples) > 0.1)[0] / rate + start_s
    # the encoder smears an onset over a block of 128 samples at most (2.7 ms); its delay of 1024 (21 ms) must be gone
    assert loud == pytest.approx(0.5, abs=0.003)
    half, half_rate, _ = read_audio(path, 24000)
    assert half_rate == 24000
    assert len(half) == pytest.approx(len(samples) / 2, abs=1)


def test_no_sound_is_told(write_video) -> None:
    with pytest.raises(InputError, match="has no sound; expected an audio stream"):
        read_audio(write_video("mute", _frames(5)))


def test_missing_unreadable_and_pictureless_files_are_told(tmp_path) -> None:
    with pytest.raises(InputError, match="is not there"):
        probe(tmp_path / "none.mp4")
    junk = tmp_path / "junk.mp4"
    junk.write_bytes(b"no video at all" * 100)
    with pytest.raises(InputError, match=r"junk.mp4 \(1500 bytes\) cannot be opened.*Copy the file again"):
        probe(junk)


@pytest.mark.parametrize("faststart", [False, True])
def test_a_truncated_file_is_told(write_video, faststart, rng) -> None:
    noisy = [rng.integers(0, 255, (96, 64, 3), dtype=np.uint8) for _ in range(40)]
    path = write_video("cut", noisy, faststart=faststart)
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * 0.7)])
    # without faststart the index stands at the end and is lost: the file does not open; with it the frames run out
    expected = "cut off: .* expected 40 frames" if faststart else "cannot be opened"
    with pytest.raises(InputError, match=expected):
        probe(path)
