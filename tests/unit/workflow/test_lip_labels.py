"""`headcap lip-labels`: begun from what a video shows, shown, and learnt from, as commands."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from headcap.calibration.result import save_cameras
from headcap.cameras import Camera, Rig
from headcap.cli import main
from headcap.geometry.transforms import from_vector
from headcap.heads import procedural_model
from headcap.lips.artifact import LipRegressor
from headcap.lips.contours import (
    AugmentationSettings,
    BoostingSettings,
    ContourSequence,
    ContourSettings,
    LipExample,
    MouthLocator,
    SearchSettings,
    load_labels,
    train_detector,
)
from headcap.lips.features import LipFeatures
from headcap.lips.kit import LipKit
from headcap.lips.mesh_contours import MeshContours
from headcap.lips.monocular import FrameState, MonocularSettings, MonocularTrack
from headcap.lips.regression import LipTake, RegressionSettings, train_regression
from headcap.lips.takes import MouthSpace
from headcap.recordings.writer import write_video

FRAMES, LOST, SIZE = 6, 2, (320, 400)
SETTINGS = ContourSettings(
    eye_distance_px=64.0,
    features=80,
    boosting=BoostingSettings(trees=8, depth=3),
    augmentation=AugmentationSettings(copies=1, strength=0.0),
)


def painted(contours) -> np.ndarray:
    """Lips and the mouth's inside on skin, RGB."""
    picture = np.full((SIZE[1], SIZE[0], 3), (170, 125, 95), np.uint8)
    for ring, colour in ((contours.outer, (165, 80, 80)), (contours.inner, (40, 20, 25))):
        cv2.fillPoly(picture, [np.rint(16 * ring).astype(np.int32)], colour, cv2.LINE_AA, 4)
        cv2.polylines(picture, [np.rint(16 * ring).astype(np.int32)], True, colour, 2, cv2.LINE_AA, 4)
    return picture


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A video, lips.npz, and what `headcap lips` writes of the two: a head that opens its mouth, lost in one frame."""
    out = tmp_path_factory.mktemp("labels")
    model = procedural_model(shapes=4, expressions=6)
    space = MouthSpace.of(model)
    jaw = np.zeros((FRAMES, 3))
    jaw[:, 0] = np.linspace(0.05, 0.3, FRAMES)
    expression, placement = np.zeros((FRAMES, 6)), np.tile(from_vector(np.zeros(6)), (FRAMES, 1, 1))
    for array in (jaw, expression, placement):
        array[LOST] = np.nan
    states = tuple(FrameState.LOST if k == LOST else FrameState.TRACKED for k in range(FRAMES))
    nothing = np.zeros(FRAMES)
    track = MonocularTrack(
        model.digest,
        np.arange(FRAMES) / 25,
        states,
        np.zeros(4),
        expression,
        jaw,
        placement,
        focal_ratio=1.0,
        light=np.zeros((FRAMES, 3, 9)),
        residual=nothing,
        inliers=nothing,
        correlation=nothing,
        layer=np.zeros(model.vertices.shape),
    )
    pose = np.array([[1, 0, 0, 0], [0, -1, 0, -0.05], [0, 0, -1, 0.7], [0, 0, 0, 1.0]])
    camera = Camera("front", *SIZE, np.array([[600, 0, 159.5], [0, 600, 199.5], [0, 0, 1.0]]), np.zeros(5), pose)
    see = MeshContours.of(np.asarray(model.vertices, float), space.mouth, model.regions)
    meshes = [np.asarray(mesh, float) for mesh in track.meshes(model)]
    contours = [None if k == LOST else see(mesh, camera) for k, mesh in enumerate(meshes)]
    pictures = [painted(contours[k if k != LOST else 0]) for k in range(FRAMES)]
    write_video(out / "clip.mp4", enumerate(pictures), SIZE, 25.0)
    (out / "tracked").mkdir()
    track.save(out / "tracked" / "track.npz")
    save_cameras(out / "tracked" / "camera.json", Rig((camera,)))
    locate = MouthLocator.of(space.mouth, space.features)
    examples = [
        LipExample(pictures[k][..., ::-1].copy(), locate(meshes[k], camera), contours[k], "one").cropped() for k in (0, 5)
    ]
    random = np.random.default_rng(4)
    takes = [
        LipTake("one", name, LipFeatures(random.normal(size=(8, 2)), random.normal(size=(8, 20))), random.normal(size=(8, 3, 9)))
        for name in ("a", "b")
    ]
    regressor = LipRegressor(
        model.digest,
        model.topology_digest,
        ("one",),
        RegressionSettings(every=2, folds=2),
        space.settings,
        space.mouth.layer,
        "kept",
        False,
        True,
        space.features,
        train_regression(takes, RegressionSettings(every=2, folds=2)),
    )
    LipKit(model, train_detector(examples, SETTINGS), regressor, MonocularSettings(), SearchSettings()).save(out / "lips.npz")
    return out


def command(folder, verb, *arguments) -> list[str]:
    """Arguments; those with a letter that are no option are names in the folder."""
    given = [folder / word if word[0].isalpha() else word for word in arguments]
    kit = [] if verb == "show" else ["--regressor", folder / "lips.npz", "--tracked", folder / "tracked"]
    return ["lip-labels", verb, *map(str, (folder / "clip.mp4", *given, *kit))]


def test_labels_are_begun_shown_and_learnt_from(folder, capsys):
    assert main(command(folder, "begin", "--out", "labels.json")) == 0
    told = capsys.readouterr().out
    assert "5 frames to correct: 0, 1, 3, 4, 5" in told
    assert "where the base track has the lips, no contours being found: 0, 1, 3, 4, 5" in told
    labels = load_labels(folder / "labels.json")
    assert sorted(labels) == [0, 1, 3, 4, 5]
    # an opening mouth: the labels follow it
    heights = [np.ptp(labels[k].inner[:, 1]) for k in sorted(labels)]
    assert (np.diff(heights) > 0).all()
    assert main(command(folder, "show", "labels.json", "--out", "shown")) == 0
    assert "5 labelled frames, nothing wrong with them" in capsys.readouterr().out
    assert cv2.imread(str(folder / "shown" / "labels.png")).shape == (480, 1280, 3)
    assert sorted(path.name for path in (folder / "shown").iterdir()) == [
        *(f"frame_{k:06d}.png" for k in (0, 1, 3, 4, 5)),
        "labels.png",
    ]
    assert main(command(folder, "adapt", "labels.json", "--out", "adapted.npz")) == 0
    told = capsys.readouterr().out
    assert "5 of 5 labelled frames learnt from, nothing wrong with them" in told
    assert "after, in frames left out of it: found in" in told
    before, after = (LipKit.load(folder / name) for name in ("lips.npz", "adapted.npz"))
    assert after.detector.persons == ("clip", "one")
    for key, known in before.detector.classifiers.items():
        # boosting goes on from what was known
        grown = after.detector.classifiers[key].trees
        assert len(grown.value) > len(known.trees.value)
        np.testing.assert_array_equal(grown.value[: len(known.trees.value)], known.trees.value)
    assert (folder / "adapted.npz.manifest.json").exists()


def test_an_editor_s_folder_begins_at_what_was_found(folder, capsys):
    angle = np.pi + 2 * np.pi * np.arange(72) / 72
    ring = np.stack([160 + 30 * np.cos(angle), 200 + 12 * np.sin(angle)], axis=1)
    outer = np.full((FRAMES, 72, 2), np.nan, np.float32)
    outer[4] = ring
    found = ContourSequence(outer, outer, np.ones((FRAMES, 2), np.float32))
    found.save(folder / "tracked" / "contours.npz")
    assert main(command(folder, "begin", "--frames", "5,4,2", "--out", "edit")) == 0
    (folder / "tracked" / "contours.npz").unlink()
    told = capsys.readouterr().out
    assert "2 frames to correct: 4, 5" in told
    assert "no contours being found: 5" in told
    assert "left out, the face being lost there: 2" in told
    labels = load_labels(folder / "edit")
    assert sorted(labels) == [4, 5]
    np.testing.assert_allclose(np.linalg.norm((labels[4].outer - [160, 200]) / [30, 12], axis=1), 1, atol=0.01)
    assert cv2.imread(str(folder / "edit" / "frame_000005.png")).shape == (SIZE[1], SIZE[0], 3)
    assert main(command(folder, "show", "edit", "--out", "shown_edit")) == 0


def test_what_does_not_fit_is_told(folder, capsys):
    square = [[0, 0], [9, 0], [9, 9]]
    (folder / "late.json").write_text(json.dumps({"frames": [{"frame": 99, "outer": square, "inner": square}]}))
    short = replace(MonocularTrack.load(folder / "tracked" / "track.npz"), time_s=np.arange(3.0))
    (folder / "other").mkdir()
    short.save(folder / "other" / "track.npz")
    (folder / "other" / "camera.json").write_bytes((folder / "tracked" / "camera.json").read_bytes())
    other = [*command(folder, "begin", "--out", "x.json")[:-1], str(folder / "other")]
    for arguments, message in (
        (command(folder, "show", "late.json", "--out", "x"), "none of them of clip.mp4"),
        (command(folder, "adapt", "late.json", "--out", "x.npz"), "labels of frame 99"),
        (command(folder, "begin", "--frames", "2", "--out", "x.json"), "followed in none of frames 2"),
        (command(folder, "begin", "--frames", "7", "--out", "x.json"), "frame 7 of a video of 6"),
        (other, "holds a track of 3 frames"),
    ):
        assert main(arguments) == 1
        assert message in capsys.readouterr().err
    assert not (folder / "x.json").exists()


def test_another_tracker_s_meshes_need_their_camera_and_show_in_it(folder, capsys):
    given = ["lips", folder / "clip.mp4", "--regressor", folder / "lips.npz", "--base-track", folder / "aside.npy"]
    given = [str(word) for word in (*given, "--out", folder / "x")]
    assert main(given) == 1
    assert "1 videos and no camera; expected one video, and --camera" in capsys.readouterr().err
    kit = LipKit.load(folder / "lips.npz")
    aside = np.asarray(kit.head.vertices)[None].repeat(FRAMES, axis=0) + np.array([9.0, 0, 0])
    np.save(folder / "aside.npy", aside)
    assert main([*given, "--camera", str(folder / "tracked" / "camera.json")]) == 1
    assert "in no frame does the mouth lie in the picture" in capsys.readouterr().err
    assert not (folder / "x").exists()
