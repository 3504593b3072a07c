import json

import numpy as np
import pytest

from headcap.errors import InputError, InputErrors
from headcap.recordings.audio import read_audio
from headcap.sync import SyncSettings, TimeOffsets, synchronise
from headcap.sync.figure import save_sync_figure
from headcap.sync.solve import SyncResult

STARTS = np.array([0.031, 0.142, 0.0071, 0.0984, 0.0603, 0.0269])
CAMERAS = [f"cam{c}" for c in range(len(STARTS))]
# clean copies are aligned to well under a hundredth of a millisecond: a 48 kHz sample is 0.021 ms, the parabola through an
# eightfold upsampled peak errs by a fiftieth of a step
CLEAN_MS = 0.003


def _error_ms(result: SyncResult, starts: np.ndarray = STARTS) -> np.ndarray:
    error = np.array(result.offsets.start_s) - starts
    return 1e3 * (error - error.mean())


def test_start_times_from_a_clap(listen, sounds, rng) -> None:
    audio = listen(STARTS, [(sounds["clap"](rng), 0.22, None)])
    result = synchronise(audio, take="take")
    assert np.abs(_error_ms(result)).max() < CLEAN_MS
    assert result.offsets.method == ("clap",) * 6
    assert min(result.offsets.confidence) == 1.0
    # zero of the common clock: the own zero of the camera that starts last
    assert max(result.offsets.start_s) == 0.0
    assert result.offsets.start_s[int(STARTS.argmax())] == 0.0


def test_recordings_far_apart_in_time(listen, sounds, rng) -> None:
    starts = STARTS * 20  # up to 2.8 s apart
    audio = listen(starts, [(sounds["clap"](rng), 4.0, None)], duration_s=5.0)
    assert np.abs(_error_ms(synchronise(audio, take="take"), starts)).max() < CLEAN_MS


def test_flight_is_taken_off(listen, sounds, rng) -> None:
    centres = rng.uniform(-1, 1, (6, 3))
    clapper = np.array([0.1, -0.2, 0.3])
    settings = SyncSettings(temperature_c=24)
    assert settings.speed_of_sound == pytest.approx(345.5, abs=0.1)
    flight = np.linalg.norm(centres - clapper, axis=1) / settings.speed_of_sound
    audio = listen(STARTS, [(sounds["clap"](rng), 0.22, flight)])
    places = dict(zip(CAMERAS, centres, strict=True))
    with_places = synchronise(audio, take="take", camera_centres=places, clapper_m=clapper, settings=settings)
    assert np.abs(_error_ms(with_places)).max() < CLEAN_MS
    without = synchronise(audio, take="take")
    # what is left out is the flight itself
    np.testing.assert_allclose(_error_ms(without), 1e3 * (flight.mean() - flight), atol=CLEAN_MS)


def test_a_cameras_own_delay_between_picture_and_sound(listen, sounds, rng) -> None:
    audio = listen(STARTS, [(sounds["clap"](rng), 0.22, None)])
    plain = np.array(synchronise(audio, take="take").offsets.start_s)
    moved = np.array(synchronise(audio, take="take", av_offset_s={"cam2": 0.004}).offsets.start_s)
    change = moved - plain
    assert change[2] - change[0] == pytest.approx(0.004, abs=1e-9)
    np.testing.assert_allclose(np.delete(change, 2), change[0], atol=1e-12)


def test_noise_coughs_and_other_sounds_do_not_move_the_clap(listen, sounds, rng) -> None:
    near_one = np.full(6, np.nan)
    near_one[3] = 0.0
    flight = rng.uniform(0, 0.004, 6)
    events = [
        (sounds["clap"](rng), 0.40, None),
        (0.8 * sounds["cough"](rng), 0.55, flight),  # heard by all, from elsewhere
        (2.0 * sounds["clap"](rng), 0.28, near_one),  # something falls beside one camera, louder than the clap
    ]
    audio = listen(STARTS, events, duration_s=0.9, noise=0.01)
    result = synchronise(audio, take="take")
    # noise 40 dB under the clap's peak moves a peak of 20 kHz bandwidth by about 1 us, six cameras average
    assert np.abs(_error_ms(result)).max() < 0.01


@pytest.mark.parametrize("second_s", [0.45, 0.62])
def test_a_second_clap_that_some_cameras_hear_alone(listen, sounds, rng, second_s) -> None:
    starts = STARTS.copy()
    starts[1] = 0.30  # starts behind the first clap: only the second is in its sound
    events = [(sounds["clap"](rng), 0.22, None), (sounds["clap"](rng), second_s, None)]
    result = synchronise(listen(starts, events, duration_s=0.8), take="take")
    assert np.abs(_error_ms(result, starts)).max() < CLEAN_MS


def test_an_occluded_camera_hears_the_clap_late_and_dull(listen, sounds, rng) -> None:
    burst = sounds["clap"](rng)
    others, behind = np.zeros(6), np.full(6, np.nan)
    others[4], behind[4] = np.nan, 0.0
    dull = np.convolve(burst, np.hanning(9) / 4.5, mode="same")  # a low-pass around 10 kHz, symmetric: no delay
    echoes = [(g * burst, 0.22 + d, None) for g, d in ((0.5, 0.0031), (0.4, 0.0067), (0.3, 0.0113))]
    audio = listen(STARTS, [(burst, 0.22, others), (0.3 * dull, 0.22, behind), *echoes], noise=3e-3)
    # the direct sound is 10 dB down at one camera and echoes are as loud: its direct peak still wins over all pairs
    assert np.abs(_error_ms(synchronise(audio, take="take"))).max() < 0.02


