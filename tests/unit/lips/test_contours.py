"""The detector as a whole on painted mouths: contours that were painted are found, none is made up, little training adapts."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from headcap.artifacts import ArtifactError
from headcap.errors import InputError
from headcap.geometry.transforms import fit_rigid, transform
from headcap.lips.contours import (
    AugmentationSettings,
    BoostingSettings,
    ContourDetector,
    ContourFinder,
    ContourSequence,
    ContourSettings,
    LipExample,
    MouthLocator,
    SearchSettings,
    adapt_detector,
    agreement,
    draw_contours,
    draw_labels,
    find_contours,
    held_out_agreement,
    labelled_examples,
    load_labels,
    mesh_examples,
    save_labels,
    train_detector,
)
from headcap.lips.contours.adapting import contour_gaps_px
from headcap.lips.contours.boosting import log_loss
from headcap.lips.contours.training import _mirrored, gather_samples
from headcap.lips.contours.window import mouth_window
from headcap.lips.features import LipContours
from headcap.synthetic.mesh_takes import mesh_subject

SETTINGS = ContourSettings(
    boosting=BoostingSettings(trees=30, depth=4),
    augmentation=AugmentationSettings(copies=2, strength=0.5),
)
LINE_PX = 2
"""Width of the dark line between lips that touch; a flat contour may not open by more."""
SKIN, LIPS, MOUTH = np.array([95, 125, 170.0]), np.array([90, 90, 165.0]), np.array([25, 20, 40.0])


def painted(contours, size, rng, lips=LIPS):
    """A picture of skin, lips and the mouth's inside within contours, with shading, a blur and noise."""
    picture = np.tile(SKIN, (size[1], size[0], 1))
    for ring, colour in ((contours.outer, lips), (contours.inner, MOUTH)):
        cv2.fillPoly(picture, [np.rint(16 * ring).astype(np.int32)], colour.tolist(), cv2.LINE_AA, 4)
    # lips that touch show a dark line
    cv2.polylines(picture, [np.rint(16 * contours.inner).astype(np.int32)], True, MOUTH.tolist(), LINE_PX, cv2.LINE_AA, 4)
    shade = cv2.resize(rng.normal(size=(4, 4)), size, interpolation=cv2.INTER_CUBIC)[..., None]
    picture = cv2.GaussianBlur(picture * np.exp(0.08 * shade), (0, 0), 1.0)
    return np.clip(picture + rng.normal(scale=2.0, size=picture.shape), 0, 255).astype(np.uint8)


class Booth:
    """Painted frames of rehearsed people before the stage's camera."""

    def __init__(self, stage):
        self.stage, self.locate = stage, MouthLocator.of(stage.mouth, stage.space)

    def frames(self, seed, count, lips=LIPS):
        """Pictures, meshes, contours of a lip take, and the person's neutral mesh."""
        subject, rng = mesh_subject(seed), np.random.default_rng(seed)
        meshes = subject.take("lips", 3 * count + 14, 12.0).meshes[14::3].astype(float)[:count]
        contours = [self.stage.see(mesh, self.stage.camera) for mesh in meshes]
        return [painted(c, self.stage.camera.size, rng, lips) for c in contours], meshes, contours, subject.neutral_m

    def examples(self, seed, count, lips=LIPS):
        pictures, meshes, contours, _ = self.frames(seed, count, lips)
        views = [self.locate(mesh, self.stage.camera) for mesh in meshes]
        return [LipExample(p, v, c, str(seed)).cropped() for p, v, c in zip(pictures, views, contours, strict=True)]


@pytest.fixture(scope="module")
def booth(stage):
    return Booth(stage)


@pytest.fixture(scope="module")
def detector(booth):
    return train_detector([*booth.examples(61, 6), *booth.examples(62, 6)], SETTINGS)


@pytest.fixture(scope="module")
def finder(booth, detector):
    return ContourFinder(detector, booth.locate)


