import numpy as np
import pytest

from headcap.cameras import Camera
from headcap.synthetic.render import Surface, render_surface
from headcap.synthetic.rig import looking_at
from headcap.synthetic.sensor import Sensor, encode
from headcap.synthetic.texture import EYE, lattice, make_grain


def _camera(distortion=(-0.12, 0.05, 0.001, -0.0007, 0.0)):
    return Camera(
        "c", 240, 200, np.array([[420.0, 0, 118.3], [0, 415.0, 97.6], [0, 0, 1]]), np.array(distortion),
        looking_at(np.array([0.03, 0.02, 0.5]), np.zeros(3), np.array([0.02, -0.01, 0.1])),
    )  # fmt: skip


def _plane(centre_m, size_m, cells=40):
    """A square facing +z whose texture coordinates put an iris of 5.9 mm on its middle."""
    axis = np.linspace(-0.5, 0.5, cells + 1) * size_m
    x, y = np.meshgrid(axis, axis)
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1) + centre_m
    index = np.arange(x.size).reshape(x.shape)
    a, b, c, d = index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel()
    triangles = np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)]).astype(np.int32)
    look = np.zeros((len(points), 7), np.float32)
    look[:, :2], look[:, 2] = (points - centre_m)[:, :2] * 1000, 1.0
    area = np.full(len(triangles), (size_m * 1000 / cells) ** 2 / 2, np.float32)
    return points, Surface(triangles, np.full(len(triangles), EYE, np.uint8), look, area)


@pytest.mark.parametrize("centre", [(0.0, 0.0, 0.0), (0.055, 0.03, 0.01), (-0.06, -0.04, -0.02)])
def test_a_painted_disc_lies_where_the_lens_puts_it(centre):
    camera = _camera()
    points, surface = _plane(np.array(centre), 0.03)
    light = np.ones((len(points), 4), np.float32) * [1, 1, 1, 0]
    white = np.full((camera.height, camera.width, 3), 0.66, np.float32)
    picture = render_surface(camera, points, surface, light, make_grain(0), white)[..., 0]
    dark = np.clip(0.60 - picture, 0, None)
    rows, columns = np.mgrid[: camera.height, : camera.width]
    found = np.array([(dark * columns).sum(), (dark * rows).sum()]) / dark.sum()
    # the mean of a fine sampling of the disc, through the exact lens; darkness is not uniform over the iris, but symmetric
    angle, radius = np.meshgrid(np.linspace(0, 2 * np.pi, 60, endpoint=False), 0.0059 * np.sqrt((np.arange(40) + 0.5) / 40))
    disc = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * radius], axis=-1) + np.array(centre)
    expected = camera.project(disc)[0].reshape(-1, 2).mean(0)
    # samples lie half a pixel apart on a disc of some 80 pixels: a rim of 32 pixels errs by a 0.1 pixel at random each
    np.testing.assert_allclose(found, expected, atol=0.03)


def test_coverage_at_the_outline_is_the_area_seen():
    camera = _camera()
    points, surface = _plane(np.array([0.01, 0.0, 0.0]), 0.05)
    light = np.ones((len(points), 4), np.float32) * [0, 0, 0, 0]
    white = np.ones((camera.height, camera.width, 3), np.float32)
    covered = (1 - render_surface(camera, points, surface, light, make_grain(0), white)[..., 0]).sum()
    edge = np.linspace(-0.025, 0.025, 200)
    sides = [(edge, 0 * edge - 0.025), (0 * edge + 0.025, edge), (-edge, 0 * edge + 0.025), (0 * edge - 0.025, -edge)]
    rim = np.vstack([np.stack(side, axis=1) for side in sides])
    x, y = camera.project(np.column_stack([rim + np.array([0.01, 0]), np.zeros(len(rim))]))[0].T
    area = 0.5 * abs(x @ np.roll(y, 1) - y @ np.roll(x, 1))
    # 170 outline pixels, each wrong by at most 1/4 and at random: 0.25 / sqrt(12) * sqrt(170) = 1 pixel
    assert abs(covered - area) < 4


def test_a_band_of_rows_is_that_part_of_the_picture():
    camera = _camera()
    points, surface = _plane(np.zeros(3), 0.05)
    light = np.ones((len(points), 4), np.float32)
    grey = np.full((camera.height, camera.width, 3), 0.1, np.float32)
    whole = render_surface(camera, points, surface, light, make_grain(0), grey)
    band = render_surface(camera, points, surface, light, make_grain(0), grey[60:140], (60, 140))
    np.testing.assert_allclose(band, whole[60:140], atol=1e-5)


def test_noise_has_the_stated_size_and_comes_again():
    sensor = Sensor(np.ones(3, np.float32), 0.002, 0.01, 5)
    linear = np.full((300, 300, 3), 0.4, np.float32)
    picture = sensor.expose(linear, 1, 2, 3)
    np.testing.assert_array_equal(picture, sensor.expose(linear, 1, 2, 3))
    assert (picture != sensor.expose(linear, 1, 2, 4)).mean() > 0.3
    decoded = ((picture / 255 + 0.055) / 1.055) ** 2.4
    step = np.diff(((np.array([169, 170]) / 255 + 0.055) / 1.055) ** 2.4)[0]
    expected = np.sqrt(0.002**2 + 0.4 * 0.01**2 + step**2 / 12)
    # deviation of a deviation over 270,000 values: 0.14 %; the encoding's curve bends by less than 2 % over the noise
    assert decoded.std() == pytest.approx(expected, rel=0.04)
    assert decoded.mean() == pytest.approx(0.4, rel=0.005)
    assert encode(np.array([0.0, 1.0])).tolist() == [0, 255]


def test_noise_repeats_itself_in_all_directions():
    from scipy.ndimage import map_coordinates

    random = np.random.default_rng(3)
    volume = random.standard_normal((6, 6, 6)).astype(np.float32)
    # far off on either side, and on the very borders of periods, where a wrong wrap shows
    places = np.concatenate([random.uniform(-200, 200, (300, 3)), random.integers(-5, 5, (60, 3)) * 6.0])
    expected = map_coordinates(volume.astype(float), places.T, order=1, mode="grid-wrap")
    found = [lattice(volume, *place) for place in places]
    # three blends, each rounded to float32 of values within a few units
    assert np.abs(np.array(found) - expected).max() < 8 * np.finfo(np.float32).eps * np.abs(volume).max()
