"""`headcap lips` from videos to a page: a rehearsed person with a small kit of their own, and a video that shows nobody."""

import shutil
from pathlib import Path

import av
import numpy as np
import pytest

from headcap.artifacts.provenance import provenance_tree
from headcap.calibration.result import load_camera
from headcap.cli import main
from headcap.errors import InputError
from headcap.evaluation.lip_clip import CORRECTED, LipClip
from headcap.evaluation.metrics import load_metrics
from headcap.heads import procedural_model
from headcap.lips.clips import video_clip
from headcap.lips.contours import ContourSettings, MouthLocator, SearchSettings, mesh_examples, train_detector
from headcap.lips.contours.settings import BoostingSettings
from headcap.lips.correction import TrueNeutral
from headcap.lips.kit import LipKit
from headcap.lips.mesh_contours import MeshContours
from headcap.lips.monocular import FrameState, MonocularSettings, MonocularTrack
from headcap.lips.monocular.shading import ShadingSettings
from headcap.lips.people import LipPerson, LipPersonTake
from headcap.lips.regression import RegressionSettings
from headcap.lips.takes import MouthSpace, SeenTake
from headcap.lips.training import LipTrainingSettings, RegressorPlan, train_lips
from headcap.recordings.writer import write_video
from headcap.registration.sequence import MeshSequence
from headcap.synthetic.mesh_files import rehearse_meshes
from headcap.synthetic.settings import MeshRehearsalSettings, TakeSettings
from headcap.workflow.lips import lip_requests

