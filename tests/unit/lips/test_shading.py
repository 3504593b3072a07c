"""Fine detail by shading: the derivative is the finite difference's, bumps of known height come back, flat skin stays flat."""

import cv2
import numpy as np
import pytest

from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.lips.monocular.harmonics import shading
from headcap.lips.monocular.photometric import Level, see
from headcap.lips.monocular.shading import ShadingProblem, ShadingSettings, bilinear, painted_albedo, shaded_detail, smoothed
from headcap.meshes.normals import vertex_normals

LIGHT = np.array([[1.9, -0.9, -1.1, 0.7, 0.1, 0.2, 0.1, -0.1, 0.1]]) * np.array([[1.0], [0.9], [0.8]])
CAMERA = Camera("near", 240, 240, np.array([[1100.0, 0, 119.5], [0, 1100, 119.5], [0, 0, 1]]), np.zeros(5), np.eye(4))
SETTINGS = ShadingSettings(depth_mm=0.5)


def sheet(cells: int, height=None):
    """A round cheek of 80 x 80 mm, 0.5 m away, `height(x, y)` metres over it; triangles face the camera."""
    x, y = np.meshgrid(*[np.linspace(-0.04, 0.04, cells + 1)] * 2, indexing="xy")
    z = 0.5 + 4.0 * (x**2 + y**2)
    if height is not None:
        z = z - height(x, y)
    k = np.arange((cells + 1) ** 2).reshape(cells + 1, -1)
    a, b, c, d = k[:-1, :-1].ravel(), k[:-1, 1:].ravel(), k[1:, 1:].ravel(), k[1:, :-1].ravel()
    triangles = np.concatenate([np.stack([a, c, b], axis=1), np.stack([a, d, c], axis=1)]).astype(np.int32)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), triangles


def bumps(x, y):
    """0.3 mm high, 9 mm across, away from the border."""
    inside = np.clip(1 - (x**2 + y**2) / 0.032**2, 0, None)
    return 3e-4 * np.cos(2 * np.pi * x / 0.009) * np.cos(2 * np.pi * y / 0.009) * np.minimum(4 * inside, 1)


def photographed(vertices, triangles, albedo, random=None) -> Level:
    """Colours between vertices are linear; noise of one code value of 8 bits where asked for."""
    blank = Level.of(CAMERA, np.zeros((CAMERA.height, CAMERA.width, 3), np.float32))
    view = see(blank, vertices, triangles)
    colours = albedo * shading(vertex_normals(vertices, triangles), LIGHT)
    picture = np.nan_to_num(view.raster.interpolate(triangles, colours))
    if random is not None:
        picture = picture + random.normal(scale=1 / 255, size=picture.shape)
    return Level.of(CAMERA, picture.astype(np.float32))


def test_triangles_face_the_camera():
    vertices, triangles = sheet(8)
    assert (vertex_normals(vertices, triangles)[:, 2] < 0).all()


def test_the_derivative_is_the_finite_difference():
    random = np.random.default_rng(1)
    vertices, triangles = sheet(10)
    picture = cv2.GaussianBlur(random.random((240, 240, 3)).astype(np.float32), (0, 0), 6)
    albedo = 0.4 + 0.2 * random.random((len(vertices), 3))
    problem = ShadingProblem.of(Level.of(CAMERA, picture), vertices, triangles, LIGHT, albedo, None, SETTINGS)
    assert len(problem.edges) > 200
    height = random.normal(scale=2e-4, size=len(vertices))
    left, jacobians = problem.jacobians(height)
    np.testing.assert_allclose(left, problem.differences(height), atol=1e-12)
    for _ in range(3):
        way = random.normal(size=len(vertices))
        step = 1e-8
        slope = (problem.differences(height + step * way) - problem.differences(height - step * way)) / (2 * step)
        given = np.stack([one @ way for one in jacobians], axis=1)
        # central differences of 1e-8 m: curvature times step^2, and rounding 1e-16 / 1e-8; a sample may leave its pixel's cell
        agree = np.abs(given - slope) < 1e-5 * np.abs(slope).max()
        assert agree.mean() > 0.99


def test_samples_between_pixels_and_their_slopes():
    random = np.random.default_rng(2)
    picture = random.random((9, 12, 3)).astype(np.float32)
    pixels = random.uniform(0.1, 7.9, (40, 2))
    colours, slopes = bilinear(picture, pixels)
    for axis in range(2):
        step = np.zeros(2)
        step[axis] = 1e-7
        np.testing.assert_allclose(slopes[..., axis], (bilinear(picture, pixels + step)[0] - colours) / 1e-7, atol=1e-6)
    np.testing.assert_allclose(bilinear(picture, np.array([[3.0, 4]]))[0][0], picture[4, 3])


@pytest.fixture(scope="module")
def truth():
    """The bumpy cheek in the picture's own resolution, and the smooth one that a tracker would have."""
    fine, triangles = sheet(80, bumps)
    smooth, _ = sheet(80)
    return fine, smooth, triangles, np.full((len(fine), 3), 0.6)


def told(detail, truth):
    """Root mean squares over seen vertices: height error and true height, mm; normal error after and before, degrees."""
    fine, smooth, triangles, _ = truth
    normals = vertex_normals(smooth, triangles)
    true = np.einsum("vi,vi->v", fine - smooth, normals)
    inner = detail.seen & (np.abs(smooth[:, :2]).max(axis=1) < 0.03)

    def rms(values):
        return float(np.sqrt(np.mean(values[inner] ** 2)))

    def degrees(vertices):
        cosine = np.einsum("vi,vi->v", vertex_normals(vertices, triangles), vertex_normals(fine, triangles))
        return np.degrees(np.arccos(np.clip(cosine, -1, 1)))

    return 1e3 * rms(detail.height_m - true), 1e3 * rms(true), rms(degrees(detail.vertices)), rms(degrees(smooth))


