"""A voice to meshes: nearer to the truth than rest and mean, in files that other rooms read, and clear refusals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.io import wavfile

from headcap.artifacts import Manifest, manifest_path
from headcap.cli import main
from headcap.errors import InputError
from headcap.heads import HeadCoefficients
from headcap.neck.animation.animation import curves_of_sound, meshes_of_curves
from headcap.neck.animation.curves import CoefficientCurves
from headcap.neck.animation.swallowing import swallow
from headcap.neck.fits import NeckFits
from headcap.registration.sequence import MeshSequence
from headcap.registration.template import Template
from headcap.speech import RATE_HZ

FPS = 30.0


@pytest.fixture(scope="module")
def files(tmp_path_factory, neck, voice_training, heard):
    """model, regressor, the sound of the take left out, and fits, as a session has them."""
    folder = tmp_path_factory.mktemp("session")
    neck.save(folder / "model.npz")
    voice_training.regressor.save(folder / "regressor.npz")
    NeckFits("somebody", tuple(fit for fit, _ in heard)).save(folder / "fits.npz")
    wavfile.write(folder / "voice.wav", RATE_HZ, np.round(32767 * heard[3][1].samples).astype(np.int16))
    return folder


def _animate(files, *options: str) -> int:
    return main(["animate", *(str(files / name) for name in ("model.npz", "regressor.npz", "voice.wav")), *options])


def test_a_voice_moves_the_neck_nearer_to_the_truth_than_the_mean_does(neck, voice_training, heard):
    fit, sound = heard[3]
    curves = curves_of_sound(neck, "somebody", voice_training.regressor, sound.samples, FPS)
    assert len(curves) == len(fit.time_s)
    person = neck.person("somebody")
    truth = neck.evaluate(person, HeadCoefficients(speech=fit.speech.phi), fit.speech.tau_m, fit.speech.alpha)
    regressor = voice_training.regressor
    tau, alpha = regressor.larynx.mean
    mean = neck.evaluate(person, HeadCoefficients(speech=regressor.speech.mean), tau, alpha)
    spoken = np.concatenate(list(meshes_of_curves(neck, "somebody", curves)))
    error = lambda meshes: np.linalg.norm(meshes - truth, axis=2)[:, neck.head.regions["neck"]].mean()  # noqa: E731
    assert error(spoken) < 0.8 * error(mean)


def test_a_takes_curves_give_its_meshes_back(neck, heard):
    fit = heard[0][0]
    theta = 0.1 * np.sin(np.arange(len(fit.time_s)))[:, None, None] * np.ones((1, 2, 3))
    curves = CoefficientCurves.of_take(replace(fit, theta=theta), neck.version, "somebody")
    truth = neck.evaluate(
        neck.person("somebody"), HeadCoefficients(pose=theta, speech=fit.speech.phi), fit.speech.tau_m, fit.speech.alpha
    )
    found = np.concatenate(list(meshes_of_curves(neck, "somebody", curves)))
    np.testing.assert_allclose(found, truth, atol=1e-6)


def test_the_command_writes_a_sequence_with_its_curves_and_where_it_is_from(files, tmp_path, capsys):
    assert _animate(files, "--person", "somebody", "--fps", "30", "--out", str(tmp_path / "a.json")) == 0
    sequence, curves = MeshSequence.load(tmp_path / "a.json"), CoefficientCurves.load(tmp_path / "a.curves.json")
    assert len(sequence) == len(curves) == 240
    template = Template.load(tmp_path / "a.template.npz")
    assert sequence.positions().shape[1:] == template.vertices.shape
    inputs = Manifest.load(manifest_path(tmp_path / "a.json")).inputs
    assert {name.rsplit("/", 1)[-1] for name in inputs} == {"model.npz", "regressor.npz", "voice.wav"}
    assert main(["export", str(tmp_path / "a.json"), str(tmp_path / "a.npz"), "--format", "npz"]) == 0
    assert np.array_equal(np.load(tmp_path / "a.npz")["verts"], sequence.positions())
    assert "a.curves.json" in capsys.readouterr().out


@pytest.mark.parametrize("form", ["npz", "pc2", "obj", "glb"])
def test_every_format_of_export_is_offered(files, tmp_path, form):
    swallow(4).save(tmp_path / "swallow.json")
    out = tmp_path / ("folder" if form in ("obj", "glb") else f"a.{form}")
    options = ["--person", "somebody", "--curves", str(tmp_path / "swallow.json"), "--format", form, "--out", str(out)]
    assert main(["animate", str(files / "model.npz"), *options]) == 0
    assert out.is_file() or len(list(out.glob(f"*.{form}"))) == 7
    assert not list(tmp_path.glob("tmp*"))


def test_pose_and_expression_come_from_curves_and_the_rest_from_the_voice(files, tmp_path):
    time_s = np.arange(481) / 60
    nod = np.column_stack([0.2 * np.sin(time_s), 0 * time_s, 0 * time_s])
    CoefficientCurves(time_s, {"neck": nod}).save(tmp_path / "nod.json")
    common = ["--person", "somebody", "--fps", "30", "--out"]
    assert _animate(files, *common, str(tmp_path / "a.json")) == 0
    assert _animate(files, *common, str(tmp_path / "b.json"), "--curves", str(tmp_path / "nod.json")) == 0
    alone, both = (CoefficientCurves.load(tmp_path / f"{name}.curves.json") for name in "ab")
    assert np.array_equal(alone.curve("phi"), both.curve("phi"))
    np.testing.assert_allclose(both.curve("neck"), nod[:480:2], atol=1e-12)
    moved = MeshSequence.load(tmp_path / "b.json").positions() - MeshSequence.load(tmp_path / "a.json").positions()
    assert np.abs(moved[0]).max() < 1e-6
    assert np.abs(moved[40]).max() > 5e-3


def test_edits_on_the_command_line_follow_their_order(files, tmp_path):
    out = [str(tmp_path / f"{k}.json") for k in range(4)]
    assert main(["edit", str(files / "fits.npz"), "--take", "talk_1", "--out", out[0]]) == 0
    there = ["--scale", "tau=1.5", "--offset", "tau=2", "--exaggerate", "phi=2", "--offset", "jaw.x=5", "--add", "swallow@1"]
    back = ["--subtract", "swallow@1", "--offset", "jaw.x=-5", "--exaggerate", "phi=0.5", "--offset", "tau=-2"]
    assert main(["edit", out[0], *there, "--out", out[1]]) == 0
    assert main(["edit", out[1], *back, "--scale", f"tau={1 / 1.5!r}", "--out", out[2]]) == 0
    first, edited, again = (CoefficientCurves.load(path) for path in out[:3])
    # millimetres and degrees
    assert edited.curve("tau")[0] == pytest.approx(1.5 * first.curve("tau")[0] + 0.002)
    assert edited.curve("jaw.x")[0] == pytest.approx(np.radians(5))
    for name, values in first.channels.items():
        np.testing.assert_allclose(again.channels[name], values, atol=1e-12)
    assert main(["edit", out[0], "--key", "tau@0.5=20", "--key", "tau@0.8=5", "--out", out[3]]) == 0
    bent = CoefficientCurves.load(out[3]).curve("tau")
    assert (bent[15], bent[24]) == (pytest.approx(0.020), pytest.approx(0.005))
    halves = ["--scale", "tau=0.5", "--scale", "tau=0.5"]
    assert main(["edit", "swallow", "--fps", "30", *halves, "--out", out[3]]) == 0
    assert CoefficientCurves.load(out[3]).curve("tau").max() == pytest.approx(0.0055, rel=0.01)


def test_a_swallow_is_cut_from_fits(files, tmp_path, heard):
    curves = CoefficientCurves.load(_edited(files, tmp_path, "--add", "swallow@2", "--cut", "swallow"))
    assert 0.6 < curves.duration_s < 2.5
    assert curves.curve("tau").max() > 0.015


def _edited(files, folder, *options: str):
    assert main(["edit", str(files / "fits.npz"), "--take", "talk_1", *options, "--out", str(folder / "edited.json")]) == 0
    return folder / "edited.json"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["{d}/fits.npz"], "4 takes; expected one of talk_1, talk_2"),
        (["{d}/fits.npz", "--take", "song"], "take song"),
        (["swallow", "--scale", "tau"], "such as tau=1.5"),
        (["swallow", "--scale", "tau=much"], "a number in place of 'much'"),
        (["swallow", "--scale", "phi=2"], "expected one of tau, alpha"),
        (["swallow", "--key", "tau=3"], "such as tau@1.2=20"),
        (["swallow", "--cut", "1"], "such as 1.0:2.5"),
        (["swallow", "--add", "swallow"], "such as swallow@1.2"),
        (["{d}/model.npz"], "expected headcap.neck_fits/2"),
    ],
)
def test_edits_that_are_not_understood_are_refused_in_one_line(files, tmp_path, capsys, arguments, told):
    assert main(["edit", *(a.format(d=files) for a in arguments), "--out", str(tmp_path / "a.json")]) == 1
    message = capsys.readouterr().err
    assert told in message
    assert message.count("\n") == 1
    assert not (tmp_path / "a.json").exists()


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--person", "nobody"], "person nobody; expected one of somebody"),
        (["--person", "somebody", "--fps", "0"], "positive rate"),
        (["--person", "somebody", "--format", "fbx"], "format 'fbx'"),
        (["--person", "somebody", "--out", "a.npy"], "ends in .json"),
        (["--person", "somebody", "--curves", "{t}/short.json"], "curves from 0.000 to 1.500 s for moments"),
        (["--person", "somebody", "--curves", "{t}/other.json"], "curves of neck model v2 beside neck model"),
        (["--person", "somebody", "--curves", "{t}/a.curves.json"], "to read and to write"),
    ],
)
def test_what_cannot_be_animated_is_refused_in_one_line(files, tmp_path, capsys, options, told):
    swallow(30).save(tmp_path / "short.json")
    swallow(30).save(tmp_path / "a.curves.json")
    CoefficientCurves(np.arange(2.0), {"phi": np.zeros((2, 3))}, model_version="v2").save(tmp_path / "other.json")
    assert _animate(files, "--out", str(tmp_path / "a.json"), *(option.format(t=tmp_path) for option in options)) == 1
    message = capsys.readouterr().err
    assert told in message
    assert message.count("\n") == 1
    assert not (tmp_path / "a.json").exists()


def test_sound_and_regressor_must_fit(files, tmp_path, capsys, voice_training, neck):
    out = ["--person", "somebody", "--out", str(tmp_path / "a.json")]
    wavfile.write(tmp_path / "short.wav", RATE_HZ, np.zeros(5000, np.int16))
    model, regressor = str(files / "model.npz"), str(files / "regressor.npz")
    assert main(["animate", model, regressor, str(tmp_path / "short.wav"), *out]) == 1
    assert "0.312 s of sound; expected at least 0.520 s" in capsys.readouterr().err
    assert main(["animate", model, regressor, *out]) == 1
    assert "a regressor without a sound" in capsys.readouterr().err
    assert main(["animate", model, *out]) == 1
    assert "neither sound nor curves" in capsys.readouterr().err
    replace(voice_training.regressor, model_version="another").save(tmp_path / "other.npz")
    assert main(["animate", model, str(tmp_path / "other.npz"), str(files / "voice.wav"), *out]) == 1
    assert "a speech regressor of neck model another beside neck model" in capsys.readouterr().err
    many = CoefficientCurves(np.arange(2.0), {"phi": np.zeros((2, 9))}, model_version=neck.version)
    with pytest.raises(InputError, match="speech coefficients"):
        next(meshes_of_curves(neck, "somebody", many))


def test_silence_leaves_the_larynx_to_loudness_and_is_no_error(neck, voice_training):
    curves = curves_of_sound(neck, "somebody", voice_training.regressor, np.zeros(16000, np.float32), FPS)
    assert len(curves) == 30
    assert all(np.isfinite(values).all() for values in curves.channels.values())


def test_a_regressor_of_blendshapes_alone_leaves_the_larynx_at_rest(neck, voice_training, heard):
    mute = replace(voice_training.regressor, larynx=None)
    curves = curves_of_sound(neck, "somebody", mute, heard[3][1].samples[:16000], FPS)
    assert set(curves.channels) == {"phi"}
    mesh = next(meshes_of_curves(neck, "somebody", curves))
    rest = neck.evaluate(neck.person("somebody"), HeadCoefficients(speech=curves.curve("phi")), 0.0, 1.0)
    np.testing.assert_allclose(mesh, rest, atol=1e-7)
