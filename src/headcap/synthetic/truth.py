"""What really happened, in the layout that evaluation reads."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from headcap.artifacts import atomic_path
from headcap.cameras import Rig
from headcap.synthetic.performance import ARTICULATORS, MUSCLES, Performance
from headcap.synthetic.rig import Clock
from headcap.synthetic.scan import scan_from_world
from headcap.synthetic.settings import RehearsalSettings
from headcap.synthetic.subject import Subject

UNIT_M = 4e-6


def write_rig_truth(
    folder: Path, settings: RehearsalSettings, rig: Rig, clocks: dict[str, tuple[Clock, ...]], frames: dict[str, int]
) -> None:
    """`rig.json`: cameras, and per recording each camera's start, drift, sound lag and missing frames."""
    cameras = [
        {
            "name": camera.name,
            "K": camera.matrix.tolist(),
            "dist": camera.distortion.tolist(),
            "R": camera.camera_from_world[:3, :3].tolist(),
            "t": camera.camera_from_world[:3, 3].tolist(),
        }
        for camera in rig
    ]
    takes = {
        name: {
            "first_frame_time_s": [clock.start_s for clock in recorded],
            "drift_ppm": [clock.drift_ppm for clock in recorded],
            "audio_lag_s": [clock.audio_lag_s for clock in recorded],
            "dropped_frames": [np.setdiff1d(np.arange(frames[name]), clock.kept_frames).tolist() for clock in recorded],
            "clap_time_s": settings.sound.clap_time_s,
            "clap_position_m": list(settings.sound.clap_position_m),
            "frames": frames[name],
        }
        for name, recorded in clocks.items()
    }
    content = {
        "fps": settings.video.rate_hz,
        "width": settings.video.width,
        "height": settings.video.height,
        "pixel_centre": "integer (0,0) is the centre of the top-left pixel",
        "cameras": cameras,
        "takes": takes,
    }
    _write_json(folder / "rig.json", content)


def write_topology_truth(folder: Path, subject: Subject) -> None:
    """`topology.npz`: triangles, larynx, landmarks, inner lips of the subject's own mesh."""
    names = sorted(subject.landmarks)
    arrays = {
        "faces": subject.surface.triangles,
        "blendshape_names": np.array(MUSCLES + ARTICULATORS),
        "larynx0_m": subject.places.larynx,
        "landmarks68": np.array([subject.landmarks[name] for name in names], np.int64),
        "landmark_names": np.array(names),
        "inner_lip_upper": subject.inner_lips[0],
        "inner_lip_lower": subject.inner_lips[1],
    }
    _write_npz(folder / "topology.npz", arrays)


def write_scan_truth(folder: Path, settings: RehearsalSettings) -> None:
    """`scan.json`: how the scan was placed, scan = scale * R @ world + t."""
    rotation, scale, shift = scan_from_world(settings.scan, settings.seed)
    content = {"scan_from_world": {"R": rotation.tolist(), "scale": scale, "t": shift.tolist()}}
    _write_json(folder / "scan.json", content)


def write_take_truth(
    folder: Path, name: str, subject: Subject, performance: Performance, clocks: tuple[Clock, ...], rate_hz: float
) -> None:
    """`<take>.npz`: the subject at the frames of the camera that started last, and what drove it."""
    reference = int(np.argmax([clock.start_s for clock in clocks]))
    time = clocks[reference].common_time(clocks[reference].kept_frames / rate_hz)
    states = [performance.state(t) for t in time]
    first = subject.vertices(states[0]).astype(np.float32)
    offsets = np.empty((len(time), *first.shape), np.int16)
    for k, state in enumerate(states):
        moved = np.rint((subject.vertices(state) - first) / UNIT_M)
        if np.abs(moved).max() > 32767:
            raise ValueError(f"take {name}: the subject moves more than {32767 * UNIT_M} m")
        offsets[k] = moved
    arrays = {
        "vertices_mm_i16": offsets,
        "first_m": first,
        "unit": np.array(f"vertices = first_m + vertices_mm_i16*{UNIT_M:g} m"),
        "time_s": time,
        "reference_camera": np.array(reference),
        "blend_weights": np.array([[state[channel] for channel in MUSCLES + ARTICULATORS] for state in states]),
        "head_rotvec": np.array([[state[f"turn_{axis}"] for axis in "xyz"] for state in states]),
        "larynx_dy_m": np.array([state["larynx_mm"] / 1000 for state in states]),
        "larynx_scale": np.array([1 + state["larynx_size"] for state in states]),
    }
    if performance.speech is not None:
        speech = performance.speech
        arrays["speech_time_s"] = speech.time_s[::5]
        arrays["pitch_hz"] = speech.at(speech.time_s[::5], "pitch_hz")[:, 0]
        arrays["voicing"] = speech.at(speech.time_s[::5], "voicing")[:, 0]
        arrays["formants_hz"] = speech.at(speech.time_s[::5], "f1_hz", "f2_hz", "f3_hz")
    _write_npz(folder / f"{name}.npz", arrays)


def _write_npz(path: Path, arrays: dict[str, np.ndarray]) -> None:
    with atomic_path(path) as temporary, open(temporary, "wb") as handle:
        np.savez_compressed(handle, **arrays)


def _write_json(path: Path, content: dict) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")
