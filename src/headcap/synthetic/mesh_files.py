"""Files of a subject that is rehearsed without pictures: template, mesh sequences, voices, and how high the larynx really was."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import atomic_path, save_json
from headcap.heads.procedural import base_head
from headcap.registration.sequence import MeshSequence, save_chunk
from headcap.synthetic.mesh_takes import MeshSubject, MeshTake, mesh_subject
from headcap.synthetic.rig import SOUND_STREAM, random_stream
from headcap.synthetic.settings import MeshRehearsalSettings, TakeSettings
from headcap.synthetic.voice import synthesise

KIND, SCHEMA = "mesh_rehearsal", 1
SOUND_RATE_HZ = 48_000
ROOM_NOISE = 0.002
"""Rms of room and microphone, full scale 1, as in rehearsed recordings."""


def rehearse_meshes(settings: MeshRehearsalSettings, folder: Path) -> None:
    """Write a subject's `template.npz` and, per take, `<take>.json` with its meshes, `<take>.wav` and `<take>.larynx.npz`.

    `rehearsal.json` comes last: where it is, all else is there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    subject = mesh_subject(settings.seed, settings.subject)
    base_head().with_vertices(subject.neutral_m).save(folder / "template.npz")
    for number, take in enumerate(settings.takes):
        _write_take(folder, take, number, subject, settings)
    content = {"takes": [take.model_dump(mode="json") for take in settings.takes], "rate_hz": settings.rate_hz}
    save_json(folder / "rehearsal.json", KIND, SCHEMA, content)


def _write_take(folder: Path, take: TakeSettings, number: int, subject: MeshSubject, settings: MeshRehearsalSettings) -> None:
    frames = max(round(take.duration_s * settings.rate_hz), 1)
    performed = subject.take(take.kind, frames, settings.rate_hz, number=number, intensity=take.intensity)
    time_s = np.arange(frames) / settings.rate_hz
    positions = folder / f"{take.name}.npy"
    save_chunk(positions, performed.meshes)
    MeshSequence(take.name, time_s, (positions,)).save(folder / f"{take.name}.json")
    _write_sound(folder / f"{take.name}.wav", spoken(performed, settings.seed, number, take.duration_s))
    heights = np.array([state["larynx_mm"] for state in performed.states]) / 1000
    with atomic_path(folder / f"{take.name}.larynx.npz") as temporary, open(temporary, "wb") as handle:
        np.savez(handle, time_s=time_s, larynx_dy_m=heights)


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
