from functools import lru_cache

import numpy as np
import pytest

from headcap.heads.procedural import base_head
from headcap.meshes.topology import non_manifold_edges
from headcap.synthetic.articulation import ONSET_S
from headcap.synthetic.growth import grow_subject
from headcap.synthetic.performance import CHANNELS, MUSCLES, perform
from headcap.synthetic.settings import SubjectSettings
from headcap.synthetic.subject import AT_REST
from headcap.synthetic.texture import MOUTH


@lru_cache(maxsize=1)
def _subject():
    return grow_subject(base_head(), SubjectSettings(), 3)


def _posed(**channels):
    return _subject().vertices({**AT_REST, **channels})


def test_skin_is_lifted_over_the_larynx_but_does_not_travel_with_it():
    subject = _subject()
    larynx, skin = subject.larynx, subject.larynx.vertices
    bare = subject.bare_m[skin]
    peaks = []
    for slide_mm in (-8.0, 0.0, 8.0):
        lift = _posed(larynx_mm=slide_mm)[skin] - bare
        along = lift @ larynx.upward
        # the body pushes outwards only: whatever it does, no skin point moves along the throat or sideways
        np.testing.assert_allclose(along, 0, atol=1e-12)
        np.testing.assert_allclose(lift[:, 0], 0, atol=1e-12)
        height = lift @ larynx.outward
        peaks.append(np.average(larynx.along_m, weights=height**8))
        # softplus adds softness * ln 2 at most where the body is flush, and less at its peak
        assert larynx.prominence_m <= height.max() + 1e-3
        assert height.max() < larynx.prominence_m + 0.9e-3
    # the highest place follows the body: skin vertices lie 2 mm apart there
    np.testing.assert_allclose(np.diff(peaks), 0.008, atol=0.0015)


def test_the_larynx_is_no_blend_of_shapes():
    subject = _subject()
    skin = subject.larynx.vertices
    motion = np.stack([(_posed(larynx_mm=mm) - _posed())[skin].ravel() for mm in np.linspace(-10, 10, 9)])
    singular = np.linalg.svd(motion, compute_uv=False)
    # one blendshape would leave nothing beyond the first direction
    assert singular[1] > 0.3 * singular[0]


@pytest.mark.parametrize("kind", ["pose", "expression", "speech", "lips", "free", "turn"])
def test_a_performance_is_still_first_then_moves_smoothly(kind):
    performance = perform(np.random.default_rng(4), kind, 1.5, 1.0)
    assert all(abs(value) < 1e-6 for value in performance.state(ONSET_S - 0.01).values())
    time = np.arange(0, 1.5, 1 / 240)
    values = np.array([list(performance.state(t).values()) for t in time])
    assert np.abs(values).max() > 0.1
    limit = np.array([1.0 if name in MUSCLES else np.inf for name in CHANNELS])
    assert (values <= limit + 1e-6).all()
    # muscles take 40 ms or more from rest to full: at most 0.2 in 4 ms
    assert np.abs(np.diff(values, axis=0))[:, : len(MUSCLES)].max() < 0.2
    assert (performance.speech is not None) == (kind in ("speech", "free"))


def _rims_mm(points):
    upper, lower = _subject().contact.rims
    return 1000 * points[upper], 1000 * points[lower]


def _edges_through(points, crossing, crossed):
    """How many edges of the triangles `crossing` pierce one of `crossed`: two meshes that cross have such an edge."""
    import open3d

    scene = open3d.t.geometry.RaycastingScene()
    corners = points[crossed].reshape(-1, 3).astype(np.float32)
    scene.add_triangles(corners, np.arange(len(corners), dtype=np.uint32).reshape(-1, 3))
    edges = np.unique(np.sort(np.concatenate([crossing[:, [0, 1]], crossing[:, [1, 2]], crossing[:, [2, 0]]]), axis=1), axis=0)
    rays = np.concatenate([points[edges[:, 0]], points[edges[:, 1]] - points[edges[:, 0]]], axis=1).astype(np.float32)
    return int((scene.cast_rays(rays)["t_hit"].numpy() <= 1).sum())


def _lip_triangles():
    """Triangles of the upper and of the lower lip; round the corners they are neither."""
    subject = _subject()
    upper, lower = (np.isin(np.arange(len(subject.bare_m)), side) for side in subject.contact.sides)
    triangles = subject.surface.triangles
    return triangles[(upper & ~lower)[triangles].all(1)], triangles[(lower & ~upper)[triangles].all(1)]


