"""One bare throat, its chart and a larynx of known form on it."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from headcap.heads import HeadModel, procedural_model
from headcap.neck import (
    LarynxMap,
    NeckChart,
    NeckModel,
    NeckPerson,
    SpeechFit,
    SpeechSubject,
    SpeechTraining,
    SpeechTrainingSettings,
    build_chart,
    larynx_map,
    train_speech,
)
from headcap.neck.fits import NeckFits, TakeFit
from headcap.neck.larynx.base_shape import Throat, bare_base
from headcap.neck.voice.training import VoiceTraining, train_voice
from headcap.speech import RATE_HZ
from headcap.speech.take_sound import TakeSound
from headcap.synthetic.articulation import speak as speak_tracks
from headcap.synthetic.voice import synthesise


def bump_m(uv_m: np.ndarray) -> np.ndarray:
    """A larynx 5 mm high: two Gaussians about 10 mm wide, not symmetric along v."""
    u, v = 1e3 * uv_m[..., 0], 1e3 * uv_m[..., 1]
    shield = 5.0 * np.exp(-0.5 * ((u / 8) ** 2 + (v / 7) ** 2))
    return 1e-3 * (shield + 1.5 * np.exp(-0.5 * ((u / 9) ** 2 + ((v + 13) / 6) ** 2)))


@pytest.fixture(scope="session")
def model() -> HeadModel:
    return procedural_model(3, 3, np.float64)


@pytest.fixture(scope="session")
def chart(model) -> NeckChart:
    return build_chart(model)


@pytest.fixture(scope="session")
def larynx(model, chart) -> LarynxMap:
    """W holds the bump's values at its pixels: the truth is known everywhere."""
    empty = larynx_map(model, chart, np.array([0.0, -0.3, 0.95]))
    rows, columns = empty.weights_m.shape
    u, v = np.meshgrid(np.arange(columns), np.arange(rows))
    return empty.with_weights(bump_m(empty.origin_m + empty.pitch_m * np.stack([u, v], axis=-1)))


@dataclass(frozen=True)
class Spoken:
    """A person whose throat moves in a known way: a larynx of known form, and four smooth motions of the whole neck."""

    subject: SpeechSubject
    person: NeckPerson
    tau_m: np.ndarray
    alpha: np.ndarray


def speak(model: HeadModel, larynx: LarynxMap, seed: int, frames: int) -> Spoken:
    """A rehearsed speech take at 60 frames per second with 0.05 mm of noise; the smooth motions are larger than the larynx's."""
    rng = np.random.default_rng(seed)
    base = np.array(model.vertices)
    base[larynx.vertices] = bare_base(Throat.of(base, model.triangles, larynx))
    own = larynx.with_weights(rng.uniform(0.7, 1.1) * larynx.weights_m)
    time_s = np.arange(frames) / 60
    tau = 0.006 * np.sin(4.4 * time_s + rng.uniform(0, 6)) + 0.003 * np.sin(14.5 * time_s)
    alpha = 1 - 12 * tau + 0.05 * rng.normal(size=frames)
    phases = rng.uniform(0, 6, 4)
    weights = 1e-3 * np.array([2.0, 1.4, 1.0, 0.8]) * np.sin(np.outer(time_s, [5.7, 8.8, 13.2, 18.8]) + phases)
    meshes = base + np.tensordot(weights, smooth_motions(model, larynx), axes=1)
    meshes[:, larynx.vertices] += own.offset(tau, alpha).values
    neutral = base.copy()
    neutral[larynx.vertices] += own.offset(0.0).values
    meshes += rng.normal(0, 5e-5, meshes.shape)
    return Spoken(SpeechSubject(f"s{seed}", neutral, meshes.astype(np.float32)), NeckPerson(f"s{seed}", base, own), tau, alpha)


