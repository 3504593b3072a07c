"""Contours as constraints: laws of the constrained minimum, of what belongs to what, and of a mouth that was seen wrongly."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.lips.correction import CanonicalMeshes, CorrectionLayer, HeldPlaces, canonical_meshes
from headcap.lips.features import SAMPLES, LipContours
from headcap.lips.held_contours import REST_SHARE, HeldContours, border_points, rim_points, ring_heights
from headcap.synthetic.mesh_takes import mesh_subject

FRAMES = 4


@pytest.fixture(scope="module")
def subject():
    return mesh_subject(31)


@pytest.fixture(scope="module")
def truth(stage, subject):
    """A lip take in canonical frames, with the head's motion."""
    meshes = subject.take("lips", 50, 30.0).meshes[14::10].astype(float)
    return canonical_meshes(stage.turned(meshes, 10.0), subject.neutral_m, stage.mouth.steady)


@pytest.fixture(scope="module")
def layer(stage, subject):
    return CorrectionLayer(stage.mouth, subject.neutral_m, "kept")


@pytest.fixture(scope="module")
def held(stage, truth):
    contours = [stage.see(mesh, stage.camera) for mesh in truth.world(truth.meshes)]
    return HeldContours(stage.space, stage.see, stage.camera, contours)


def places(stage, targets, weight):
    return HeldPlaces(stage.space.border, stage.space.share, targets, np.full(SAMPLES, weight))


def test_the_constrained_minimum_goes_from_no_change_to_the_targets(stage, layer, subject, rng):
    still = subject.neutral_m[None].astype(float)
    at = stage.space.samples(still)[0, :, :2]
    targets = at + 1e-3 * rng.normal(size=at.shape)
    away = []
    for weight in (1e-9, 1.0, 1e9):
        drawn = layer.drawn(still, [places(stage, targets, weight)])
        away.append(np.abs(stage.space.samples(drawn)[0, :, :2] - targets).max())
        np.testing.assert_array_equal(drawn[..., 2], still[..., 2])
    assert away[0] == pytest.approx(np.abs(at - targets).max(), rel=1e-5)
    assert away[2] < 1e-9 < away[1] < away[0]


def test_the_minimum_is_that_of_the_whole_matrix(stage, layer, subject, rng):
    """Drawing in two steps is drawing once with both weights: the sum of squares knows no order."""
    still = subject.neutral_m[None].astype(float)
    targets = stage.space.samples(still)[0, :, :2] + 1e-3 * rng.normal(size=(SAMPLES, 2))
    one, other = places(stage, targets, 0.7), places(stage, targets, 1.9)
    together = layer.drawn(still, [one.joined(other)])
    np.testing.assert_allclose(together, layer.drawn(still, [places(stage, targets, 2.6)]), atol=1e-10)


def test_a_free_coordinate_stays(stage, layer, subject):
    still = subject.neutral_m[None].astype(float)
    targets = stage.space.samples(still)[0, :, :2] + 2e-3
    targets[:, 0] = np.nan
    drawn = layer.drawn(still, [places(stage, targets, 1e3)])
    np.testing.assert_array_equal(drawn[..., 0], still[..., 0])
    assert np.abs(drawn[..., 1] - still[..., 1]).max() > 1e-3


def test_another_number_of_frames_is_told(layer, subject):
    with pytest.raises(InputError, match="held in 2 frames"):
        layer.drawn(subject.neutral_m[None].astype(float), [None, None])


def test_a_true_mesh_stays_where_it_is(held, layer, truth):
    """Its own contours hold it where it is.

    Border samples are projected themselves; a rim's share of an edge is told in the picture, where it is another by perspective:
    a quarter of the edge's length times its slant over the distance, 2 mm * 2 mm / (4 * 0.8 m) = 1.3 um at the most.
    """
    for mesh, found in zip(truth.meshes, held.places(truth), strict=True):
        start, end = mesh[found.edges[:, 0], :2], mesh[found.edges[:, 1], :2]
        away = found.targets - (start + found.share[:, None] * (end - start))
        assert np.abs(away[:SAMPLES]).max() < 1e-12
        assert np.nanmax(np.abs(away[SAMPLES:])) < 1.3e-6
    drawn = held.drawn(layer, truth.meshes, truth.world_from_canonical)
    assert np.abs(drawn - truth.meshes).max() < 1.3e-6


def test_frames_without_contours_or_track_are_left_alone(stage, held, layer, truth):
    meshes = truth.meshes.copy()
    meshes[1] = np.nan
    some = HeldContours(held.space, held.see, held.camera, [None, *held.contours[1:]])
    drawn = some.drawn(layer, meshes, truth.world_from_canonical)
    np.testing.assert_array_equal(drawn[:2], meshes[:2])
    assert np.isfinite(drawn[2:]).all()