FRAMES, SIZE = 6, {"width": 270, "height": 480}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Videos `anna.mp4`, with words beside it, and `wall.mp4`; `lips.npz` that has learnt from anna."""
    folder = tmp_path_factory.mktemp("lips")
    take = TakeSettings(name="anna", kind="lips", duration_s=FRAMES / 8, lip_tattoo=False, lip_shapes=("jaw_open",))
    rehearse_meshes(MeshRehearsalSettings(seed=31, rate_hz=8, takes=(take,), video=SIZE), folder)
    grey = np.full((SIZE["height"], SIZE["width"], 3), 120, np.uint8)
    write_video(folder / "wall.mp4", ((k, grey) for k in range(3)), (SIZE["width"], SIZE["height"]), 8.0)
    (folder / "anna.align").write_text("0.1 0.4 map\n0.4 0.7 open\n")
    _kit(folder).save(folder / "lips.npz")
    return folder


def _kit(folder: Path) -> LipKit:
    space = MouthSpace.of(procedural_model())
    clip, truth = video_clip(folder / "anna.mp4", load_camera(folder / "camera.json")), MeshSequence.load(folder / "anna.json")
    see = MeshContours.of(np.asarray(space.model.vertices, float), space.mouth, space.model.regions)
    meshes = np.array(truth.positions(), float)
    examples = mesh_examples("anna", clip.pictures(), meshes, clip.camera, see, MouthLocator.of(space.mouth, space.features))
    detector = train_detector(examples[::2], ContourSettings(boosting=BoostingSettings(trees=12)))
    seen = SeenTake.of(space, _still_track(space), clip.camera, [see(mesh, clip.camera) for mesh in meshes])
    true = TrueNeutral.of(seen.neutral, space.mouth.steady)
    learnt = LipPersonTake("lips", seen, truth.time_s, true, truth, np.arange(FRAMES))
    person = LipPerson("anna", meshes[0], {"anna": learnt})
    settings = LipTrainingSettings(test_takes=("none",), regression=RegressionSettings(every=2, folds=2))
    regressor = train_lips(space, [person], RegressorPlan("generic", "GR", ("anna",)), settings)
    return LipKit(space.model, detector, regressor, MonocularSettings(), SearchSettings())


def _still_track(space: MouthSpace) -> MonocularTrack:
    """What a tracker that sees nothing move would make of anna: the head model at rest."""
    model, nothing = space.model, np.zeros(FRAMES)
    return MonocularTrack(
        model.digest,
        np.arange(FRAMES) / 8,
        (FrameState.TRACKED,) * FRAMES,
        np.zeros(len(model.shape_basis)),
        np.zeros((FRAMES, len(model.expression_basis))),
        np.zeros((FRAMES, 3)),
        np.tile(np.eye(4), (FRAMES, 1, 1)),
        1.0,
        np.zeros((FRAMES, 3, 9)),
        nothing,
        nothing,
        nothing,
        np.zeros(model.vertices.shape),
    )


@pytest.fixture(scope="module")
def done(folder) -> tuple[int, Path]:
    videos = [str(folder / f"{name}.mp4") for name in ("anna", "wall")]
    status = main(["lips", *videos, "--regressor", str(folder / "lips.npz"), "--detail", "--out", str(folder / "out")])
    return status, folder / "out"


def test_what_has_a_face_is_answered_and_what_has_none_is_named(done):
    status, out = done
    assert status == 1
    page = (out / "lips.html").read_text()
    assert "wall" in page
    assert page.count("<video") == 1
    clip = LipClip.load(out / "anna/clip.npz")
    assert len(clip) == FRAMES
    assert np.isfinite(clip.gap(CORRECTED)).any()
    # the words beside the video: m and p of map, p of open
    assert [closure.sound for closure in clip.closures] == ["m", "p", "p"]
    figures = {figure.name: figure for figure in load_metrics(out / "metrics.json")}
    assert figures["lips.photometric_residual"].session == "anna"
    assert figures["lips.photometric_residual"].value == pytest.approx(np.nanmedian(clip.residual))
    assert "lips.closures_shown_pct" in figures


def test_the_overlay_shows_every_frame(done):
    with av.open(str(done[1] / "anna/overlay.mp4")) as container:
        stream = container.streams.video[0]
        pictures = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        assert stream.codec_context.name == "h264"
    assert len(pictures) == FRAMES
    panel = pictures[0].shape[1] // 4
    # meshes lie over the first two panels and not over the third
    drawn, plain = pictures[0][30:, :panel].astype(float), pictures[0][30:, 2 * panel : 3 * panel]
    assert np.abs(drawn - plain[:, : drawn.shape[1]]).mean() > 10


def test_detail_lies_on_the_skin_and_begins_with_none(done):
    plain, fine = (np.asarray(MeshSequence.load(done[1] / f"anna/{name}.json").positions()) for name in ("corrected", "detailed"))
    np.testing.assert_array_equal(np.isfinite(fine), np.isfinite(plain))
    answered = np.flatnonzero(np.isfinite(plain).all(axis=(1, 2)))
    moved_mm = 1e3 * np.linalg.norm(fine - plain, axis=2)[answered]
    # the first answered frame paints the skin; what is left is rounding of single precision meshes
    assert moved_mm[0].max() < 2e-3
    assert 0.0 < moved_mm[1:].max() < 10 * ShadingSettings().depth_mm
    model = procedural_model()
    assert moved_mm[:, ~(model.regions["face"] | model.regions["lips_upper"] | model.regions["lips_lower"])].max() < 2e-3


def test_another_trackers_track_takes_nothing_of_our_own(folder, tmp_path, capsys):
    given = ["lips", str(folder / "anna.mp4"), "--regressor", str(folder / "lips.npz"), "--out", str(tmp_path)]
    assert main([*given, "--base-track", "x.npz", "--detail"]) == 1
    assert "--detail with --base-track" in capsys.readouterr().err


def test_provenance_leads_to_video_kit_and_words(done, folder):
    tree = "\n".join(provenance_tree(done[1] / "anna/corrected.json"))
    assert "CHANGED" not in tree
    for name in ("anna.mp4", "lips.npz"):
        assert name in tree


def test_nobody_in_any_video_is_an_error_and_writes_no_page(folder, tmp_path, capsys):
    for name in ("one", "two"):
        shutil.copy(folder / "wall.mp4", tmp_path / f"{name}.mp4")
    videos = [str(tmp_path / f"{name}.mp4") for name in ("one", "two")]
    assert main(["lips", *videos, "--regressor", str(folder / "lips.npz"), "--out", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err.count("face") >= 2
    assert not (tmp_path / "out/lips.html").exists()


def test_words_find_their_videos_by_name():
    videos, kit = [Path("a/one.mp4"), Path("a/two.mp4")], Path("lips.npz")
    asked = lip_requests(videos, kit, words=[Path("b/two.align")])
    assert [request.words for request in asked] == [None, Path("b/two.align")]
    assert lip_requests(videos[:1], kit, words=[Path("b/said.txt")])[0].words == Path("b/said.txt")
    with pytest.raises(InputError, match="words of three"):
        lip_requests(videos, kit, words=[Path("b/three.align")])
    with pytest.raises(InputError, match="more videos than there are"):
        lip_requests(videos[:1], kit, words=[Path("one.align"), Path("c/one.align")])
    with pytest.raises(InputError, match="landmarks for 2 videos"):
        lip_requests(videos, kit, detections=Path("points.json"))


def test_videos_of_one_name_are_refused(folder, tmp_path, capsys):
    videos = [str(folder / "anna.mp4"), str(tmp_path / "anna.mp4")]
    assert main(["lips", *videos, "--regressor", str(folder / "lips.npz"), "--out", str(tmp_path / "out")]) == 1
    assert "anna, anna" in capsys.readouterr().err
