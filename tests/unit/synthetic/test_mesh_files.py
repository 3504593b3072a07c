"""A subject without pictures leaves what tracking would have left, the voice, and the truth about the larynx."""

import cv2
import numpy as np
import pytest

from headcap.calibration.result import CalibrationResult
from headcap.heads.procedural import base_head
from headcap.meshes.rasteriser import rasterise
from headcap.recordings.audio import read_audio
from headcap.recordings.video import VideoFrames
from headcap.registration.sequence import MeshSequence
from headcap.registration.template import Template
from headcap.speech.pitch import track_pitch
from headcap.speech.take_sound import recorded_sound
from headcap.synthetic.mesh_files import ROOM_NOISE, rehearse_meshes
from headcap.synthetic.mesh_pictures import facial_hair, look_of
from headcap.synthetic.mesh_takes import mesh_subject
from headcap.synthetic.settings import MeshRehearsalSettings, MeshVideoSettings, SensorSettings, TakeSettings

SETTINGS = MeshRehearsalSettings(
    seed=5,
    takes=(TakeSettings(name="nod", kind="pose", duration_s=0.6), TakeSettings(name="talk", kind="speech", duration_s=1.5)),
)

FILMED = MeshRehearsalSettings(
    seed=5,
    video=MeshVideoSettings(width=180, height=320),
    takes=(TakeSettings(name="nod", kind="pose", duration_s=0.6), TakeSettings(name="talk", kind="speech", duration_s=0.7)),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("meshes")
    rehearse_meshes(SETTINGS, folder)
    return folder


@pytest.fixture(scope="module")
def filmed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("filmed")
    rehearse_meshes(FILMED, folder)
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
    assert not list(folder.glob("*.mp4"))


def test_equal_seeds_give_equal_videos(filmed, tmp_path):
    """Another take in the rehearsal makes no difference to the first."""
    rehearse_meshes(FILMED.model_copy(update={"takes": FILMED.takes[:1]}), tmp_path)
    for name in ("nod.mp4", "camera.json"):
        assert (tmp_path / name).read_bytes() == (filmed / name).read_bytes()


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


def _camera(folder):
    (camera,) = CalibrationResult.load(folder / "camera.json").rig
    return camera


def test_frames_show_the_meshes_of_their_moments(filmed):
    """Outline and lips lie where the camera file puts those of the mesh, in the first and in the farthest turned frame."""
    sequence, camera = MeshSequence.load(filmed / "nod.json"), _camera(filmed)
    lips = base_head().regions["lips_upper"] | base_head().regions["lips_lower"]
    triangles, hairy = base_head().triangles, facial_hair(mesh_subject(5)) > 0.1
    with VideoFrames(filmed / "nod.mp4") as video:
        np.testing.assert_allclose(video.times_s, sequence.time_s, atol=1e-6)
        for frame in (0, len(video) - 1):
            mesh, picture = np.asarray(sequence.positions()[frame], float), video[frame].astype(float)
            raster = rasterise(camera, mesh, triangles)
            # skin is red or dark, the room and brows are grey
            skin = picture[..., 2] - picture[..., 0] > 12
            hair = raster.hit & hairy[triangles[raster.triangle]].any(axis=2)
            # the codec keeps one colour for two by two pixels and filters them: a neighbour's reaches two pixels far
            bald = cv2.dilate(hair.astype(np.uint8), np.ones((5, 5), np.uint8)) == 0
            # one pixel along the outline, a percent of it, and deep shade under the chin
            assert (skin != raster.hit)[bald].sum() < 0.03 * raster.hit.sum()
            expected = raster.hit & lips[triangles[raster.triangle]].all(axis=2)
            rows, columns = np.nonzero(expected)
            box = np.s_[rows.min() - 6 : rows.max() + 6, columns.min() - 6 : columns.max() + 6]
            redness = picture[box][..., 2] - picture[box][..., 1]
            red = redness > 0.5 * (np.quantile(redness, 0.1) + np.quantile(redness, 0.98))
            overlap = (red & expected[box]).sum() / (red | expected[box]).sum()
            # lips are ten pixels high: colour is halved at both borders, in a codec's chroma of half resolution
            assert overlap > 0.6
            centre = [mask.nonzero()[0].mean() for mask in (red, expected[box])]
            assert abs(centre[0] - centre[1]) < 1.0


def test_a_filmed_take_is_heard(filmed):
    from_file, rate_hz, _ = read_audio(filmed / "talk.mp4")
    apart, _, _ = read_audio(filmed / "talk.wav")
    shorter = min(len(from_file), len(apart))
    # AAC at 160 kbit/s
    assert rate_hz == 48000
    assert np.corrcoef(from_file[:shorter], apart[:shorter])[0, 1] > 0.95


def test_a_rolling_shutter_shows_lower_rows_later(tmp_path):
    """With the readout as long as a frame the last row shows the next frame's moment: a turned head is sheared."""
    takes = (TakeSettings(name="nod", kind="pose", duration_s=0.75),)
    pictures = []
    for readout_s in (0.0, 0.1):
        video = MeshVideoSettings(
            width=90,
            height=160,
            sensor=SensorSettings(rolling_shutter_s=readout_s, rolling_shutter_bands=4, read_noise=0, shot_noise=0),
        )
        settings = MeshRehearsalSettings(seed=5, rate_hz=10, takes=takes, video=video)
        rehearse_meshes(settings, tmp_path / str(readout_s))
        with VideoFrames(tmp_path / str(readout_s) / "nod.mp4") as frames:
            pictures.append([frames[k].astype(float) for k in range(len(frames))])
    still, rolling = pictures
    last = np.s_[150:]
    # shoulders keep still, so it is rows of the head that tell: the chin's are read 0.06 s late, the crown's 0.02 s
    moved = [np.abs(still[6][rows] - still[5][rows]).mean() for rows in (np.s_[20:110], last)]
    assert moved[0] > 2 * moved[1]
    towards = [np.abs(rolling[5][20:110] - frames[20:110]).mean() for frames in (still[5], still[6])]
    assert 0.1 * moved[0] < towards[0] < moved[0]
    assert towards[1] < moved[0]


def test_tattoos_show_only_where_asked_for():
    person = mesh_subject(5)
    bare, inked = (look_of(person, tattoos=False, lip_tattoo=on).surface for on in (False, True))
    changed = (bare.look != inked.look).any(axis=1)
    assert not bare.look[:, 3].any()
    assert changed.any()
    # paint apart from ink is the same: one person, photographed twice
    np.testing.assert_array_equal(bare.look[:, [0, 1, 2, 4, 5, 6]], inked.look[:, [0, 1, 2, 4, 5, 6]])
    assert [take.lips_tattooed for take in map(_take, ("lips", "speech"), (None, None))] == [True, False]
    assert [take.lips_tattooed for take in map(_take, ("lips", "speech"), (False, True))] == [False, True]


def _take(kind, lip_tattoo):
    return TakeSettings(name="take", kind=kind, lip_tattoo=lip_tattoo)