@pytest.fixture(scope="module")
def stranger(booth):
    return booth.frames(63, 5)


def distance(found, truth):
    """Mean distance in pixels of the points of a ring to another's sides."""
    start, side = np.roll(truth, 1, axis=0), truth - np.roll(truth, 1, axis=0)
    share = ((found[:, None] - start) * side).sum(axis=2) / np.maximum((side**2).sum(axis=1), 1e-12)
    nearest = start + np.clip(share, 0, 1)[..., None] * side
    return np.linalg.norm(found[:, None] - nearest, axis=2).min(axis=1).mean()


def half_moved(stage, neutral, mesh):
    """A base tracker's mesh that follows the head, sees half of the expression and has the mouth 2 mm aside."""
    held = stage.mouth.steady
    unmoved = transform(fit_rigid(neutral[held], mesh[held]), neutral)
    return 0.5 * (unmoved + mesh) + np.array([0.002, -0.001, 0.0])


def test_a_strangers_contours_are_found_from_a_base_that_misses_them(stage, finder, stranger):
    pictures, meshes, contours, neutral = stranger
    errors = []
    for picture, mesh, truth in zip(pictures, meshes, contours, strict=True):
        base = half_moved(stage, neutral, mesh)
        found = finder(picture, base, stage.camera)
        assert found.contours is not None
        assert min(found.confidence) > 0.8
        start = stage.see(base, stage.camera)
        errors.append(
            [[distance(rings.outer, truth.outer), distance(rings.inner, truth.inner)] for rings in (found.contours, start)]
        )
    errors = np.mean(errors, axis=0)
    # one pixel of the window is 0.56 mm, 0.9 pixels of this camera; the search's places are half of it apart
    assert errors[0].max() < 1.5
    assert (errors[0] < 0.4 * errors[1]).all()


def test_a_shut_mouth_gives_a_flat_ring_and_an_open_one_does_not(stage, booth, finder):
    subject, rng = mesh_subject(64), np.random.default_rng(1)
    shut = subject.neutral_m
    wide = subject.mesh({**_at_rest(), "jaw": 0.9})
    openings = []
    for mesh in (shut, wide):
        truth = stage.see(mesh, stage.camera)
        picture = painted(truth, stage.camera.size, rng)
        ring = finder(picture, mesh, stage.camera).contours.inner
        half = len(ring) // 2
        openings.append((ring[half:][::-1, 1] - ring[:half, 1]).mean())
        assert distance(ring, truth.inner) < 2.0
    assert openings[0] < LINE_PX
    assert openings[1] > 10.0


def _at_rest():
    from headcap.synthetic.subject import AT_REST

    return dict(AT_REST)