def test_bumps_of_known_height_come_back(truth):
    fine, smooth, triangles, albedo = truth
    level = photographed(fine, triangles, albedo, np.random.default_rng(3))
    detail = shaded_detail(level, smooth, triangles, LIGHT, albedo, settings=SETTINGS)
    error_mm, true_mm, after_deg, before_deg = told(detail, truth)
    assert detail.difference_after < 0.7 * detail.difference_before
    # light from one side leaves waves along it to the prior: half of the heights, and of the normals' errors, at least go
    assert error_mm < 0.6 * true_mm
    assert after_deg < 0.5 * before_deg


def test_smooth_skin_stays_smooth_and_its_painting_is_not_carved(truth):
    _, smooth, triangles, albedo = truth
    level = photographed(smooth, triangles, albedo, np.random.default_rng(4))
    detail = shaded_detail(level, smooth, triangles, LIGHT, albedo, settings=SETTINGS)
    still = np.sqrt(np.mean(detail.height_m**2))
    assert still < 0.1e-3
    # a mole that the albedo knows: a dent where it is not known to be one, none where it is
    spot = 1 - 0.5 * np.exp(-((smooth[:, 0] - 0.01) ** 2 + smooth[:, 1] ** 2) / (2 * 0.003**2))
    level = photographed(smooth, triangles, albedo * spot[:, None])
    known = shaded_detail(level, smooth, triangles, LIGHT, albedo * spot[:, None], settings=SETTINGS)
    unknown = shaded_detail(level, smooth, triangles, LIGHT, albedo, settings=SETTINGS)
    assert np.abs(known.height_m).max() < 0.2 * np.abs(unknown.height_m).max()


def test_a_light_that_is_off_evenly_carves_nothing(truth):
    _, smooth, triangles, albedo = truth
    level = photographed(smooth, triangles, albedo)
    brighter = LIGHT.copy()
    brighter[:, 0] *= 1.1
    there = shaded_detail(level, smooth, triangles, brighter, albedo, settings=SETTINGS)
    assert np.sqrt(np.mean(there.height_m**2)) < 0.02e-3


def test_what_is_no_skin_keeps_to_the_prior(truth):
    fine, smooth, triangles, albedo = truth
    level = photographed(fine, triangles, albedo)
    trust = (smooth[:, 0] < 0).astype(float)
    detail = shaded_detail(level, smooth, triangles, LIGHT, albedo, trust, SETTINGS)
    far = smooth[:, 0] > 0.012
    assert np.abs(detail.height_m[far]).max() < 0.1 * np.abs(detail.height_m[~far]).max()
    assert not detail.seen[far].any()
    with pytest.raises(InputError, match="no skin in view"):
        shaded_detail(level, smooth, triangles, LIGHT, albedo, np.zeros(len(smooth)), SETTINGS)


def test_an_albedo_of_the_frame_itself_leaves_nothing_to_carve(truth):
    """Whatever its shape and paint are: the reference frame is explained, on a split mesh too."""
    fine, _, triangles, albedo = truth
    level = photographed(fine, triangles, albedo, np.random.default_rng(5))
    coarse, coarse_triangles = sheet(40)
    settings = replace_settings(subdivisions=1)
    own = painted_albedo(level, coarse, coarse_triangles, LIGHT, settings)
    assert len(own) == (2 * 40 + 1) ** 2
    detail = shaded_detail(level, coarse, coarse_triangles, LIGHT, own, settings=settings)
    assert detail.difference_before < 1e-12
    assert np.abs(detail.height_m).max() < 1e-12
    with pytest.raises(InputError, match=f"an albedo of {len(own)} vertices"):
        shaded_detail(level, coarse, coarse_triangles, LIGHT, own, settings=SETTINGS)


def test_finer_meshes_carry_finer_detail(truth):
    fine, _, triangles, albedo = truth
    level = photographed(fine, triangles, albedo)
    coarse, coarse_triangles = sheet(20)
    paint = np.full((len(coarse), 3), 0.6)
    found = [
        shaded_detail(level, coarse, coarse_triangles, LIGHT, paint, settings=replace_settings(subdivisions=k)) for k in (0, 2)
    ]
    assert len(found[1].vertices) == (4 * 20 + 1) ** 2
    errors = []
    for detail in found:
        x, y, z = detail.vertices[np.abs(detail.vertices[:, :2]).max(axis=1) < 0.03].T
        errors.append(np.sqrt(np.mean((z - (0.5 + 4.0 * (x**2 + y**2) - bumps(x, y))) ** 2)))
    # edges of 4 mm cannot follow waves of 9 mm; of 1 mm they can
    assert errors[1] < 0.5 * errors[0]
    assert errors[1] < 0.6 * np.sqrt(np.mean(bumps(x, y) ** 2))


def replace_settings(**changes) -> ShadingSettings:
    return SETTINGS.model_copy(update=changes)


def test_albedo_without_what_changes_within_less_than_a_length(truth):
    _, smooth, triangles, _ = truth
    waves = np.sin(2 * np.pi * smooth[:, 0] / 0.005)[:, None]
    trust = np.ones(len(smooth))
    out = smoothed(1 + waves, trust, smooth, triangles, 3e-3)
    # a wave of length w is divided by 1 + (2 pi l / w)^2
    inner = np.abs(smooth[:, :2]).max(axis=1) < 0.025
    assert np.abs(out - 1)[inner].max() == pytest.approx(1 / (1 + (2 * np.pi * 3 / 5) ** 2), rel=0.15)
    np.testing.assert_allclose(smoothed(np.ones((len(smooth), 1)), trust, smooth, triangles, 3e-3), 1, atol=1e-5)