def test_a_shut_mouth_opens_as_far_as_it_is_seen_to(stage, held, layer, truth, subject):
    """From the neutral face: outer border and opening go to where the contours are."""
    still = np.repeat(subject.neutral_m[None].astype(float), len(truth.meshes), axis=0)
    drawn = held.drawn(layer, still, truth.world_from_canonical)
    for mesh, contours in zip(truth.world(drawn), held.contours, strict=True):
        opening = stage.see.opening(*stage.camera.project(mesh))
        wanted = np.subtract(*ring_heights(opening, contours.inner)[::-1])
        shown = np.maximum(opening.lower.height - opening.upper.height, 0.0)
        known = np.isfinite(wanted) & np.isfinite(shown)
        # constraints are weighed against strains: a tenth of the opening is left, or a pixel (0.6 mm)
        assert np.abs(shown - wanted)[known].mean() < max(1.0, 0.1 * np.nanmax(wanted))


def test_a_share_of_what_is_off_at_rest_stays_off(stage, held, layer, truth):
    """Contours of a mouth 2 mm to the side and 1 mm up in every frame: the same part of it is held in all of them, if need be."""
    away = np.array([2e-3, 1e-3])
    beside = truth.meshes.copy()
    beside[..., :2] -= away
    seen = replace(held, quiet=np.array([True, True, False, False]), weight=1e9)
    placed = CanonicalMeshes(beside, truth.world_from_canonical)
    # along the border nothing is seen but at the corners, and there the way to the contour is the whole of it
    offset = seen.resting_offset(placed)
    np.testing.assert_allclose(offset[[0, SAMPLES // 2]], [away, away], atol=1e-5)
    np.testing.assert_array_equal(replace(seen, quiet=None).resting_offset(placed), 0.0)
    drawn = seen.drawn(layer, beside, truth.world_from_canonical)
    corners = [stage.space.samples(meshes)[:, [0, SAMPLES // 2], :2] for meshes in (drawn, truth.meshes)]
    np.testing.assert_allclose(corners[1] - corners[0], np.broadcast_to(REST_SHARE * away, (FRAMES, 2, 2)), atol=2e-5)


def test_corners_belong_to_corners_wherever_the_border_was_tracked():
    """An almond that is raised along itself at its ends; its normals there run sideways."""
    angle = np.pi + 2 * np.pi * np.arange(400) / 400
    ring = np.stack([60 * np.cos(angle), -25 * np.sin(angle) * np.abs(np.sin(angle))], axis=1)
    smile = ring + np.stack([np.zeros(400), -12 * (ring[:, 0] / 60) ** 2], axis=1)
    samples = ring[np.arange(SAMPLES) * 20]
    inner = 0.3 * smile
    for drawn in (smile, np.roll(smile, 200, axis=0)):
        found = border_points(samples, LipContours(drawn, inner))
        np.testing.assert_allclose(found[[0, SAMPLES // 2]], smile[[0, 200]], atol=1e-9)
    apart = np.linalg.norm(found[1:10] - smile[None, :].transpose(1, 0, 2), axis=2).min(axis=0)
    assert apart.max() < 1.0


def test_heights_of_a_circle():
    angle = 2 * np.pi * np.arange(2000) / 2000
    opening = _opening(np.linspace(1.0, 99.0, 25), 0.0, 0.0)
    ring = np.stack([50 + 40 * np.cos(angle), 3 + 40 * np.sin(angle)], axis=1)
    upper, lower = ring_heights(opening, ring)
    inside = np.abs(opening.stations - 50) < 40
    half = np.sqrt(1600 - (opening.stations[inside] - 50) ** 2)
    # sides of a polygon lie within r (1 - cos(pi / n)) of the circle, more where stations meet them at a slant
    np.testing.assert_allclose(upper[inside], 3 - half, atol=1e-3)
    np.testing.assert_allclose(lower[inside], 3 + half, atol=1e-3)
    assert np.isnan(upper[~inside]).all()


@pytest.mark.parametrize(("upper", "lower", "expected"), [(5.0, -5.0, 1), (-5.0, 5.0, 2), (5.0, 9.0, 2)])
def test_the_lip_behind_is_held_only_where_it_would_show(upper, lower, expected):
    """Of shut lips: the upper one in front. Behind it the lower one is hidden while its rim is above the line at zero."""
    opening = _opening(np.linspace(10.0, 90.0, 9), upper, lower)
    line = np.array([[0.0, 0.0], [50.0, 0.0], [100.0, 0.0], [50.0, 0.0]])
    edges, share, pixels = rim_points(opening, line)
    assert len(edges) == len(share) == expected * 4
    np.testing.assert_allclose(pixels[:, 1], 0.0, atol=1e-12)
    assert set(edges[:, 0]) == ({0, 1} if expected == 2 else {0})


def _opening(stations, upper, lower):
    from headcap.lips.mesh_contours import Opening, Rim

    def rim(vertex, height, depth):
        count = len(stations)
        return Rim(np.full((count, 2), vertex), np.zeros(count), np.full(count, height), np.full(count, depth))

    right, left = np.zeros(2), np.array([100.0, 0.0])
    axes = np.array([1.0, 0.0]), np.array([0.0, 1.0])
    return Opening(right, left, *axes, stations, rim(0, upper, 0.5), rim(1, lower, 0.51))