def test_drift_from_two_claps(listen, sounds, rng) -> None:
    drift = np.array([12.0, -8.0, 0.0, 30.0, -21.0, 4.0])
    events = [(sounds["clap"](rng), 0.3, None), (sounds["clap"](rng), 9.8, None)]
    audio = listen(STARTS, events, duration_s=10.5, drift_ppm=drift)
    result = synchronise(audio, take="take")
    found = np.array(result.offsets.drift_ppm)
    # two arrivals good to 0.003 ms over 9.5 s: 0.4 ppm; the common clock is the median one, so a constant is free
    np.testing.assert_allclose(found - found.mean(), drift - drift.mean(), atol=0.4)
    offsets = result.offsets
    ends = np.array([offsets.common_time(camera, 10.0) for camera in CAMERAS])
    truth = STARTS + (1 + drift * 1e-6) * 10.0
    assert 1e3 * np.ptp(ends - truth) < 0.02
    assert len(result.events) == 2


def test_claps_at_two_places_are_not_taken_for_drift(listen, sounds, rng) -> None:
    events = [(sounds["clap"](rng), 0.3, None), (sounds["clap"](rng), 6.0, rng.uniform(0, 0.006, 6))]
    result = synchronise(listen(STARTS, events, duration_s=6.7), take="take")
    assert result.offsets.drift_ppm == (0.0,) * 6
    assert np.abs(_error_ms(result)).max() < CLEAN_MS


def test_no_clap_is_refused(listen, sounds, rng) -> None:
    audio = listen(STARTS, [], noise=0.01)
    with pytest.raises(InputError, match=r"take_9: no sudden sound is common to 50% of its 6 cameras; expected a clap") as caught:
        synchronise(audio, take="take_9")
    assert "Give this take's start times by hand" in caught.value.remedy


def test_a_camera_that_hears_something_else_is_refused_unless_manual(listen, sounds, rng) -> None:
    others = np.zeros(6)
    others[2] = np.nan
    alone = np.full(6, np.nan)
    alone[2] = 0.0
    audio = listen(STARTS, [(sounds["clap"](rng), 0.22, others), (sounds["clap"](rng), 0.3, alone)])
    with pytest.raises(InputErrors, match=r"cam2 of take agrees with 0% of the other cameras") as caught:
        synchronise(audio, take="take")
    assert len(caught.value.errors) == 1
    # by hand, on a clock of the user's own: cam0 is given as well and ties the two clocks
    manual = {"cam0": 5.0, "cam2": 5.0 + STARTS[2] - STARTS[0]}
    result = synchronise(audio, take="take", manual_start_s=manual)
    assert result.offsets.method == ("manual", "clap", "manual", "clap", "clap", "clap")
    assert np.abs(_error_ms(result)).max() < CLEAN_MS


def test_a_camera_without_sound_needs_a_manual_start(listen, sounds, rng) -> None:
    audio = listen(STARTS, [(sounds["clap"](rng), 0.22, None)])
    audio["cam5"] = (np.zeros(0, np.float32), 48000, 0.0)
    with pytest.raises(InputErrors, match="cam5"):
        synchronise(audio, take="take")
    last = float(STARTS.max())
    result = synchronise(audio, take="take", manual_start_s={"cam5": STARTS[5] - last})
    assert np.abs(_error_ms(result)).max() < CLEAN_MS


def test_all_manual_needs_no_sound() -> None:
    empty = (np.zeros(0, np.float32), 48000, 0.0)
    result = synchronise({"a": empty, "b": empty}, take="take", manual_start_s={"a": 0.5, "b": 0.25})
    assert result.offsets == TimeOffsets("take", ("a", "b"), (0.5, 0.25), (0.0, 0.0), (1.0, 1.0), ("manual", "manual"))
    with pytest.raises(InputError, match="offsets are given for c of take; expected among a, b"):
        synchronise({"a": empty, "b": empty}, take="take", manual_start_s={"c": 0.5})


def test_the_figure_is_drawn(listen, sounds, rng, tmp_path) -> None:
    audio = listen(STARTS, [(sounds["clap"](rng), 0.22, None)])
    save_sync_figure(tmp_path / "sync.png", synchronise(audio, take="take"), audio)
    assert (tmp_path / "sync.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.real
@pytest.mark.parametrize("take", ["pose_01", "expression_01", "speech_01"])
def test_real_claps_with_the_true_places(test_data, take) -> None:
    rig = json.loads((test_data / "ict_rig" / "truth" / "rig.json").read_text())
    centres = {f"cam{c:02d}": -np.array(k["R"]).T @ np.ravel(k["t"]) for c, k in enumerate(rig["cameras"])}
    audio = {camera: read_audio(test_data / "ict_rig" / "takes" / take / f"{camera}.mp4") for camera in centres}
    truth = rig["takes"][take]
    settings = SyncSettings()
    result = synchronise(
        audio, take=take, camera_centres=centres, clapper_m=np.array(truth["clap_position_m"]), settings=settings
    )
    error_ms = _error_ms(result, np.array(truth["first_frame_time_s"]))
    # the truth itself is placed to whole samples of 48 kHz, 0.006 ms rms
    assert np.sqrt(np.mean(error_ms**2)) < 0.015
