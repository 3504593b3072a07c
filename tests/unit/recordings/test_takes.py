import re

import av
import numpy as np
import pytest

from headcap.errors import InputErrors
from headcap.recordings import IngestedTake, ingest_take
from headcap.recordings.takes import check_same_cameras, freezes_of

FRAMES, RATE = 24, 50


@pytest.fixture
def sound(rng) -> np.ndarray:
    return (0.1 * rng.standard_normal(FRAMES * 48000 // RATE)).astype(np.float32)


@pytest.fixture
def good(write_video, slide, sound) -> dict:
    """Three cameras without a fault."""
    return {f"cam{c}": write_video(f"cam{c}", slide(FRAMES, seed=c), sound=sound) for c in range(3)}


def _ingest(files: dict, take: str = "take_1", **asked) -> IngestedTake:
    return ingest_take(take, "pose", files, **{"rate_hz": RATE, "needs_sound": True, "min_frames": FRAMES, **asked})


def _refused(files: dict, **asked) -> list[str]:
    with pytest.raises(InputErrors) as caught:
        _ingest(files, **asked)
    for error in caught.value.errors:
        # each message has its three parts, and the remedy is a sentence
        assert error.found
        assert error.expected
        assert len(error.remedy.split()) >= 4
    return [str(error) for error in caught.value.errors]


def _is_one(messages: list[str], pattern: str) -> None:
    assert len(messages) == 1, messages
    assert re.search(pattern, messages[0]), messages[0]


def test_good_recordings_pass_and_are_kept(good, tmp_path) -> None:
    take = _ingest(good)
    assert take.cameras == ("cam0", "cam1", "cam2")
    assert take["cam1"].audio_rate_hz == 48000
    take.save(tmp_path / "take.json")
    assert IngestedTake.load(tmp_path / "take.json") == take


def test_dropped_frames_are_no_fault(good, write_video, slide, sound) -> None:
    numbers = [k for k in range(FRAMES) if k != 9]
    good["cam1"] = write_video("drops", [slide(FRAMES, seed=1)[k] for k in numbers], numbers=numbers, sound=sound)
    assert len(_ingest(good, min_frames=FRAMES - 1)["cam1"].frame_times_s) == FRAMES - 1


def test_a_missing_camera(good, tmp_path) -> None:
    good["cam1"] = tmp_path / "none.mp4"
    _is_one(_refused(good), r"cam1 has no recording in take_1 .*none.mp4.*expected one file per camera")


def test_a_wrong_rate(good, write_video, slide, sound) -> None:
    good["cam1"] = write_video("slow", slide(FRAMES, seed=1), rate=25, sound=sound)
    _is_one(_refused(good), r"cam1 .* runs at 25.000 frames per second; expected 50")


def test_a_short_take(good, write_video, slide, sound) -> None:
    good["cam2"] = write_video("short", slide(10, seed=2), sound=sound)
    _is_one(_refused(good), r"cam2 .* has 10 frames; expected at least 24")
    _is_one(_refused(good, min_frames=None, min_duration_s=0.48), r"cam2 .* lasts 0.20 s; expected at least 0.48 s")


def test_no_sound_and_silence_where_a_clap_is_needed(good, write_video, slide) -> None:
    good["cam0"] = write_video("mute", slide(FRAMES, seed=0))
    good["cam1"] = write_video("silent", slide(FRAMES, seed=1), sound=np.zeros(20000, np.float32))
    messages = _refused(good)
    assert len(messages) == 2
    assert re.search(r"cam0 .* has no sound; expected sound, for the clap", messages[0])
    assert re.search(r"cam1 .* is silent: the loudest sample is 0 of full scale", messages[1])
    assert _ingest(good, needs_sound=False).cameras == ("cam0", "cam1", "cam2")


def test_a_black_camera(good, write_video, sound, rng) -> None:
    # a capped lens still has noise
    black = [rng.integers(0, 9, (160, 128, 3), dtype=np.uint8) for _ in range(FRAMES)]
    good["cam0"] = write_video("black", black, sound=sound)
    _is_one(_refused(good), r"cam0 .* is black: the brightest percent is \d+ of 255; expected at least 12")


def test_a_frozen_camera(good, write_video, slide, sound) -> None:
    good["cam1"] = write_video("frozen", [slide(1, seed=1)[0]] * FRAMES, sound=sound)
    _is_one(_refused(good), r"cam1 .* is frozen: no part of the picture changes by more than 0")


def test_a_still_scene_with_sensor_noise_is_not_frozen(good, write_video, slide, sound, rng) -> None:
    still = slide(1, seed=1)[0]
    noisy = [np.clip(still + rng.normal(0, 2.5, still.shape), 0, 255).astype(np.uint8) for _ in range(FRAMES)]
    good["cam1"] = write_video("still", noisy, sound=sound)
    _ingest(good)


def _frozen(pictures: list[np.ndarray], first: int, last: int) -> list[np.ndarray]:
    return [*pictures[:first], *[pictures[first - 1]] * (last - first + 1), *pictures[last + 1 :]]


def test_a_camera_that_freezes_in_mid_take(good, write_video, slide, sound) -> None:
    good["cam1"] = write_video("stalls", _frozen(slide(FRAMES, seed=1), 9, 17), sound=sound)
    found = r"cam1 .* is frozen from 0.1[68] to 0.3[246] s: \d+ frames repeat one picture while 2 of 2 other cameras see motion"
    _is_one(_refused(good), found)


def test_a_pause_of_the_subject_is_no_freeze(write_video, slide, sound) -> None:
    files = {f"cam{c}": write_video(f"cam{c}", _frozen(slide(FRAMES, seed=c), 9 + c, 17 + c), sound=sound) for c in range(3)}
    start_s = {f"cam{c}": -c / RATE for c in range(3)}
    assert freezes_of(_ingest(files), start_s=start_s) == []


def test_a_short_freeze_in_a_take_with_a_pause_shows_once_start_times_are_known(write_video, slide, sound) -> None:
    pictures = {c: _frozen(slide(FRAMES + 16, seed=c), 4 + c, 14 + c) for c in range(3)}
    pictures[2] = _frozen(pictures[2], 24, 31)
    take = _ingest({f"cam{c}": write_video(f"cam{c}", pictures[c], sound=sound) for c in range(3)})
    (error,) = freezes_of(take, start_s={f"cam{c}": -c / RATE for c in range(3)})
    assert re.search(r"cam2 .* is frozen from 0.4\d to 0.6\d s", str(error))


def test_a_gap_in_the_middle(good, write_video, slide, sound) -> None:
    numbers = [k for k in range(FRAMES + 20) if not 8 <= k < 23]
    good["cam2"] = write_video("gap", [slide(FRAMES + 20, seed=2)[k] for k in numbers], numbers=numbers, sound=sound)
    messages = _refused(good)
    _is_one(
        messages, r"cam2 .* has no pictures from 0.14 to 0.46 s: 15 frames in a row are missing; expected gaps of at most 0.25 s"
    )


def _damage(path, number: int) -> None:
    """Overwrite the packet of one frame with zeros."""
    with av.open(str(path)) as container:
        packets = [(packet.pts, packet.pos, packet.size) for packet in container.demux(video=0) if packet.size]
    _, place, size = sorted(packets)[number]
    data = bytearray(path.read_bytes())
    data[place : place + size] = bytes(size)
    path.write_bytes(data)


def test_damage_in_the_middle(good) -> None:
    _damage(good["cam1"], 13)
    found = r"cam1 .*: (1|\d+) of 24 frames do not decode,.* at 0.2\d s \(.*\); expected frames that decode from the first to the"
    _is_one(_refused(good), found)


def test_two_cameras_given_one_file(good, tmp_path) -> None:
    copy = tmp_path / "copy.mp4"
    copy.write_bytes(good["cam0"].read_bytes())
    good["cam2"] = copy
    _is_one(_refused(good), r"cam2 of take_1 shows the same pictures as cam0; expected a recording of its own")


def test_a_damaged_file(good, rng) -> None:
    data = bytearray(good["cam0"].read_bytes())
    good["cam0"].write_bytes(bytes(data[: len(data) // 2]))
    _is_one(_refused(good), r"cam0 of take_1: .*cannot be opened.*expected a whole video or sound file")


def test_frames_that_do_not_decode_at_the_end(good, write_video, sound, rng) -> None:
    # every frame is noise, so the packets are large and the last tenth of the data holds the last frames
    noise = [rng.integers(0, 255, (160, 128, 3), dtype=np.uint8) for _ in range(FRAMES)]
    path = write_video("noise", noise, sound=None, faststart=True)
    data = bytearray(path.read_bytes())
    data[-len(data) // 12 :] = bytes(len(data) - (len(data) - len(data) // 12) + (1 if len(data) % 12 else 0))
    path.write_bytes(bytes(data))
    good["cam1"] = path
    _is_one(_refused(good, needs_sound=False), r"cam1 .*do not decode.*expected frames that decode from the first to the last")


def test_all_problems_are_told_at_once(good, write_video, slide, tmp_path) -> None:
    files = {"cam0": tmp_path / "none.mp4", "cam1": write_video("short", slide(5), rate=25), "cam2": good["cam2"]}
    messages = _refused(files)
    assert len(messages) == 4
    assert "cam0 has no recording" in messages[0]
    assert all("cam1" in message for message in messages[1:])


def test_a_camera_keeps_its_size_and_turn_over_a_session(good, write_video, slide, sound) -> None:
    first = _ingest(good)
    files = {f"cam{c}": write_video(f"b{c}", slide(FRAMES, seed=10 + c), sound=sound) for c in range(3)}
    check_same_cameras([first, _ingest(files, "take_2")])
    files["cam1"] = write_video("wide", slide(FRAMES, seed=11, width=160, height=128), sound=sound)
    with pytest.raises(InputErrors, match=r"cam1 shows 160x128 in take_2; expected 128x160 as in take_1"):
        check_same_cameras([first, _ingest(files, "take_2")])


def test_one_file_given_to_two_takes(good, write_video, slide, sound) -> None:
    files = {f"cam{c}": write_video(f"b{c}", slide(FRAMES, seed=10 + c), sound=sound) for c in range(3)}
    files["cam2"] = good["cam1"]
    with pytest.raises(InputErrors, match="cam2 of take_2 shows the same pictures as cam1 of take_1"):
        check_same_cameras([_ingest(good), _ingest(files, "take_2")])