def test_inner_lip_vertices_are_pairs_on_the_rims_that_straddle_the_mouth_line():
    subject = _subject()
    for inner, rim in zip(subject.inner_lips, subject.contact.rims, strict=True):
        assert np.isin(inner, rim).all()
    assert len(np.intersect1d(*subject.inner_lips)) == 0
    rest, opened = _posed(), _posed(jaw=0.5)
    upper, lower = subject.inner_lips
    half_width = 0.5 * (subject.places.mouth_left[0] - subject.places.mouth_right[0])
    # rim vertices stand 1.7 mm apart, pairs were one place of the generic head
    np.testing.assert_allclose(rest[upper, 0], [-0.4 * half_width, 0, 0.4 * half_width], atol=0.002)
    np.testing.assert_allclose(rest[upper, 0], rest[lower, 0], atol=0.0002)
    assert (rest[upper, 1] > rest[lower, 1]).all()
    # the rim is where a lip reaches farthest towards the other; jaw and relief turn its roundest place a little off it
    for side, vertices, rim in zip((1, -1), subject.contact.sides, _rims_mm(rest), strict=True):
        points = 1000 * rest[vertices]
        beyond = side * (np.interp(points[:, 0], rim[:, 0], rim[:, 1]) - points[:, 1])
        assert beyond.max() < 0.2
    assert (opened[upper, 1] - opened[lower, 1] > 0.004).all()


def test_lips_touch_at_rest_all_along_the_mouth_and_part_with_the_jaw():
    def gaps_mm(**channels):
        return np.linalg.norm(np.subtract(*_rims_mm(_posed(**channels))), axis=1)

    # "touch" means what no camera can see: 0.5 mm is a pixel and a half of a rig that sees 0.35 mm per pixel
    assert gaps_mm().max() < 0.5
    opening = np.array([gaps_mm(jaw=jaw) for jaw in np.linspace(0, 1, 11)])
    inner = slice(3, -3)  # next to the corners lips are one skin
    assert (np.diff(opening[:, inner], axis=0) > 0).all()
    middle = opening.shape[1] // 2
    assert opening[-1, middle] > 20
    # pressed lips hold on to each other
    assert gaps_mm(jaw=0.4, closure=1.0)[middle] < 0.5 * opening[4, middle]
    assert gaps_mm(jaw=0.1, closure=1.0)[middle] < 0.5


@pytest.mark.parametrize("kind", ["expression", "speech", "lips", "free"])
def test_lips_never_pass_through_each_other(kind):
    upper, lower = _lip_triangles()
    performance = perform(np.random.default_rng(9), kind, 3.0, 1.0)
    states = [performance.state(t) for t in np.linspace(ONSET_S - 0.1, 3.0, 12)]
    for state in [*states, {**AT_REST, "closure": 1.0}, {**AT_REST, "rounding": 1.0, "closure": 1.0}]:
        points = _subject().vertices({**state, "turn_x": 0.0, "turn_y": 0.0, "turn_z": 0.0})
        assert _edges_through(points, upper, lower) == 0
        assert _edges_through(points, lower, upper) == 0


def test_the_mouths_inside_follows_the_face_without_a_step():
    smile, rest = _posed(smile_left=1.0, smile_right=1.0), _posed()
    moved = 1000 * (smile - rest)
    skin = _subject().surface.triangles[_subject().surface.material <= MOUTH]
    skin = skin[np.linalg.norm(rest[skin].mean(1) - _subject().places.mouth, axis=1) < 0.03]
    a, b = np.concatenate([skin[:, [0, 1]], skin[:, [1, 2]]]).T
    strain = np.linalg.norm(moved[a] - moved[b], axis=1) / (1000 * np.linalg.norm(rest[a] - rest[b], axis=1))
    # a full smile stretches skin by half, some short edges behind the corners by more; a torn wall by 2 and more
    assert np.quantile(strain, 0.999) < 1.5


def test_the_head_turns_as_a_body_and_the_neck_between():
    subject = _subject()
    turned = _posed(turn_y=0.4, turn_x=-0.15)
    rest = subject.rest_m
    skull = np.flatnonzero((rest[:, 1] > subject.places.eye_left[1]) & (subject.fields.head > 0.9999))
    pairs = np.random.default_rng(0).choice(skull, (300, 2))
    before = np.linalg.norm(rest[pairs[:, 0]] - rest[pairs[:, 1]], axis=1)
    after = np.linalg.norm(turned[pairs[:, 0]] - turned[pairs[:, 1]], axis=1)
    # weights of 0.9999 leave 1e-4 of the last joint's 60 mrad over 0.2 m: a micrometre
    np.testing.assert_allclose(after, before, atol=1e-5)
    moved = np.linalg.norm(turned - rest, axis=1)
    assert moved[rest[:, 1] < rest[:, 1].min() + 0.004].max() < 0.001
    assert moved[skull].max() > 0.02


def test_the_subject_is_no_copy_of_the_base_head():
    base, subject = base_head(), _subject()
    assert len(subject.bare_m) > 3 * len(base.vertices)
    assert len(non_manifold_edges(subject.surface.triangles)) == 0
    material = np.linalg.norm(subject.bare_m[:1000] - base.vertices[:1000], axis=1)
    assert np.median(material) > 0.0005
    other = grow_subject(base, SubjectSettings(), 4)
    assert np.linalg.norm(other.bare_m - subject.bare_m, axis=1).mean() > 0.001


def test_equal_seeds_give_equal_subjects():
    again = grow_subject(base_head(), SubjectSettings(), 3)
    np.testing.assert_array_equal(again.bare_m, _subject().bare_m)
    np.testing.assert_array_equal(again.surface.look, _subject().surface.look)
    np.testing.assert_array_equal(again.openness, _subject().openness)
