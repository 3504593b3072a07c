"""A take as a regressor sees it: from a base track, with and without the person's true neutral head; and the file for a video."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from headcap.calibration.result import load_camera, save_cameras
from headcap.cameras import Camera, Rig
from headcap.errors import InputError
from headcap.geometry.transforms import from_vector, rigid, transform
from headcap.heads import base_head, procedural_model
from headcap.lips.artifact import LipRegressor
from headcap.lips.clips import Clip, frontal_camera
from headcap.lips.contours import ContourDetector, ContourSettings, SearchSettings, save_labels
from headcap.lips.contours.detector import CONTOURS, PASSES
from headcap.lips.correction import TrueNeutral
from headcap.lips.features import LipContours
from headcap.lips.kit import LipKit
from headcap.lips.mesh_contours import MeshContours
from headcap.lips.monocular import FrameState, MonocularSettings, MonocularTrack
from headcap.lips.people import LipPerson, LipPersonTake
from headcap.lips.regression import RegressionSettings
from headcap.lips.takes import MouthSpace, SeenTake, resting_distances
from headcap.lips.training import (
    LipTrainingSettings,
    RegressorPlan,
    common_identity,
    contour_examples,
    planned_regressors,
    regressed,
    spread_frames,
    train_lips,
)
from headcap.registration.sequence import MeshSequence, save_chunk

FRAMES = 12


@pytest.fixture(scope="module")
def space() -> MouthSpace:
    return MouthSpace.of(procedural_model())


@pytest.fixture(scope="module")
def track(space) -> MonocularTrack:
    """A head that nods while it talks; lost in its fourth frame."""
    random, model = np.random.default_rng(3), space.model
    placement = np.stack([from_vector(np.array([0.02 * k, 0.0, 0.0, 0.001 * k, 0.0, 0.0])) for k in range(FRAMES)])
    expression = 0.5 * random.normal(size=(FRAMES, len(model.expression_basis)))
    jaw = np.zeros((FRAMES, 3))
    jaw[:, 0] = 0.1 * (1 - np.cos(np.arange(FRAMES)))
    states = [FrameState.TRACKED] * FRAMES
    states[3] = FrameState.LOST
    for array in (placement, expression, jaw):
        array[3] = np.nan
    nothing = np.zeros(FRAMES)
    shape = 0.5 * random.normal(size=len(model.shape_basis))
    return MonocularTrack(
        model.digest,
        np.arange(FRAMES) / 10,
        tuple(states),
        shape,
        layer=np.zeros(model.vertices.shape),
        expression=expression,
        jaw=jaw,
        placement=placement,
        focal_ratio=1.0,
        light=np.zeros((FRAMES, 3, 9)),
        residual=nothing,
        inliers=nothing,
        correlation=nothing,
    )


@pytest.fixture(scope="module")
def seen(space, track, stage) -> SeenTake:
    see = MeshContours.of(np.asarray(space.model.vertices, float), space.mouth, space.model.regions)
    meshes = np.array(list(track.meshes(space.model)), float)
    contours = [see(mesh, stage.camera) if np.isfinite(mesh).all() else None for mesh in meshes]
    return SeenTake.of(space, track, stage.camera, contours)


def test_where_the_head_is_comes_back(space, track, seen):
    """Canonical meshes put back are the track's; a frame that was lost stays without an answer."""
    meshes = np.array(list(track.meshes(space.model)), float)
    back = seen.base.world(seen.base.meshes)
    known = np.isfinite(meshes).all(axis=(1, 2))
    assert known.sum() == FRAMES - 1
    # meshes are in single precision, at half a metre
    assert np.abs(back[known] - meshes[known]).max() < 1e-6
    assert np.isnan(back[3]).all()
    assert np.isnan(seen.features.distances[3]).all()


def test_a_layer_of_nothing_changes_nothing(seen):
    still = seen.corrected(np.zeros((FRAMES, len(seen.space.mouth.layer), 9)))
    known = [k for k in range(FRAMES) if k != 3]
    # deformation transfer of no deformation: the factorised Poisson equation to rounding
    assert np.abs(still[known] - seen.base.world(seen.base.meshes)[known]).max() < 1e-6


def test_who_knows_the_true_head_starts_from_it_wherever_it_stands(seen):
    """The offset is that of the neutral heads, at the tracker's size; a head's own pose and unit say nothing."""
    true = seen.neutral.copy()
    true[seen.space.mouth.vertices] += [0.0, 0.002, 0.004]
    known = seen.known(true)
    assert np.nanmax(np.abs(known.base.meshes - seen.base.meshes - (true - seen.neutral))) < 1e-9
    moved = transform(from_vector(np.array([0.3, -0.2, 0.1, 0.5, 0.1, -0.4])), 1.1 * true)
    assert np.nanmax(np.abs(seen.known(moved).base.meshes - known.base.meshes)) < 1e-9


