"""Calibration of recordings the project did not make, cut short; truth and another program's answer judge it."""

import csv
import json
from itertools import islice

import numpy as np
import pytest

from headcap.calibration.board import BoardSettings, read_board
from headcap.calibration.detection import detect_recording, luma_frames
from headcap.calibration.settings import CalibrateSettings
from headcap.calibration.solve import calibrate
from headcap.cameras import Camera, Rig
from headcap.cameras.formats import read_rig
from headcap.geometry.transforms import fit_rigid, rigid, rotation_angle
from headcap.sync.offsets import TimeOffsets

pytestmark = pytest.mark.real


def offsets(names, start_s):
    count = len(names)
    return TimeOffsets("calibration", tuple(names), tuple(map(float, start_s)), (0.0,) * count, (1.0,) * count, ("clap",) * count)


def test_part_of_a_rig_that_does_not_fire_together(test_data):
    folder, chosen = test_data / "ict_rig", [6, 7, 8, 9]
    names = [f"cam{c:02d}" for c in chosen]
    truth = json.loads((folder / "truth" / "rig.json").read_text())
    start = np.array(truth["takes"]["calibration"]["first_frame_time_s"])[chosen]
    noise = np.random.default_rng(4).normal(0, 2e-3, len(chosen))
    board = read_board(folder / "board.yaml")
    detections = [
        detect_recording(islice(luma_frames(folder / "calibration" / f"{n}.mp4"), 150), board, n, start_s=s)
        for n, s in zip(names, start + noise, strict=True)
    ]
    result = calibrate(detections, offsets(names, start + noise), board, CalibrateSettings())
    # the limits of the whole recording are 0.3 mm, 0.03 deg and 0.15 px; half of it with a third of the cameras gets more
    true = [truth["cameras"][c] for c in chosen]
    true_rig = Rig(
        tuple(
            Camera(n, 540, 960, np.array(c["K"]), np.array(c["dist"]), rigid(np.array(c["R"]), np.array(c["t"])))
            for n, c in zip(names, true, strict=True)
        )
    )
    aligned = result.rig.transformed(fit_rigid(result.rig.centres, true_rig.centres))
    assert 1e3 * np.sqrt(((aligned.centres - true_rig.centres) ** 2).sum(1).mean()) < 0.6
    assert result.heldout_rms_px < 0.15
    assert result.board_scale_error_mm < 0.05
    error_s = np.array([result.av_offset_s()[n] for n in names]) + (noise - noise.mean())
    assert np.sqrt((error_s**2).mean()) < 5e-5


def test_four_cameras_and_an_inverted_board(test_data):
    folder = test_data / "caliscope"
    rows = list(csv.DictReader((folder / "calibration" / "extrinsic" / "timestamps.csv").open()))
    board = BoardSettings(dictionary="DICT_4X4_1000", squares=(4, 5), square_size_mm=54, marker_size_mm=0.75 * 54, inverted=True)
    names = [f"cam_{c}" for c in range(4)]
    first = min(float(row["frame_time"]) for row in rows)
    detections = []
    for c, name in enumerate(names):
        times = np.array([float(row["frame_time"]) - first for row in rows if int(row["cam_id"]) == c])
        # this camera sees the board in the second half
        frames = islice(luma_frames(folder / "calibration" / "extrinsic" / f"{name}.mp4"), 60, None)
        detections.append(detect_recording(frames, board, name, times_s=times))
    result = calibrate(detections, offsets(names, [0.0] * 4), board, CalibrateSettings())
    other = read_rig(folder / "camera_array.toml")
    aligned = result.rig.transformed(fit_rigid(result.rig.centres, other.centres))
    # the other program's answer is good to 1-3 cm and about a degree, which adds to what this board in few places leaves
    assert np.linalg.norm(aligned.centres - other.centres, axis=1).max() < 0.04
    turns = sum(b.camera_from_world[:3, :3].T @ a.camera_from_world[:3, :3] for a, b in zip(result.rig, other, strict=True))
    u, _, vt = np.linalg.svd(turns)
    mean = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    angle = [
        np.degrees(rotation_angle(a.camera_from_world[:3, :3] @ mean.T @ b.camera_from_world[:3, :3].T))
        for a, b in zip(result.rig, other, strict=True)
    ]
    assert max(angle) < 2.5
    assert np.isfinite(result.heldout_p95_px)
