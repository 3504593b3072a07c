"""A subject without pictures leaves what tracking would have left, the voice, and the truth about the larynx."""

import numpy as np
import pytest

from headcap.heads.procedural import base_head
from headcap.recordings.audio import read_audio
from headcap.registration.sequence import MeshSequence
from headcap.registration.template import Template
from headcap.speech.pitch import track_pitch
from headcap.speech.take_sound import recorded_sound
from headcap.synthetic.mesh_files import ROOM_NOISE, rehearse_meshes
from headcap.synthetic.mesh_takes import mesh_subject
from headcap.synthetic.settings import MeshRehearsalSettings, TakeSettings

SETTINGS = MeshRehearsalSettings(
    seed=5,
    takes=(TakeSettings(name="nod", kind="pose", duration_s=0.6), TakeSettings(name="talk", kind="speech", duration_s=1.5)),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("meshes")
    rehearse_meshes(SETTINGS, folder)
    return folder


def test_takes_are_those_of_the_subject(folder):
    sequence, performed = MeshSequence.load(folder / "talk.json"), mesh_subject(5).take("speech", 45, 30.0, number=1)
    np.testing.assert_array_equal(sequence.positions(), performed.meshes)
    np.testing.assert_allclose(np.diff(sequence.time_s), 1 / 30)
    with np.load(folder / "talk.larynx.npz") as truth:
        np.testing.assert_allclose(truth["larynx_dy_m"], [1e-3 * state["larynx_mm"] for state in performed.states])
        np.testing.assert_array_equal(truth["time_s"], sequence.time_s)


def test_the_template_is_the_subject_at_rest(folder):
    template = Template.load(folder / "template.npz")
    np.testing.assert_array_equal(template.triangles, base_head().triangles)
    # until 0.4 s the subject holds still; positions are single precision
    np.testing.assert_allclose(MeshSequence.load(folder / "nod.json").positions()[0], template.vertices, atol=1e-7)


def test_the_voice_is_heard_when_it_speaks_and_else_the_room(folder):
    spoken, rate_hz, start_s = read_audio(folder / "talk.wav")
    silent, _, _ = read_audio(folder / "nod.wav")
    assert (len(spoken), start_s) == (round(1.5 * rate_hz), 0.0)
    before = spoken[: round(0.35 * rate_hz)]
    # the rms of so many samples of noise is off by a percent; a voice peaks near half of full scale
    assert before.std() == pytest.approx(ROOM_NOISE, rel=0.05)
    assert silent.std() == pytest.approx(ROOM_NOISE, rel=0.05)
    assert spoken.std() > 10 * ROOM_NOISE


def test_equal_seeds_give_equal_files(folder, tmp_path):
    rehearse_meshes(SETTINGS, tmp_path)
    for name in ("talk.npy", "talk.wav", "template.npz"):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


def test_a_take_is_heard_as_it_is_spoken(folder):
    """Pitch of the sound is that of the tracks, moment by moment; what moves the larynx is heard."""
    take = mesh_subject(5).take("speech", 45, 30.0, number=1)
    sound = recorded_sound("mary", "talk", folder / "talk.wav")
    time_s = np.arange(45) / 30.0
    heard = track_pitch(sound.samples).at(np.rint(16000 * sound.sound_time_s(time_s)).astype(int))
    spoken, voicing = take.performance.speech.at(time_s, "pitch_hz", "voicing").T
    both = (heard > 0) & (voicing > 0.5)
    assert both.sum() > 10
    assert np.median(np.abs(heard[both] / spoken[both] - 1)) < 0.02
    # noise of 0.002 under a voice of about 0.1
    assert 20 < sound.clarity_db < 50
    assert sound.covers(time_s).all()
