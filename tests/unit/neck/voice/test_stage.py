"""The stages `hear` and `train_speech` on files."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.io import wavfile

from headcap.artifacts import load_json
from headcap.neck.fits import NeckFits
from headcap.neck.voice.errors import VoiceErrors
from headcap.neck.voice.training import Voice, VoiceTrainingSettings
from headcap.recordings.probe import Recording
from headcap.recordings.takes import IngestedTake
from headcap.speech import RATE_HZ, SpeechRegressor
from headcap.speech.take_sound import TakeSound
from headcap.sync.board_sound import save_clapper
from headcap.sync.clapper import ClapperEstimate
from headcap.sync.offsets import TimeOffsets
from headcap.sync.timeline import TakeTimeline


def _stage(name: str):
    spec = importlib.util.spec_from_file_location(name, Path(__file__).parents[4] / "pipeline" / f"{name}.py")
    stage = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(stage)
    return stage


def test_a_take_is_heard_where_the_voice_is_clearest(heard, rng, tmp_path):
    fit, sound = heard[0]
    noise = rng.normal(size=len(sound.samples))
    recordings = []
    for camera, share in (("far", 0.05), ("near", 0.001)):
        wavfile.write(tmp_path / f"{camera}.wav", RATE_HZ, np.int16(20000 * np.clip(sound.samples + share * noise, -1, 1)))
        recordings.append(Recording(camera, tmp_path / f"{camera}.wav", 8, 8, 30.0, (0.0,), 0, RATE_HZ))
    paths = {name: tmp_path / f"{name}.json" for name in ("ingested", "offsets", "timeline", "clapper")}
    IngestedTake("talk_1", "speech", tuple(recordings)).save(paths["ingested"])
    cameras = ("far", "near")
    TimeOffsets("talk_1", cameras, (-0.1, -0.25), (0.0, 0.0), (1.0, 1.0), ("clap", "clap")).save(paths["offsets"])
    TakeTimeline("talk_1", "far", np.arange(len(fit.time_s)), fit.time_s).save(paths["timeline"])
    save_clapper(ClapperEstimate(np.zeros(3), np.zeros(3), {"far": 0.0, "near": 0.02}, 0.0), paths["clapper"])
    _stage("hear").run(**paths, sound=tmp_path / "talk_1.npz", person="somebody")
    found = TakeSound.load(tmp_path / "talk_1.npz")
    assert (found.person, found.take, found.camera) == ("somebody", "talk_1", "near")
    np.testing.assert_allclose(found.sound_time_s(np.array([0.0, 1.0])), [0.27, 1.27])
    assert load_json(tmp_path / "talk_1.npz.manifest.json", "manifest", 1)["stage"] == "hear"


def test_a_voice_is_trained_from_files(neck, heard, tmp_path):
    neck.save(tmp_path / "model.npz")
    fits, sounds = [], []
    for name, (fit, sound) in zip(("ann", "bob"), heard, strict=False):
        frames = slice(0, 90)
        arrays = {part: getattr(fit, part)[frames] for part in ("time_s", "theta", "psi", "placement")}
        short = replace(fit, speech=fit.speech.frames(frames), errors_mm={"full": np.zeros(90)}, **arrays)
        NeckFits(name, (short,)).save(tmp_path / f"{name}.npz")
        replace(sound, person=name).save(tmp_path / f"{name}_talk.npz")
        fits.append(tmp_path / f"{name}.npz")
        sounds.append(tmp_path / f"{name}_talk.npz")
    outputs = {"regressor": tmp_path / "r.npz", "errors": tmp_path / "e.json", "figure": tmp_path / "f.png"}
    _stage("train_speech").run(
        model=tmp_path / "model.npz",
        fits=fits,
        sounds=sounds,
        **outputs,
        voice=Voice(name="both", people=("ann", "bob")),
        settings=VoiceTrainingSettings(ridge={"least": 0.01, "most": 10.0, "per_decade": 1}),
    )
    read = SpeechRegressor.load(tmp_path / "r.npz", neck.version)
    assert (read.group, read.from_silence) == ("both", True)
    assert VoiceErrors.load(tmp_path / "e.json").tested == ("ann", "bob")
    figures = load_json(tmp_path / "r.npz.manifest.json", "manifest", 1)["figures"]
    assert figures["speech.phi_error"] < figures["speech.phi_error_of_mean"]
    assert (tmp_path / "f.png").exists()
