"""Who somebody is from turned heads: recovered where places of the skin are known exactly, and what chooses the frames."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.geometry.transforms import fit_similarity, rigid, transform
from headcap.heads import HeadModel, procedural_model
from headcap.lips.monocular.flow import flow_there_and_back
from headcap.lips.monocular.identity import _Bundle, identity_surface, key_frames
from headcap.lips.monocular.person import MonocularPerson
from headcap.lips.monocular.problem import Features
from headcap.lips.monocular.settings import IdentitySettings, MonocularSettings
from headcap.lips.monocular.surface import FaceSurface

AWAY_M, NOISE_PX = 0.8, 0.05
SETTINGS = MonocularSettings(expressions=6, shapes=8, identity=IdentitySettings(harmonics=4, flow_noise_px=NOISE_PX))
CAMERA = Camera("frontal", 400, 560, np.array([[1200.0, 0, 199.5], [0, 1200.0, 279.5], [0, 0, 1]]), np.zeros(5), np.eye(4))
TURNS_DEG = ((0, 0, 0), (0, 25, 0), (0, -25, 3), (15, 5, 0), (-12, -8, -4))


@pytest.fixture(scope="module")
def model() -> HeadModel:
    return procedural_model(shapes=8, expressions=6)


@pytest.fixture(scope="module")
def surface(model: HeadModel) -> FaceSurface:
    return identity_surface(FaceSurface(model, 6, 8), SETTINGS)


def placed(surface: FaceSurface, turn_deg) -> np.ndarray:
    facing = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    return rigid(facing, [0.01, 0.0, AWAY_M])


def shown(surface: FaceSurface, estimate, places: np.ndarray) -> Features:
    return Features(places, CAMERA.project(surface.in_camera(estimate)[places])[0], NOISE_PX, CAMERA)


def depth_error_mm(surface: FaceSurface, found, true) -> float:
    """Mean distance of the neutral faces, size and placement taken off: one lens tells neither size nor distance."""
    rest = surface.at_rest(np.eye(4))
    one, other = (surface.in_head(replace(rest, shape=estimate.shape)) for estimate in (found, true))
    placement, scale = fit_similarity(one, other)
    return float(1e3 * np.linalg.norm(transform(placement, scale * one) - other, axis=1).mean())


@pytest.mark.parametrize("frames", [1, 5])
def test_places_of_turned_heads_tell_the_shape_and_of_one_frame_do_not(surface: FaceSurface, frames: int):
    random = np.random.default_rng(3)
    shape = np.r_[random.normal(size=8), random.normal(size=surface.shapes - 8)]
    truth = [replace(surface.at_rest(placed(surface, turn)), shape=shape) for turn in TURNS_DEG[:frames]]
    places = np.arange(0, len(surface.vertices), 9)
    # two millimetres and two degrees off, and nobody in particular
    start = [
        replace(
            estimate,
            shape=np.zeros_like(shape),
            camera_from_head=rigid(Rotation.from_rotvec([0.03, -0.02, 0.01]).as_matrix(), [2e-3, 1e-3, 0])
            @ estimate.camera_from_head,
        )
        for estimate in truth
    ]
    bundle = _Bundle(surface, [[shown(surface, each, places)] for each in truth], SETTINGS, focal_known=True)
    found = bundle.lowered(start)
    assert bundle._energy(found) < bundle._energy(start)
    for estimate in found[1:]:
        np.testing.assert_array_equal(estimate.shape, found[0].shape)
    before, after = depth_error_mm(surface, start[0], truth[0]), depth_error_mm(surface, found[0], truth[0])
    # a twentieth of a pixel is 0.03 mm across; turned by 25 degrees depth is seen 1 / sin(25) = 2.4 times less well, and the
    # prior of unit deviation weighs as one place does among hundreds
    assert (after < 0.1) == (frames == 5)
    assert after < before


def test_an_unknown_lens_is_found_with_the_shape(surface: FaceSurface):
    truth = [surface.at_rest(placed(surface, turn)) for turn in TURNS_DEG]
    places = np.arange(0, len(surface.vertices), 9)
    longer = [replace(estimate, log_focal=0.1) for estimate in truth]
    features = [
        [Features(places, each.camera(CAMERA).project(surface.in_camera(each)[places])[0], NOISE_PX, CAMERA)] for each in longer
    ]
    found = _Bundle(surface, features, SETTINGS, focal_known=False).lowered(truth)
    assert len({estimate.log_focal for estimate in found}) == 1
    # from a tenth off: what is left is the prior's pull, a deviation of 0.25 beside places seen to a twentieth of a pixel
    assert abs(found[0].log_focal - 0.1) < 0.02


def test_frames_are_chosen_by_how_far_the_head_has_turned(surface: FaceSurface):
    turns = [(0, 0, 0), (0, 1, 0), (0, 10, 0), (0, 24, 0), (0, 25, 0), (0, -14, 0)]
    estimates = [surface.at_rest(placed(surface, turn)) for turn in turns]
    settings = IdentitySettings(key_frames=3, least_turn_deg=12)
    assert key_frames(estimates, settings) == [0, 4, 5]
    # a lost frame is none, and the first answered one takes its place
    assert key_frames([None, *estimates[1:]], settings) == [1, 4, 5]
    # 0, 25, -14, 10 differ by three degrees and more; the others do not
    assert sorted(key_frames(estimates, IdentitySettings(key_frames=8))) == [0, 2, 4, 5]
    assert key_frames(estimates[:3], settings) == []
    assert key_frames([None, None], settings) == []


def test_a_known_person_is_the_models_head_and_the_layer_on_it(model: HeadModel, surface: FaceSurface):
    estimate = replace(surface.at_rest(placed(surface, (0, 9, 0))), shape=np.random.default_rng(5).normal(size=surface.shapes))
    person = MonocularPerson(model.digest, surface.shape(estimate), surface.layer(estimate))
    known = FaceSurface(model, 6, 8, harmonics=4, person=person)
    assert known.shapes == 0
    there = replace(estimate, shape=np.zeros(0), jaw=np.array([0.2, 0.01, 0.0]))
    # single precision of the model's arrays
    np.testing.assert_allclose(known.in_camera(there), surface.in_camera(replace(there, shape=estimate.shape)), atol=2e-7)
    np.testing.assert_array_equal(known.shape(there), person.shape)
    np.testing.assert_array_equal(known.layer(there), person.layer)
    with pytest.raises(InputError, match="head model"):
        FaceSurface(procedural_model(shapes=3, expressions=3), person=person)


def test_a_face_at_some_vertices_alone_is_the_same_face(surface: FaceSurface):
    random = np.random.default_rng(6)
    estimate = replace(
        surface.at_rest(placed(surface, (3, 9, 0))),
        shape=random.normal(size=surface.shapes),
        expression=random.normal(size=6),
        jaw=np.array([0.1, 0.0, 0.02]),
    )
    chosen = np.array([3, 50, 1200])
    part = surface.at(chosen)
    # single precision, added up in another order
    np.testing.assert_allclose(part.in_camera(estimate), surface.in_camera(estimate)[chosen], atol=2e-8)
    whole, own = (each.slopes(estimate, shape=True, normals=False) for each in (surface, part))
    # turns are about each one's own middle; all else agrees
    np.testing.assert_allclose(own.vertices[3:], whole.vertices[3:, chosen], atol=1e-6)


def test_flow_finds_a_shift_there_and_back_and_tells_where_there_is_no_way_back():
    random = np.random.default_rng(2)
    texture = cv2.GaussianBlur(random.normal(size=(140, 160)), (0, 0), 2.0)
    texture = np.clip(127 + 300 * texture, 0, 255).astype(np.uint8)
    first, second = texture[10:110, 10:130].copy(), texture[12:112, 7:127].copy()
    second[30:60, 30:60] = random.integers(0, 255, (30, 30))
    flow, missed_px = flow_there_and_back(first, second, finest_scale=0)
    kept = np.ones(flow.shape[:2], bool)
    # what moved in or was painted over, and DIS patches of eight pixels about it
    kept[:12], kept[-12:], kept[:, :12], kept[:, -12:], kept[16:74, 16:74] = False, False, False, False, False
    np.testing.assert_allclose(np.median(flow[kept], axis=0), [3.0, -2.0], atol=0.1)
    assert np.percentile(missed_px[kept], 90) < 0.3
    assert np.median(missed_px[36:54, 36:54]) > 0.7