def test_a_person_who_is_known_leaves_the_layer_expressions_alone(seen):
    """Truth that moves as the base does, on another neutral head, needs no correction once that head is known."""
    true = seen.neutral.copy()
    true[seen.space.mouth.vertices] += [0.0, 0.001, 0.002]
    known = seen.known(true)
    layer = known.parameters(true, known.base.meshes)
    assert np.nanmax(np.abs(layer)) < 1e-5


def pouting(seen, by_m):
    """The take's neutral head (n, 3) with lips that stand out by so much; nothing moves at the mask's rim."""
    mouth = seen.space.mouth
    away = np.linalg.norm(seen.neutral - seen.neutral[mouth.outline].mean(axis=0), axis=1)
    true = seen.neutral.copy()
    inside = mouth.vertices
    true[inside, 2] += by_m * np.exp(-0.5 * (away[inside] / 0.007) ** 2)
    return true


def test_the_identity_part_turns_the_tracked_neutral_mouth_into_the_true_one(seen):
    """However large and wherever the true head is."""
    true = pouting(seen, 0.003)
    moved = transform(from_vector(np.array([0.3, -0.2, 0.1, 0.5, 0.1, -0.4])), 1.1 * true)
    lacking = seen.identity_difference(moved)
    corrected = seen.layer().corrected(seen.neutral[None], lacking[None])[0]
    lips = seen.space.mouth.outline
    # a Gaussian of 7 mm is 1e-3 where the correction begins to fade, 24 mm away; single precision is less
    assert np.abs(corrected[lips] - true[lips]).max() < 0.02 * 0.003
    assert np.abs(seen.identity_difference(1.2 * seen.neutral)).max() < 1e-6


def person_of(name, seen, neutral):
    true = TrueNeutral.of(neutral, seen.space.mouth.steady)
    take = LipPersonTake("lips", seen, np.arange(FRAMES) / 10, true, None, np.arange(FRAMES))
    return LipPerson(name, neutral, {"one": take})


def test_strangers_start_from_the_trackers_usual_fault_as_far_as_people_share_it(seen):
    """All of it where everybody lacks the same, none where two people contradict each other or there is but one."""
    faults = {"a": 0.002, "b": 0.002, "c": 0.002, "d": -0.002}
    people = {name: person_of(name, seen, pouting(seen, fault)) for name, fault in faults.items()}
    part, share = common_identity([people[name] for name in "abc"])
    assert share == pytest.approx(1.0, abs=0.02)
    np.testing.assert_allclose(part, share * seen.identity_difference(people["a"].neutral), atol=1e-6)
    for others in ("ad", "a"):
        part, share = common_identity([people[name] for name in others])
        assert share == 0.0
        assert not part.any()
    several = [person_of(name, seen, pouting(seen, fault)) for name, fault in (("e", 0.001), ("f", 0.003))]
    # u.v / v.v over both is (1 x 3 + 3 x 1) / (9 + 1)
    assert common_identity(several)[1] == pytest.approx(0.6, abs=0.02)
    assert common_identity(several, 0.25)[1] == 0.25


def test_refuses_contours_of_another_clip(space, track, stage):
    with pytest.raises(InputError, match="contours of 2 frames"):
        SeenTake.of(space, track, stage.camera, [None, None])


def test_takes_without_contours_say_nothing_of_rest(seen):
    bare = replace(seen, contours=(None,) * FRAMES)
    assert np.isnan(resting_distances([bare])).all()
    assert np.isfinite(resting_distances([seen, bare])).all()


@pytest.fixture(scope="module")
def regressor(space, seen, tmp_path_factory) -> LipRegressor:
    """Of one person whose truth smiles a little more than the tracker saw."""
    truth = np.nan_to_num(seen.base.meshes).astype(np.float32)
    folder = tmp_path_factory.mktemp("truth")
    save_chunk(folder / "take.npy", truth)
    sequence = MeshSequence("take", np.arange(FRAMES) / 10, (folder / "take.npy",))
    true = TrueNeutral.of(seen.neutral, space.mouth.steady)
    take = LipPersonTake("lips", seen, sequence.time_s, true, sequence, np.arange(FRAMES))
    person = LipPerson("anna", seen.neutral, {"one": take, "two": take})
    settings = LipTrainingSettings(test_takes=("two",), regression=RegressionSettings(every=2, folds=2))
    generic, own = (
        train_lips(space, [person], RegressorPlan(name, relation, ("anna",)), settings)
        for name, relation in (("generic", "GR"), ("of_anna", "PS"))
    )
    # one frame of each take was lost; strangers are learnt in a mirror too
    assert (generic.regression.figures["frames"], own.regression.figures["frames"]) == (2 * (2 * FRAMES - 2), FRAMES - 1)
    return generic


