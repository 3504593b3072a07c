"""Files of a subject that is rehearsed without a rig: template, mesh sequences, voices, and how high the larynx really was.

Where a camera is asked for, each take also has a video of the very meshes, one frame at each of their moments: what a monocular
tracker can follow while the true mesh of every frame is known.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import atomic_path, save_json
from headcap.calibration.result import save_cameras
from headcap.cameras import Rig
from headcap.heads.procedural import base_head
from headcap.recordings.writer import write_video
from headcap.registration.sequence import MeshSequence, save_chunk
from headcap.synthetic.hand_made import write_hand_made
from headcap.synthetic.lighting import Lights
from headcap.synthetic.mesh_pictures import look_of
from headcap.synthetic.mesh_takes import MeshSubject, MeshTake, mesh_subject
from headcap.synthetic.render import Surface
from headcap.synthetic.rig import SOUND_STREAM, build_camera, random_stream
from headcap.synthetic.sensor import build_sensors
from headcap.synthetic.settings import X264_PRESET, MeshRehearsalSettings, TakeSettings, VideoSettings
from headcap.synthetic.studio import Sitter, Studio
from headcap.synthetic.voice import synthesise

KIND, SCHEMA = "mesh_rehearsal", 1
SOUND_RATE_HZ = 48_000
ROOM_NOISE = 0.002
"""Rms of room and microphone, full scale 1, as in rehearsed recordings."""
_SAME_MOMENT_S = 1e-9


def rehearse_meshes(settings: MeshRehearsalSettings, folder: Path) -> None:
    """Write a subject's `template.npz` and, per take, `<take>.json` with its meshes, `<take>.wav` and `<take>.larynx.npz`.

    With a camera also `camera.json` (artifact `headcap.rig/1` of that one camera, exact) and per take `<take>.mp4`, whose frame k
    shows mesh k. `rehearsal.json` comes last: where it is, all else is there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    subject = mesh_subject(settings.seed, settings.subject)
    base_head().with_vertices(subject.neutral_m).save(folder / "template.npz")
    if settings.sculpt is not None:
        write_hand_made(folder, subject, settings.sculpt)
    if settings.video is not None:
        camera = build_camera(settings.video.camera, _encoding(settings))
        save_cameras(folder / "camera.json", Rig((camera,)))
    for number, take in enumerate(settings.takes):
        performed = _write_take(folder, take, number, subject, settings)
        if settings.video is not None:
            film_take(folder / f"{take.name}.mp4", performed, take, number, subject, settings)
    content = {"takes": [take.model_dump(mode="json") for take in settings.takes], "rate_hz": settings.rate_hz}
    save_json(folder / "rehearsal.json", KIND, SCHEMA, content)


def _write_take(folder: Path, take: TakeSettings, number: int, subject: MeshSubject, settings: MeshRehearsalSettings) -> MeshTake:
    frames = max(round(take.duration_s * settings.rate_hz), 1)
    performed = subject.take(
        take.kind, frames, settings.rate_hz, number=number, intensity=take.intensity, lip_shapes=take.lip_shapes
    )
    time_s = np.arange(frames) / settings.rate_hz
    positions = folder / f"{take.name}.npy"
    save_chunk(positions, performed.meshes)
    MeshSequence(take.name, time_s, (positions,)).save(folder / f"{take.name}.json")
    _write_sound(folder / f"{take.name}.wav", spoken(performed, settings.seed, number, take.duration_s))
    heights = np.array([state["larynx_mm"] for state in performed.states]) / 1000
    with atomic_path(folder / f"{take.name}.larynx.npz") as temporary, open(temporary, "wb") as handle:
        np.savez(handle, time_s=time_s, larynx_dy_m=heights)
    return performed


def film_take(
    path: Path, performed: MeshTake, take: TakeSettings, number: int, subject: MeshSubject, settings: MeshRehearsalSettings
) -> None:
    """Write the video of a take (H.264, with its voice) as the settings' one camera sees it; needs `settings.video`."""
    video = settings.video
    camera = build_camera(video.camera, _encoding(settings))
    look = look_of(subject, tattoos=video.tattoos and settings.subject.tattoos, lip_tattoo=video.tattoos and take.lips_tattooed)
    studio = Studio.of(camera.size, video.sensor, Lights.from_settings(video.lights, video.ambient, video.gloss))
    sensor = build_sensors(video.sensor, settings.seed, 1)[0]

    def pose(time_s: float) -> tuple[NDArray, Surface]:
        """Whatever the shutter asks for: at the frames' own moments the meshes as they are stored."""
        frame = round(time_s * settings.rate_hz)
        if frame < len(performed.meshes) and abs(time_s - frame / settings.rate_hz) < _SAME_MOMENT_S:
            return look.pose(performed.meshes[frame], performed.states[frame])
        state = performed.performance.state(time_s)
        return look.pose(subject.mesh(state), state)

    sitter = Sitter(pose, look.openness, look.surface.triangles, look.grain)
    pictures = (
        (k, sensor.expose(studio.photograph(camera, sitter, k / settings.rate_hz), number, 0, k))
        for k in range(len(performed.meshes))
    )
    sound = spoken(performed, settings.seed, number, take.duration_s).astype(np.float32)
    heard = {"sound": sound, "sound_rate_hz": SOUND_RATE_HZ}
    write_video(path, pictures, camera.size, settings.rate_hz, crf=video.crf, preset=X264_PRESET, **heard)


def _encoding(settings: MeshRehearsalSettings) -> VideoSettings:
    video = settings.video
    return VideoSettings(width=video.width, height=video.height, rate_hz=settings.rate_hz, crf=video.crf)


def spoken(take: MeshTake, seed: int, number: int, duration_s: float) -> NDArray[np.float64]:
    """What a microphone at the mouth hears of a take (n,) at `SOUND_RATE_HZ`: the voice, where there is one, in a quiet room."""
    random = random_stream(seed, SOUND_STREAM, number)
    time_s = np.arange(round(duration_s * SOUND_RATE_HZ)) / SOUND_RATE_HZ
    sound = random.normal(0, ROOM_NOISE, len(time_s))
    if take.performance.speech is not None:
        sound += synthesise(take.performance.speech, random, time_s, SOUND_RATE_HZ)
    return sound


def _write_sound(path: Path, samples: NDArray) -> None:
    from scipy.io import wavfile

    with atomic_path(path) as temporary, open(temporary, "wb") as handle:
        wavfile.write(handle, SOUND_RATE_HZ, np.rint(32767 * np.clip(samples, -1, 1)).astype(np.int16))
