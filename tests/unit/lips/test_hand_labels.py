"""Lip contours drawn by hand: what is wrong with them is told, an editor's files come back, pictures show them where they lie."""

import json

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.lips.contours import label_faults, label_picture, label_sheet, load_labels, save_labelme, starting_labels
from headcap.lips.contours.label_checks import crossings
from headcap.lips.features import LipContours

SIZE = (200, 160)


def mouth(*, opening: float = 8.0, middle=(100.0, 80.0), places: int = 24) -> LipContours:
    """Ellipses, the inner one from corner to corner and back."""
    angle = np.pi + 2 * np.pi * np.arange(places) / places
    way = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return LipContours(middle + way * [40, 20], middle + way * [30, opening])


def test_a_ring_crosses_itself_where_two_points_are_swapped_and_nowhere_else(rng):
    ring = mouth().outer
    assert not len(crossings(ring))
    for k in rng.choice(len(ring) - 3, 5, replace=False) + 1:
        swapped = ring.copy()
        swapped[[k, k + 2]] = swapped[[k + 2, k]]
        found = crossings(swapped)
        assert len(found)
        # sides that lead to or from the swapped points
        assert set(found.ravel().tolist()) <= set(range(k - 1, k + 3))
    eight = np.array([[0.0, 0], [50, 40], [50, 0], [0, 40]])
    np.testing.assert_array_equal(crossings(eight), [[0, 2]])
    # as seen in a mirror, and begun elsewhere: the sides are the same, their numbers are not
    assert len(crossings(np.roll(eight[::-1], 1, axis=0))) == 1


def test_a_line_there_and_back_by_an_unsteady_hand_does_not_cross_itself(rng):
    there = np.stack([np.linspace(0, 60, 9), np.zeros(9)], axis=1)
    ring = np.concatenate([there, there[::-1][1:-1]]) + rng.uniform(-0.45, 0.45, (16, 2))
    assert not len(crossings(ring))
    # the same hand crosses itself all the time once no tolerance is left
    assert len(crossings(ring, 0.0))


def test_what_is_wrong_with_labels_is_told_by_frame():
    eight = LipContours(mouth().outer[[0, 12, 6, 18]], mouth().inner)
    labels = {
        0: mouth(),
        3: mouth(middle=(30.0, 80.0)),
        4: eight,
        5: LipContours(mouth().outer, mouth().inner + np.array([0, 60.0])),
        9: mouth(),
        -1: mouth(),
    }
    told = label_faults(labels, 9, SIZE)
    assert told == [
        "frame -1: there is none, the video has frames 0 to 8",
        # 40 cos(a) < -30 within 41 degrees of the corner, in steps of 15
        "frame 3: 5 of 24 points of the outer contour lie outside the picture",
        *(line for line in told if line.startswith("frame 4: the outer contour crosses itself between points")),
        *(line for line in told if line.startswith("frame 4: the inner contour leaves the outer one")),
        # 60 px lower its lowest point is 68 px below the middle, and the outer one's 20
        "frame 5: the inner contour leaves the outer one by 48 pixels",
        "frame 9: there is none, the video has frames 0 to 8",
    ]
    assert len(told) >= 5
    assert label_faults({0: mouth(), 8: mouth(opening=0.0)}, 9, SIZE) == []


def test_an_editor_s_folder_comes_back(tmp_path):
    labels = {3: mouth(), 12: mouth(opening=0.0)}
    pictures = {frame: np.full((SIZE[1], SIZE[0], 3), frame, np.uint8) for frame in labels}
    save_labelme(tmp_path / "edit", labels, pictures)
    content = json.loads((tmp_path / "edit" / "frame_000012.json").read_text())
    assert (content["imagePath"], content["imageWidth"], content["imageHeight"]) == ("frame_000012.png", *SIZE)
    # the editor counts from the corner of the first pixel
    assert content["shapes"][0]["points"][0] == pytest.approx(mouth().outer[0] + 0.5, abs=0.005)
    content["shapes"].append({"label": "nose", "points": [[1, 2]], "shape_type": "point"})
    content["imagePath"] = "..\\clip7\\take_0012.jpg"
    (tmp_path / "edit" / "frame_000012.json").write_text(json.dumps(content))
    found = load_labels(tmp_path / "edit")
    assert sorted(found) == [3, 12]
    for frame, drawn in labels.items():
        np.testing.assert_allclose(found[frame].outer, drawn.outer, atol=0.0051)
        np.testing.assert_allclose(found[frame].inner, drawn.inner, atol=0.0051)


def test_what_is_no_editor_s_folder_is_told(tmp_path):
    with pytest.raises(InputError, match="no JSON file"):
        load_labels(tmp_path)
    square = [[0, 0], [9, 0], [9, 9]]
    outer = {"imagePath": "frame_1.png", "shapes": [{"label": "outer", "points": square}]}
    for content, message in (
        (outer, "no inner"),
        (outer | {"imagePath": "frame.png"}, "no frame number"),
        ({"frames": []}, "no imagePath"),
    ):
        (tmp_path / "one.json").write_text(json.dumps(content))
        with pytest.raises(InputError, match=message):
            load_labels(tmp_path)


def test_labels_to_begin_with_lie_on_the_contour_and_keep_its_corners():
    start = starting_labels(mouth(places=720), 12, 8)
    assert (len(start.outer), len(start.inner)) == (12, 8)
    for ring, radii in ((start.outer, [40, 20]), (start.inner, [30, 8])):
        # on the ellipse, whose 720 chords leave it by 20 (1 - cos(pi / 720))
        np.testing.assert_allclose(np.linalg.norm((ring - [100, 80]) / radii, axis=1), 1, atol=1e-4)
        np.testing.assert_allclose(ring[[0, len(ring) // 2], 0], [100 - radii[0], 100 + radii[0]])
        np.testing.assert_allclose(ring[[0, len(ring) // 2], 1], 80, atol=1e-9)


def test_labels_are_shown_where_they_lie():
    picture = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    picture[80, 60] = 255
    drawn = mouth()
    tile = label_picture(picture, drawn, "frame 7")
    assert tile.shape == (480, 640, 3)
    # 80 px of contour and 45 % of it on either side fill 640 columns: the left corner lies at its share of them
    column = round(319.5 - 40 * 640 / (80 * 1.9))
    corner = tile[236:244, column - 4 : column + 5].reshape(-1, 3)
    assert (corner == [80, 220, 60]).all(axis=1).any()
    far = label_picture(picture, mouth(middle=(0.0, 80.0)), "")
    assert (far[240, 5] == 70).all()
    assert (label_sheet([tile] * 5).shape, label_sheet([tile]).shape) == ((480, 1280, 3), (240, 320, 3))