def test_contours_move_with_the_picture(stage, finder, stranger):
    """A camera of half the resolution, turned on its side, sees the same contours in its own pixels."""
    pictures, meshes, *_ = stranger
    found = finder(pictures[0], meshes[0], stage.camera).contours
    half = cv2.resize(pictures[0], None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    smaller = finder(half, meshes[0], stage.camera.scaled(0.5)).contours
    np.testing.assert_allclose(distance(2 * smaller.outer + 0.5, found.outer), 0, atol=1.0)
    np.testing.assert_allclose(distance(2 * smaller.inner + 0.5, found.inner), 0, atol=1.0)
    side = np.ascontiguousarray(np.rot90(pictures[0], -1))
    turn = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    own = stage.camera
    matrix = np.array(
        [[own.matrix[1, 1], 0, own.height - 1 - own.matrix[1, 2]], [0, own.matrix[0, 0], own.matrix[0, 2]], [0, 0, 1]]
    )
    rolled = replace(own, width=own.height, height=own.width, matrix=matrix, camera_from_world=turn @ own.camera_from_world)
    turned = finder(side, meshes[0], rolled).contours
    back = np.stack([turned.outer[:, 1], own.height - 1 - turned.outer[:, 0]], axis=1)
    assert distance(back, found.outer) < 0.5


def test_no_contour_is_made_up(stage, finder, stranger, rng):
    pictures, meshes, *_ = stranger
    blank = painted(LipContours(np.zeros((3, 2)), np.zeros((3, 2))), stage.camera.size, rng)
    nothing = finder(blank, meshes[0], stage.camera)
    assert nothing.contours is None
    assert min(nothing.confidence) < SearchSettings().least_share
    assert finder(pictures[0], np.full_like(meshes[0], np.nan), stage.camera).contours is None
    aside = finder(pictures[0], meshes[0] + np.array([0.18, 0, 0]), stage.camera)
    assert aside.contours is None
    assert aside.confidence == (0.0, 0.0)


def test_a_video_in_a_file(stage, finder, stranger, tmp_path):
    pictures, meshes, *_ = stranger
    lost = meshes.copy()
    lost[1] = np.nan
    found = find_contours(finder, iter(pictures), iter(lost), stage.camera)
    assert found.found.tolist() == [True, False, True, True, True]
    rings = found.contours()
    assert rings[1] is None
    np.testing.assert_allclose(rings[2].outer, finder(pictures[2], meshes[2], stage.camera).contours.outer, atol=1e-3)
    found.save(tmp_path / "contours.npz")
    again = ContourSequence.load(tmp_path / "contours.npz")
    np.testing.assert_array_equal(again.inner, found.inner)
    with pytest.raises(InputError, match="fewer pictures"):
        find_contours(finder, pictures[:2], meshes, stage.camera)
    with pytest.raises(InputError, match="more pictures"):
        find_contours(finder, pictures, meshes[:2], stage.camera)
    with pytest.raises(InputError, match="a picture"):
        finder(pictures[0][::2, ::2], meshes[0], stage.camera)
    with pytest.raises(ArtifactError, match="lip_contours"):
        ContourDetector.load(tmp_path / "contours.npz")


def test_a_saved_detector_answers_the_same(stage, detector, booth, stranger, tmp_path):
    detector.save(tmp_path / "detector.npz")
    again = ContourDetector.load(tmp_path / "detector.npz")
    assert (again.settings, again.persons, again.figures) == (detector.settings, ("61", "62"), detector.figures)
    window = detector.window(stranger[0][0], booth.locate(stranger[1][0], stage.camera))
    for which in ("outer", "inner"):
        np.testing.assert_array_equal(again.maps(window).fine[which], detector.maps(window).fine[which])


def test_the_coarse_pass_spares_the_fine_one_work_and_no_contour(stage, detector, booth, stranger):
    pictures, meshes, contours, _ = stranger
    window = detector.window(pictures[0], booth.locate(meshes[0], stage.camera))
    careful = detector.maps(window, SearchSettings(coarse_log_odds=-1e9))
    quick = detector.maps(window)
    for which in ("outer", "inner"):
        looked = quick.fine[which] != -6.0
        np.testing.assert_array_equal(quick.fine[which][looked], careful.fine[which][looked])
        assert looked.mean() < 0.6 * (careful.fine[which] != -6.0).mean()
        ring = np.rint(window.from_picture(getattr(contours[0], which))).astype(int)
        assert looked[ring[:, 1], ring[:, 0]].mean() > 0.9


def test_a_handful_of_labels_adapts_a_detector(detector, booth):
    """Lips as pale as skin and bluish, which training did not show."""
    blue = np.array([175, 130, 150.0])
    few, others = booth.examples(65, 4, blue), booth.examples(66, 4, blue)
    adapted = adapt_detector(detector, few, trees=15)
    assert adapted.persons == ("61", "62", "65")
    plain = replace(detector, settings=SETTINGS.model_copy(update={"augmentation": AugmentationSettings(copies=1, strength=0)}))
    before, after = [], []
    for which in ("coarse", "fine"):
        pools = {contour: adapted.classifiers[contour, which].pool for contour in ("outer", "inner")}
        values, shows, _ = gather_samples(plain, which, others, pools)["outer"]
        before.append(log_loss(detector.classifiers["outer", which].trees(values), shows))
        after.append(log_loss(adapted.classifiers["outer", which].trees(values), shows))
    assert (np.array(after) < 0.7 * np.array(before)).all()
    with pytest.raises(InputError, match="no labelled picture"):
        adapt_detector(detector, [])


def test_what_labels_teach_is_told_on_frames_left_out(booth, detector, finder):
    """Lips of another colour again: what a detector finds there before, and after it has learnt from the other frames."""
    examples = booth.examples(67, 6, np.array([175, 130, 150.0]))
    before, after = agreement(finder, examples), held_out_agreement(finder, examples)
    # before, skin's shading is taken for the outer contour: four of six lie ten pixels off
    assert after.found.all()
    assert np.median(after.outer_px) < 0.5 * np.nanmedian(before.outer_px)
    # by halves: what it says of the first half is what a detector taught by the second finds there
    taught = replace(finder, detector=adapt_detector(detector, examples[1::2]))
    np.testing.assert_array_equal(agreement(taught, examples[::2]).inner_px, after.inner_px[::2])
    assert f"found in {int(after.found.sum())} of 6, outer {np.nanmedian(after.outer_px):.2f} px" in str(after)
    assert held_out_agreement(finder, examples[:1]) is None


def test_gaps_are_distances_of_labels_from_what_was_found(booth):
    contours = booth.examples(61, 1)[0].contours
    moved = LipContours(contours.outer, contours.inner[::3])
    outer, inner = contour_gaps_px(contours, moved)
    # the found ring is walked in steps of 0.1 px
    assert max(outer, inner) < 0.051
    square = np.array([[0.0, 0], [40, 0], [40, 40], [0, 40]])
    outer, inner = contour_gaps_px(LipContours(square, square), LipContours(square - np.array([0, 3.0]), square * 0.5 + 10))
    # the upper corners are 3 px above the square, the lower ones still lie on its sides
    assert outer == pytest.approx(1.5, abs=0.05)
    assert inner == pytest.approx(10, abs=0.05)
    assert np.isnan(contour_gaps_px(None, contours)).all()


def test_examples_of_tracked_meshes_and_of_labels_by_hand(stage, booth, stranger, tmp_path):
    pictures, meshes, contours, _ = stranger
    lost = [*meshes[:3], None, np.full_like(meshes[0], np.nan)]
    told = mesh_examples("63", pictures, lost, stage.camera, stage.see, booth.locate)
    assert len(told) == 3
    save_labels(tmp_path / "lips.json", {1: contours[1], 4: contours[4]})
    labels = load_labels(tmp_path / "lips.json")
    drawn = labelled_examples("63", pictures, labels, meshes, stage.camera, booth.locate)
    assert len(drawn) == 2
    # a crop moves picture, mouth and contours alike
    for one, other in ((told[1], drawn[0]),):
        np.testing.assert_array_equal(one.picture, other.picture)
        np.testing.assert_allclose(one.contours.inner, other.contours.inner, atol=0.01)  # written with two digits
    example, low = told[1], contours[1].outer[0] - told[1].contours.outer[0]
    np.testing.assert_array_equal(low, np.rint(low))
    x, y = low.astype(int)
    height, width = example.picture.shape[:2]
    np.testing.assert_array_equal(example.picture, pictures[1][y : y + height, x : x + width])
    assert height < stage.camera.height
    np.testing.assert_allclose(example.view.border + low, booth.locate(meshes[1], stage.camera).border)
    assert labelled_examples("63", pictures, {4: contours[4]}, [*meshes[:4], lost[4]], stage.camera, booth.locate) == []
    with pytest.raises(InputError, match="frame 9"):
        labelled_examples("63", pictures, {9: contours[0]}, meshes, stage.camera, booth.locate)
    with pytest.raises(InputError, match="fewer pictures"):
        mesh_examples("63", pictures[:4], meshes, stage.camera, stage.see, booth.locate)


def test_windows_map_there_and_back(stage, booth, stranger, rng):
    pictures, meshes, *_ = stranger
    view = booth.locate(meshes[0], stage.camera)
    for window in (mouth_window(pictures[0], view, 112.0, 11.0, 26), mouth_window(pictures[0], view, 112.0, 11.0).halved()):
        points = rng.uniform(0, 900, (5, 2))
        np.testing.assert_allclose(window.to_picture(window.from_picture(points)), points, atol=1e-9)
    # the eyes of a turned head are as far apart as those of one that looks at the camera
    turned = booth.locate(stage.turned(meshes[:1] - meshes[0].mean(axis=0), 35.0)[0] + meshes[0].mean(axis=0), stage.camera)
    assert turned.eye_distance_px == pytest.approx(view.eye_distance_px, rel=0.02)  # it comes a little nearer
    assert np.ptp(turned.border[:, 0]) < 0.95 * np.ptp(view.border[:, 0])


def test_a_mirrored_example_is_what_a_mirrored_mesh_would_show(stage, booth):
    example = booth.examples(61, 1)[0]
    mirrored = _mirrored(example)
    width = example.picture.shape[1]
    corner, left = mirrored.view.border[0], mirrored.view.border[mirrored.view.left]
    np.testing.assert_allclose(corner, np.array([width - 1, 0]) + [-1, 1] * example.view.border[example.view.left])
    assert (left - corner) @ mirrored.view.across > 0
    assert mirrored.view.border[1 : mirrored.view.left, 1].mean() < mirrored.view.border[mirrored.view.left + 1 :, 1].mean()
    again = _mirrored(mirrored)
    np.testing.assert_allclose(again.view.border, example.view.border)
    np.testing.assert_array_equal(again.picture, example.picture)


def test_label_files(tmp_path):
    square = np.array([[10.25, 20], [30, 20], [30, 40], [10, 40]])
    labels = {3: LipContours(square, square[:3] + 5), 12: LipContours(square + 1, square)}
    save_labels(tmp_path / "lips.json", labels)
    rows = ["frame,contour,x_px,y_px"]
    for frame, rings in labels.items():
        for name in ("outer", "inner"):
            rows += [f"{frame},{name},{x},{y}" for x, y in getattr(rings, name)]
    (tmp_path / "lips.csv").write_text("\n".join(rows))
    for name in ("lips.json", "lips.csv"):
        found = load_labels(tmp_path / name)
        assert sorted(found) == [3, 12]
        np.testing.assert_allclose(found[3].inner, labels[3].inner)
        np.testing.assert_allclose(found[12].outer, labels[12].outer)
    (tmp_path / "half.json").write_text('{"frames": [{"frame": 1, "outer": [[1, 2], [3, 4], [5, 5]]}]}')
    (tmp_path / "torn.json").write_text('{"frames": [')
    (tmp_path / "lips.txt").write_text("")
    for name, told in (("half.json", "no inner"), ("torn.json", "torn.json"), ("lips.txt", "ends in"), ("none.csv", "none.csv")):
        with pytest.raises(InputError, match=told):
            load_labels(tmp_path / name)


def test_contours_are_drawn_where_they_lie():
    picture = np.zeros((60, 80, 3), np.uint8)
    ring = np.array([[20.0, 20], [60, 20], [60, 40], [20, 40]])
    contours = LipContours(ring, ring[:3] * 0.5 + 20)
    drawn = draw_contours(picture, contours)
    assert drawn[20, 40].argmax() == 1
    assert (drawn[10, 40] == 0).all()
    assert draw_contours(picture, None) is not picture
    assert not draw_contours(picture, None).any()
    dots = draw_labels(picture, contours)
    # a dot at each point, a thin line between
    assert dots[22, 20].any()
    assert dots[20, 40].any()
    assert not dots[22, 40].any()
