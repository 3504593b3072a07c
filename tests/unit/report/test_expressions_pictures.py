"""Pictures of expressions: they differ where a shape differs, colours tell millimetres, markers are dots where they belong."""

import numpy as np
import pytest

from headcap.report.expressions_pictures import NEAREST, FacePainter, joined, length_mm, round_top

HEIGHT, MARKERS_HEIGHT = 120, 480
"""Of pictures of the ball, and of markers: dots for comparison are half a hundredth of the height."""


@pytest.fixture(scope="module")
def bump(template):
    """The front of the ball, a third of it, comes out by 2 cm."""
    out = np.zeros_like(template.vertices)
    place = template.vertices / 0.1
    out[:, 2] = 0.02 * np.clip((place @ (0.0, 0.0, 1.0) - 0.8) / 0.2, 0, 1)
    return out


@pytest.fixture(scope="module")
def painter(template, bump):
    everywhere = 0.01 * template.vertices / np.linalg.norm(template.vertices, axis=1, keepdims=True)
    return FacePainter.framing(template.vertices, template.triangles, np.stack([bump, everywhere]), height=HEIGHT)


@pytest.fixture(scope="module")
def markers(template, bump):
    """A few points of the ball, without triangles, and how the bump moves them."""
    chosen = np.flatnonzero(template.vertices[:, 2] > 0.05)[::17]
    few = template.vertices[chosen]
    return FacePainter.framing(few, np.empty((0, 3), int), bump[chosen][None], height=MARKERS_HEIGHT), bump[chosen]


def pixels_of(painter, displacement, height=HEIGHT):
    """Where points are in the averaged picture, x and y."""
    scale = painter.camera.height / height
    return (painter.camera.project(painter.neutral + displacement)[0] + 0.5) / scale - 0.5


def test_a_picture_changes_where_the_shape_moves_and_nowhere_else(painter, bump):
    still, moved = painter.shape(np.zeros_like(bump)), painter.shape(bump)
    assert still.shape == moved.shape
    assert still.shape[0] == HEIGHT
    moves = length_mm(bump) > 0
    places = np.concatenate([pixels_of(painter, each)[moves] for each in (bump, np.zeros_like(bump))])
    # normals turn one ring of triangles, 13 mm, farther out
    (left, top), (right, bottom) = places.min(axis=0) - 14, places.max(axis=0) + 14
    changed = np.abs(still.astype(int) - moved).max(axis=2) > 6
    rows, columns = np.nonzero(changed)
    assert changed.sum() > 100
    assert rows.min() >= top
    assert rows.max() <= bottom
    assert columns.min() >= left
    assert columns.max() <= right


def test_all_that_moves_is_in_the_picture(painter, template, bump):
    width = painter.camera.width * HEIGHT / painter.camera.height
    for displacement in (bump, 0.1 * template.vertices):
        places = pixels_of(painter, displacement)
        assert (places > -0.5).all()
        assert (places < (width, HEIGHT)).all()


def test_colours_tell_how_far(painter, bump):
    error = np.where(length_mm(bump) > 10, 2.0, 0.0)
    image = painter.errors(bump, error, 2.0).astype(int)
    yellow = (image[..., 0] > 100) & (image[..., 2] < 60)
    violet = (image[..., 2] > image[..., 1] + 10) & (image[..., 0] < 80)
    rows, columns = np.nonzero(yellow)
    expected = pixels_of(painter, bump)[length_mm(bump) > 10].mean(axis=0)
    assert yellow.sum() > 30
    assert violet.sum() > 3 * yellow.sum()
    assert np.linalg.norm([columns.mean(), rows.mean()] - expected) < 8
    # beyond the top of the scale colours stay (between a vertex past it and one without error the top is merely reached sooner)
    even = np.full(len(bump), 2.0)
    assert (painter.errors(bump, 3 * even, 2.0) == painter.errors(bump, even, 2.0)).all()
    assert ((painter.errors(bump, 0.2 * error, 2.0)[..., 0] > 100) & yellow).sum() == 0


def test_a_close_up_is_nearer_and_still_holds_what_moves(painter, bump):
    near = painter.close_up(bump)
    assert near.camera.size == painter.camera.size
    factor = near.camera.matrix[0, 0] / painter.camera.matrix[0, 0]
    assert 1.2 < factor <= NEAREST + 1e-9
    moves = length_mm(bump) > 10
    for displacement in (bump, np.zeros_like(bump)):
        places = near.camera.project(near.neutral + displacement)[0][moves]
        assert (places >= -0.5).all()
        assert (places <= np.array(near.camera.size) - 0.5).all()


def test_a_shape_that_moves_nothing_is_seen_from_where_all_are(painter, bump):
    assert painter.close_up(np.zeros_like(bump)).shape(bump).shape == painter.shape(bump).shape


def test_captured_markers_are_red_and_reproduced_ones_blue_where_they_are(markers):
    painter, moved = markers
    image = painter.against(np.zeros_like(moved), moved).astype(int)
    red = (image[..., 0] > 150) & (image[..., 2] < 110)
    blue = (image[..., 2] > 150) & (image[..., 0] < 110)
    assert red.any()
    assert blue.any()
    for x, y in np.rint(pixels_of(painter, moved, MARKERS_HEIGHT)).astype(int):
        assert blue[y, x]
    exact = painter.against(moved, moved).astype(int)
    grey_line = np.abs(exact - exact.mean(axis=2, keepdims=True)).max(axis=2) < 3
    assert (exact[grey_line] > 200).all()


def test_a_shape_of_markers_shows_which_move(markers):
    painter, moved = markers
    green = lambda image: (image[..., 1] > image[..., 0].astype(int) + 50).sum()  # noqa: E731
    assert green(painter.shape(np.zeros_like(moved))) == 0
    few = np.where(np.arange(len(moved))[:, None] == length_mm(moved).argmax(), moved, 0)
    assert 0 < green(painter.shape(few)) < green(painter.shape(moved))


def test_markers_take_the_colour_of_their_error(markers):
    painter, moved = markers
    error = np.linspace(0, 1, len(moved))
    image = painter.errors(moved, error, 1.0).astype(int)
    places = np.rint(pixels_of(painter, moved, MARKERS_HEIGHT)).astype(int)
    most, least = places[-1], places[0]
    assert image[most[1], most[0], 0] > 200
    assert image[least[1], least[0], 0] < 120


@pytest.mark.parametrize(
    ("values", "top"),
    [([0.0, 3.2], 4.0), ([0.0, 0.5], 0.5), ([0.9, 0.9], 1.0), ([], 0.01), ([0.0], 0.01), ([np.nan, 11.0], 15.0)],
)
def test_scales_end_at_round_numbers_that_hold_the_values(values, top):
    assert round_top(np.array(values), share=1.0) == pytest.approx(top)


def test_pictures_stand_in_a_row(painter, bump):
    image = painter.shape(bump)
    row = joined([image, image], gap=4)
    assert row.shape == (image.shape[0], 2 * image.shape[1] + 4, 3)