def smooth_motions(model: HeadModel, larynx: LarynxMap) -> np.ndarray:
    """(4, n, 3) bulges 40 to 80 mm wide about the throat, the third one sideways and odd."""
    away = model.vertices - model.vertices[larynx.vertices].mean(0)
    out = []
    for k, (width, axis) in enumerate([(0.04, 2), (0.06, 1), (0.05, 0), (0.08, 2)]):
        bulge = np.exp(-0.5 * ((away - [0, 0.02 * k - 0.02, 0]) ** 2).sum(1) / width**2)
        out.append((bulge * (away[:, 0] / 0.05 if axis == 0 else 1.0))[:, None] * np.eye(3)[axis])
    return np.array(out)


@pytest.fixture(scope="session")
def spoken(model, larynx) -> tuple[Spoken, ...]:
    return tuple(speak(model, larynx, seed, 260) for seed in (1, 2))


@pytest.fixture(scope="session")
def trained(model, chart, spoken) -> SpeechTraining:
    """Both takes but their last 60 frames."""
    subjects = [replace(one.subject, meshes=one.subject.meshes[:200]) for one in spoken]
    empty = larynx_map(model, chart, np.array([0.0, 0.0, 1.0]))
    return train_speech(model, empty, subjects, SpeechTrainingSettings(iterations=4, reduced=24))


FPS = 30.0
TAKE_S = 8.0


def heard_take(name: str, seed: int, larynx_noise: float = 0.05) -> tuple[TakeFit, TakeSound]:
    """Eight seconds of a synthetic voice, and what its tracks drive: tau by pitch, alpha by tau, phi by formants."""
    rng = np.random.default_rng(seed)
    tracks = speak_tracks(np.random.default_rng(seed), TAKE_S, pitch_hz=120.0)
    samples = synthesise(tracks, rng, np.arange(round(TAKE_S * RATE_HZ)) / RATE_HZ, RATE_HZ).astype(np.float32)
    time_s = np.arange(round(FPS * TAKE_S)) / FPS
    pitch, voicing, f1, f2, f3 = tracks.at(time_s, "pitch_hz", "voicing", "f1_hz", "f2_hz", "f3_hz").T
    tau = np.clip(voicing, 0, 1) * 0.02 * np.log(np.maximum(pitch, 80.0) / 120.0) + 0.002 * np.clip(voicing, 0, 1)
    tau += larynx_noise * np.std(tau) * rng.normal(size=len(tau))
    phi = 1e-2 * np.column_stack([(f1 - 500) / 300, (f2 - 1500) / 500, (f3 - 2500) / 300])
    speech = SpeechFit(tau, 1.0 - 12.0 * tau, phi)
    still = np.broadcast_to(np.eye(4), (len(time_s), 4, 4))
    errors = np.zeros(len(time_s))
    errors_mm = {"base": errors, "expression": errors, "full": errors}
    fit = TakeFit(name, "speech", time_s, speech, np.zeros((len(time_s), 2, 3)), np.zeros((len(time_s), 0)), still, errors_mm)
    return fit, TakeSound("somebody", name, "cam", samples)


@pytest.fixture(scope="session")
def neck(model, larynx) -> NeckModel:
    """A model of three speech blendshapes and one person, somebody."""
    base = np.array(model.vertices)
    base[larynx.vertices] = bare_base(Throat.of(base, model.triangles, larynx))
    head = replace(model, speech_basis=smooth_motions(model, larynx)[:3]).astype(np.float32)
    return NeckModel(head, (NeckPerson("somebody", base, larynx),))


@pytest.fixture(scope="session")
def heard() -> tuple[tuple[TakeFit, TakeSound], ...]:
    """Three takes to learn from and one to try."""
    return tuple(heard_take(f"talk_{seed}", seed) for seed in (1, 2, 3, 4))


@pytest.fixture(scope="session")
def voice_training(neck, heard) -> VoiceTraining:
    """Of the first three takes."""
    fits = NeckFits("somebody", tuple(fit for fit, _ in heard[:3]))
    return train_voice(neck, fits, {fit.take: sound for fit, sound in heard[:3]})
