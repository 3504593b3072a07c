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


@pytest.mark.parametrize("kind", ["pose", "expression", "speech", "lips", "free"])
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


def test_lips_meet_at_rest_part_with_the_jaw_and_hold_when_pressed():
    upper, lower = (ring[1] for ring in _subject().inner_lips)

    def gap_mm(**channels):
        points = _posed(**channels)
        return 1000 * np.linalg.norm(points[upper] - points[lower])

    assert gap_mm() < 2.5
    assert gap_mm(jaw=0.8) > gap_mm(jaw=0.4) > gap_mm() + 3
    assert gap_mm(jaw=0.4, closure=1.0) < 0.5 * gap_mm(jaw=0.4)


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