def test_a_labelled_take_teaches_what_a_hand_drew(space, seen, stage, tmp_path):
    drawn = {k: LipContours(seen.contours[k].outer + 1.0, seen.contours[k].inner) for k in (1, 5)}
    save_labels(tmp_path / "drawn.json", drawn | {3: seen.contours[0]})
    clip = Clip(stage.camera, np.arange(FRAMES) / 10, lambda: iter([np.zeros((960, 540, 3), np.uint8)] * FRAMES))
    truth = list(np.nan_to_num(seen.base.world(seen.base.meshes)))
    known = SimpleNamespace(seen=seen, truth=lambda: truth)
    person = SimpleNamespace(
        name="anna",
        takes=[SimpleNamespace(name=name, clip=SimpleNamespace(open=lambda: clip)) for name in ("one", "two")],
        load=lambda space, contours: SimpleNamespace(takes={"one": known, "two": known}),
    )
    labels = {"anna": {"one": str(tmp_path / "drawn.json")}, "bea": {"two": "nobody asks for this"}}
    settings = LipTrainingSettings(labels=labels, pictures_per_take=1)
    found = contour_examples(person, space, settings)
    # the track lost frame 3; the other take, which nobody has labelled, tells by its mesh
    assert len(found) == 3
    middles = [example.contours.outer - example.view.border[: len(example.contours.outer)] for example in found]
    np.testing.assert_allclose(middles[0], 1.0, atol=0.02)  # written with two digits, a mesh in single precision
    np.testing.assert_allclose(middles[1], 1.0, atol=0.02)
    np.testing.assert_allclose(middles[2], 0.0, atol=0.02)


def test_a_kit_comes_back_from_its_file_as_it_was(space, seen, regressor, tmp_path):
    nothing = {
        f"{contour}/{which}/{name}": array
        for contour in CONTOURS
        for which in PASSES
        for name, array in {
            "channel": np.zeros(1, np.int32),
            "boxes": np.zeros((1, 2, 4), np.int32),
            "feature": np.zeros((1, 1), np.int32),
            "threshold": np.zeros((1, 1), np.float32),
            "value": np.zeros((1, 2), np.float32),
        }.items()
    }
    meta = {"settings": ContourSettings().model_dump(mode="json"), "persons": ["anna"], "figures": {}}
    detector = ContourDetector.from_arrays(nothing, meta)
    kit = LipKit(space.model, detector, regressor, MonocularSettings(expressions=20), SearchSettings(reach_mm=7.0))
    kit.save(tmp_path / "lips.npz")
    back = LipKit.load(tmp_path / "lips.npz")
    assert (back.monocular.expressions, back.search.reach_mm, back.detector.persons) == (20, 7.0, ("anna",))
    assert back.head.digest == space.model.digest
    ours, theirs = (regressed(one.regressor, {"clip": seen})["clip"] for one in (kit, back))
    assert np.array_equal(ours, theirs, equal_nan=True)


def test_cameras_come_back_and_are_asked_for_by_name(stage, tmp_path):
    from headcap.cameras import Rig

    other = replace(stage.camera, name="left")
    save_cameras(tmp_path / "both.json", Rig((stage.camera, other)))
    assert np.array_equal(load_camera(tmp_path / "both.json", "left").matrix, stage.camera.matrix)
    with pytest.raises(InputError, match="front, left"):
        load_camera(tmp_path / "both.json")


def looking(name, yaw_deg, pitch_deg):
    """A camera that sees the origin from so far to the left and above of its z axis."""
    yaw, pitch = np.radians([yaw_deg, pitch_deg])
    out = np.array([np.cos(pitch) * np.sin(yaw), np.sin(pitch), np.cos(pitch) * np.cos(yaw)])
    right = np.cross([0.0, 1.0, 0.0], out) / np.cos(pitch)
    turn = np.stack([right, -np.cross(out, right), -out])
    return Camera(name, 64, 64, np.diag([99.0, 99.0, 1.0]), np.zeros(5), rigid(turn, [0.0, 0.0, 0.9]))


def test_the_frontal_camera_looks_straight_at_the_face_and_not_up_at_the_chin():
    head = base_head()
    cameras = Rig((looking("below", 0, -22), looking("level", -14, 7), looking("side", 35, 0)))
    middle = -head.vertices[head.regions["face"]].mean(axis=0)
    assert frontal_camera(cameras, head.with_vertices(head.vertices + middle)) == "level"
    turned = from_vector(np.array([0.0, np.radians(30.0), 0.0, 0.0, 0.0, 0.0]))
    assert frontal_camera(cameras, head.with_vertices(transform(turned, head.vertices + middle))) == "side"
    # a head whose landmarks have other names is judged by its normals
    unnamed = replace(head.with_vertices(transform(turned, head.vertices + middle)), landmarks={})
    assert frontal_camera(cameras, unnamed) == "side"


def test_regressors_of_one_person_and_of_several():
    assert [plan.name for plan in planned_regressors(["a"])][-1] == "of_a"
    assert "several" not in [plan.name for plan in planned_regressors(["a"])]
    assert {plan.relation for plan in planned_regressors(["a", "b"])} == {"PS", "MS", "GR"}


def test_frames_are_spread_from_the_first_to_the_last():
    assert spread_frames(10, 4) == {0, 3, 6, 9}
    assert spread_frames(3, 12) == {0, 1, 2}
