"""Light, surface and photometric term: analytic derivatives against finite differences, and the bound of the lumped matrix."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.geometry.transforms import rigid
from headcap.heads import HeadCoefficients, procedural_model
from headcap.heads.model import RestOffset
from headcap.lips.monocular import harmonics, photometric
from headcap.lips.monocular.medium_scale import manifold_harmonics, medium_layer
from headcap.lips.monocular.surface import Estimate, FaceSurface
from headcap.meshes.laplacian import cotangent_laplacian, vertex_areas
from headcap.meshes.topology import boundary_mask

WIDTH, HEIGHT = 90, 120
FACING = np.diag([1.0, -1.0, -1.0])
"""A head that looks at the camera."""


@pytest.fixture(scope="module")
def surface() -> FaceSurface:
    return FaceSurface(procedural_model(shapes=6, expressions=12), 12, 6, harmonics=2)


@pytest.fixture(scope="module")
def camera() -> Camera:
    matrix = np.array([[400.0, 0, 44.5], [0, 400.0, 59.5], [0, 0, 1]])
    return Camera("one", WIDTH, HEIGHT, matrix, np.zeros(5), np.eye(4))


@pytest.fixture(scope="module")
def estimate(surface: FaceSurface) -> Estimate:
    random = np.random.default_rng(5)
    turn = Rotation.from_rotvec([0.1, 0.2, -0.05]).as_matrix() @ FACING
    return Estimate(
        rigid(turn, [0.004, 0.0, 0.75]),
        np.array([0.12, 0.02, -0.01]),
        random.normal(0, 0.7, surface.expressions),
        random.normal(0, 0.7, surface.shapes),
    )


def test_harmonics_are_orthogonal_over_the_sphere():
    directions = np.random.default_rng(0).normal(size=(200_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    values = harmonics.harmonics(directions)
    factor = np.r_[1.0, [2 / 3] * 3, [0.25] * 5]
    gram = 4 * np.pi * values.T @ values / len(values) / np.outer(factor, factor)
    # the mean of N products of harmonics below 1.1 in size errs by less than 4 pi * 1.2 / sqrt(N), five times over
    assert np.abs(gram - np.eye(9)).max() < 5 * 4 * np.pi * 0.3 / np.sqrt(len(directions))


def test_shading_slopes_are_the_polynomials_derivatives(rng: np.random.Generator):
    normals, light = rng.normal(size=(7, 3)), rng.normal(size=(3, 9))
    slopes = harmonics.shading_slopes(normals, light)
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1e-5
        # quadratics: central differences have no truncation error
        numeric = (harmonics.shading(normals + step, light) - harmonics.shading(normals - step, light)) / 2e-5
        assert np.allclose(slopes[..., axis], numeric, atol=1e-9)


def test_light_is_recovered_from_colours(rng: np.random.Generator):
    normals = rng.normal(size=(300, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    light, albedo = rng.normal(size=(3, 9)), rng.uniform(0.3, 1.0, (300, 3))
    colours = albedo * harmonics.shading(normals, light)
    found = harmonics.solve_light(normals, albedo, colours, rng.uniform(0.5, 2.0, 300), np.zeros((3, 9)), 1e-12)
    assert np.allclose(found, light, atol=1e-7)
    # from one normal nothing is learnt but one number per channel: the rest stays at the prior
    one = np.tile(normals[:1], (5, 1))
    held = harmonics.solve_light(one, albedo[:5], albedo[:5] * harmonics.shading(one, light), np.ones(5), light, 0.01)
    assert np.allclose(held, light, atol=1e-9)


def test_surface_is_the_head_models_own(surface: FaceSurface, estimate: Estimate):
    pose = np.stack([np.zeros(3), estimate.jaw])
    whole = HeadCoefficients(estimate.shape[:6], estimate.expression, pose, placement=estimate.camera_from_head)
    layer = RestOffset(np.arange(len(surface.model.vertices)), surface.layer(estimate))
    # the deviation of a layer of 2 mm: there is something to find
    assert np.linalg.norm(layer.values, axis=1).max() > 1e-3
    expected = surface.model.evaluate(whole, layer)[surface.vertices]
    # float32 bases on positions below a metre
    assert np.abs(surface.in_camera(estimate) - expected).max() < 1e-6


def test_harmonics_of_the_layer_are_the_face_s_own(surface: FaceSurface):
    vertices = surface.model.vertices[surface.vertices].astype(float)
    modes, values = manifold_harmonics(vertices, surface.triangles, 12)
    areas = vertex_areas(vertices, surface.triangles)
    # eigenvectors: orthonormal over the area, with lambda as their energy
    np.testing.assert_allclose((modes * areas) @ modes.T / areas.sum(), np.eye(12), atol=1e-8)
    energy = modes @ cotangent_laplacian(vertices, surface.triangles) @ modes.T / areas.sum()
    np.testing.assert_allclose(energy, np.diag(values), atol=1e-6 * values[-1])
    assert (np.diff(values) >= 0).all()
    # the rest of the head joins on
    assert np.abs(modes[:, boundary_mask(surface.triangles, len(vertices))]).max() == 0
    layer = medium_layer(vertices, surface.triangles, 12, 1.5e-3)
    deviation_m = np.sqrt((areas * (layer**2).sum(axis=2)).sum(axis=1) / areas.sum()).reshape(12, 3)
    np.testing.assert_allclose(deviation_m, np.repeat(1.5e-3 * values[:1] / values, 3).reshape(12, 3), rtol=1e-4)


def test_surface_slopes_are_finite_differences(surface: FaceSurface, estimate: Estimate):
    slopes = surface.slopes(estimate, shape=True)
    assert len(slopes.columns) == surface.unknowns - 1
    for k in slopes.columns:
        step = np.zeros(surface.unknowns)
        step[k] = 1e-3
        ahead, behind = surface.moved(estimate, step), surface.moved(estimate, -step)
        numeric = (surface.in_camera(ahead) - surface.in_camera(behind)) / 2e-3
        scale = np.abs(numeric).max()
        # truncation (1e-3)^2 / 6, and float32 displacements of 5 mm, rounded at 6e-8 of that, over 2e-3
        assert np.abs(slopes.vertices[k] - numeric).max() < 1e-5 * scale + 1e-6
        normals = (surface.normals(surface.in_camera(ahead)) - surface.normals(surface.in_camera(behind))) / 2e-3
        # edges down to 0.3 mm turn by the rounding of 1e-9 m over that, and float32 normals by 1e-6 of their slope
        assert np.abs(slopes.normals[k] - normals).max() < 5e-3 * max(1.0, np.abs(normals).max())


class Scene:
    """A smooth picture (a quadratic, whose central differences are exact) and a surface seen in it."""

    def __init__(self, surface: FaceSurface, camera: Camera, estimate: Estimate) -> None:
        random = np.random.default_rng(2)
        self.surface, self.camera = surface, camera
        self.quadratic = random.normal(size=(6, 3)) * np.array([0.5, 4e-3, 4e-3, 2e-5, 2e-5, 2e-5])[:, None]
        x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
        self.level = photometric.Level.of(camera, self.look_up(np.stack([x, y], axis=-1).astype(float)))
        self.light = random.normal(0, 0.3, (3, 9)) + np.r_[2.0, np.zeros(8)]
        self.albedo = random.uniform(0.5, 1.0, (len(surface.vertices), 3))
        self.confidence = np.where(surface.blind, 0.0, random.uniform(0.2, 1.0, len(surface.vertices)))
        self.view = photometric.see(self.level, surface.in_camera(estimate), surface.triangles)
        y, x = np.nonzero(self.view.usable)
        self.corners = surface.triangles[self.view.raster.triangle[y, x]]
        self.shares = self.view.shares[y, x].astype(float)
        self.trust = np.float32(self.confidence)[self.corners].min(axis=1)

    def look_up(self, pixels: np.ndarray) -> np.ndarray:
        x, y = pixels[..., 0] - WIDTH / 2, pixels[..., 1] - HEIGHT / 2
        return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1) @ self.quadratic

    def colours(self, estimate: Estimate, light: np.ndarray | None = None) -> np.ndarray:
        light = self.light if light is None else light
        return self.albedo * harmonics.shading(self.surface.normals(self.surface.in_camera(estimate)), light)

    def residuals(self, estimate: Estimate, light: np.ndarray | None = None) -> np.ndarray:
        """Of the same pieces of skin, wherever they go."""
        pixels = estimate.camera(self.camera).project(self.surface.in_camera(estimate))[0]
        at = np.einsum("kj,kjd->kd", self.shares, pixels[self.corners])
        return self.look_up(at) - np.einsum("kj,kjc->kc", self.shares, self.colours(estimate, light)[self.corners])


@pytest.fixture(scope="module")
def scene(surface: FaceSurface, camera: Camera, estimate: Estimate) -> Scene:
    return Scene(surface, camera, estimate)


SCALE = 0.7


@pytest.fixture(scope="module")
def terms(scene: Scene, surface: FaceSurface, camera: Camera, estimate: Estimate):
    vertices = surface.in_camera(estimate)
    photo = photometric.gather(scene.level, scene.view, surface.triangles, scene.colours(estimate), scene.confidence, SCALE)
    jacobian = camera.project_with_jacobian(vertices)[1]
    h = scene.albedo[:, :, None] * harmonics.shading_slopes(surface.normals(vertices), scene.light)
    y = scene.albedo[:, :, None] * harmonics.harmonics(surface.normals(vertices))[:, None]
    return photo, photometric.Chain(jacobian, h, y), surface.slopes(estimate, shape=True, focal=True)


def test_robust_energy_is_the_sum_over_pixels(scene: Scene, estimate: Estimate, terms):
    photo = terms[0]
    square = (scene.residuals(estimate) ** 2).sum(axis=1) / SCALE**2
    assert photo.cost == pytest.approx((scene.trust * square / (1 + square)).sum(), rel=1e-3)
    assert photo.pixels == pytest.approx(scene.trust.sum(), rel=1e-4)
    assert (scene.trust > 0).sum() > 1000


def test_gradient_of_the_energy_is_its_finite_difference(scene: Scene, surface: FaceSurface, estimate: Estimate, terms):
    photo, chain, slopes = terms
    gradient, by_light = (-2.0 / SCALE**2 * right for right in photometric.right_side(photo, chain, slopes))

    def energy(at: Estimate, light: np.ndarray | None = None) -> float:
        square = (scene.residuals(at, light) ** 2).sum(axis=1) / SCALE**2
        return float((scene.trust * square / (1 + square)).sum())

    numeric = np.empty(len(gradient))
    for row, k in enumerate(slopes.columns):
        step = np.zeros(surface.unknowns)
        step[k] = 3e-3 if k >= 6 else 3e-4
        numeric[row] = (energy(surface.moved(estimate, step)) - energy(surface.moved(estimate, -step))) / (2 * step[k])
    # float32 sums, bases and normals: three digits of the largest component of its kind
    for kind in (slice(0, 3), slice(3, 6), slice(6, 9), slice(9, len(gradient))):
        assert np.abs(gradient[kind] - numeric[kind]).max() < 5e-3 * np.abs(numeric[kind]).max()
    for k in range(27):
        step = np.zeros((3, 9))
        step.flat[k] = 1e-3
        slope = (energy(estimate, scene.light + step) - energy(estimate, scene.light - step)) / 2e-3
        assert by_light[k] == pytest.approx(slope, abs=5e-3 * np.abs(by_light).max())


def test_lumped_matrix_bounds_the_gauss_newton_matrix(scene: Scene, surface: FaceSurface, estimate: Estimate, terms):
    photo, chain, slopes = terms
    normal = photometric.normal_matrix(photo, chain, slopes)
    lumped = np.block([[normal.geometry, normal.mixed], [normal.mixed.T, normal.light]])
    square = (scene.residuals(estimate) ** 2).sum(axis=1) / SCALE**2
    weight = scene.trust / (1 + square) ** 2
    y, x = np.nonzero(scene.view.usable)
    image = np.stack([scene.level.slope_x[y, x], scene.level.slope_y[y, x]], axis=-1)
    moved = np.einsum("vdi,pvi->pvd", chain.pixels, slopes.vertices)
    shaded = np.einsum("vci,pvi->pvc", chain.colours, slopes.normals)
    own = np.einsum("kj,pkjd->pkd", scene.shares, moved[:, scene.corners])
    rows = np.einsum("kcd,pkd->pkc", image, own) - np.einsum("kj,pkjc->pkc", scene.shares, shaded[:, scene.corners])
    lit = np.zeros((3, 9, len(weight), 3))
    for q in range(3):
        lit[q, :, :, q] = -np.einsum("kj,kjl->lk", scene.shares, chain.light[scene.corners, q])
    rows = np.concatenate([rows, lit.reshape(27, len(weight), 3)])
    exact = np.einsum("pkc,k,qkc->pq", rows, weight, rows, optimize=True)
    size = np.sqrt(np.diag(lumped))
    gap = np.linalg.eigvalsh((lumped - exact) / np.outer(size, size))
    assert gap.min() > -1e-3
    # and not by much where motion is smooth over a triangle: a rigid step is as long as without lumping
    assert np.allclose(np.diag(exact)[:9], np.diag(lumped)[:9], rtol=0.1)


def test_observed_colours_leave_no_mean_residual(scene: Scene, surface: FaceSurface, estimate: Estimate, terms):
    photo = terms[0]
    colours, weight = photometric.observed(photo, scene.colours(estimate))
    seen = weight > 0
    assert np.allclose((colours - scene.colours(estimate))[seen] * weight[seen, None], photo.sums[seen, 12:15])
    better = photometric.gather(scene.level, scene.view, surface.triangles, colours, scene.confidence, SCALE)
    assert better.squares / better.inliers < 0.2 * photo.squares / photo.inliers


def test_a_model_without_a_face_is_refused():
    model = procedural_model(shapes=2, expressions=3)
    nameless = type(model)(**{name: getattr(model, name) for name in model.__dataclass_fields__ if name != "regions"}, regions={})
    with pytest.raises(InputError, match="face"):
        FaceSurface(nameless)
