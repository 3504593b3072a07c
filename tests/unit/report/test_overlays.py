"""Overlays: a cut and scaled camera projects as the cut and scaled photograph shows, and drawings lie where they belong."""

import numpy as np
import pytest

from headcap.meshes.rasteriser import rasterise
from headcap.report import overlays


def test_viewport_and_crop_agree_on_every_pixel(rig):
    # a ramp is reproduced exactly by linear sampling, so the picture's value tells where each pixel came from
    camera = rig["cam01"]
    ramp = np.stack([np.tile(np.arange(160, dtype=np.uint8), (200, 1))] * 3, axis=2)
    box = (20.5, 30.5, 100.5, 110.5)
    view = overlays.viewport(camera, box, 80)
    assert view.size == (80, 80)
    cut = overlays.crop(ramp, box, view.size)
    np.testing.assert_array_equal(cut[5, :, 0], np.arange(21, 101))
    points = np.array([[0.01, 0.02, 0.05], [-0.03, 0.0, 0.02]])
    # the box begins at 20.5, the outer edge of pixel 21: its centre is the cut's pixel 0
    np.testing.assert_allclose(view.project(points)[0], camera.project(points)[0] - [21, 31], atol=1e-9)


def test_viewport_scales_about_pixel_edges(rig):
    camera = rig["cam01"]
    view = overlays.viewport(camera, (-0.5, -0.5, 159.5, 199.5), 400)
    expected = camera.scaled(2.0)
    np.testing.assert_allclose(view.matrix, expected.matrix, atol=1e-9)
    assert view.size == expected.size


def test_box_stays_in_the_image(rig, template):
    camera = rig["cam01"]
    left, top, right, bottom = overlays.box_of(camera, 3 * template.vertices, aspect=2.0)
    assert (left, top, right, bottom) == (-0.5, -0.5, 159.5, 199.5)


def test_points_hide_what_lies_behind_them(rig):
    camera = rig["cam01"]
    centre = camera.centre
    points = np.stack([centre + 0.5 * camera.axis, centre + 0.7 * camera.axis])
    colours = np.array([[250, 0, 0], [0, 250, 0]], np.uint8)
    image = overlays.draw_points(np.zeros((200, 160, 3), np.uint8), camera, points, colours)
    row, column = np.rint(camera.project(points[:1])[0][0][::-1]).astype(int)
    assert image[row, column].tolist() == [250, 0, 0]


def test_values_are_coloured_where_known_and_grey_where_not(rig, template):
    camera = rig["cam01"]
    values = np.where(template.vertices[:, 0] > 0, 0.5, np.nan)
    image = overlays.draw_values(camera, template.vertices, template.triangles, values, top=0.5).astype(int)
    hit = rasterise(camera, template.vertices, template.triangles).hit
    assert (image[~hit] == 255).all()
    grey = image.max(axis=2) - image.min(axis=2) <= 1
    middle = image.shape[0] // 2
    columns = np.flatnonzero(hit[middle])
    assert grey[middle, columns[5]]
    assert not grey[middle, columns[-5]]


def test_a_virtual_camera_sees_the_whole_mesh_upright(template):
    camera = overlays.virtual_camera(template.vertices, 55, height=120)
    pixels, depth = camera.project(template.vertices)
    assert (depth > 0).all()
    assert pixels.min() >= -0.5
    assert (pixels <= np.array(camera.size)).all()
    top, bottom = template.vertices[:, 1].argmax(), template.vertices[:, 1].argmin()
    assert pixels[top, 1] < pixels[bottom, 1]


@pytest.mark.parametrize("encode", [overlays.jpeg_uri, overlays.png_uri])
def test_pictures_become_data_uris(encode):
    assert encode(np.zeros((4, 4, 3), np.uint8)).startswith("data:image/")
