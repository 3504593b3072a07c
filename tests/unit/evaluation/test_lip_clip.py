"""A video without truth: distances of contours by hand, what a mesh shows is no distance from itself, frames are told apart."""

from dataclasses import replace

import numpy as np
import pytest

from headcap.artifacts import ArtifactError
from headcap.cameras import Camera
from headcap.evaluation.lip_clip import CORRECTED, LipClip, contour_distance, judge_clip
from headcap.evaluation.lip_clips import clip_figures, closure_totals
from headcap.evaluation.lip_errors import BASE
from headcap.geometry.transforms import from_vector
from headcap.heads import procedural_model
from headcap.lips.contours import ContourSequence
from headcap.lips.kit import CorrectedClip
from headcap.lips.mesh_contours import MeshContours
from headcap.lips.monocular import FrameState, MonocularTrack
from headcap.lips.takes import MouthSpace, SeenTake
from headcap.speech.words import Word

FRAMES, LOST, MISSED = 8, 2, 5
OPENED_M = 0.004


def circle(radius, middle=(50.0, 40.0), count=200):
    angle = 2 * np.pi * np.arange(count) / count
    return np.array(middle) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def test_rings_one_in_the_other_are_as_far_apart_as_their_radii():
    # chords of 200 places lie inside a circle of radius 20 by 0.0025 px
    assert contour_distance(circle(20.0), circle(23.0)) == pytest.approx(3.0, abs=5e-3)
    assert contour_distance(circle(20.0), np.roll(circle(20.0, count=300), 7, axis=0)) < 5e-3
    assert contour_distance(circle(20.0), circle(23.0)) == contour_distance(circle(23.0), circle(20.0))


def test_places_count_by_the_length_of_a_ring_not_by_its_points():
    square = np.array([[0, 0], [10, 0], [10, 10], [0, 10.0]])
    crowded = np.concatenate([np.stack([np.linspace(0, 10, 500), np.zeros(500)], axis=1), square[2:]])
    other = square + np.array([0.0, 2.0])
    assert contour_distance(square, other) == pytest.approx(contour_distance(crowded, other), rel=0.02)


@pytest.fixture(scope="module")
def space() -> MouthSpace:
    return MouthSpace.of(procedural_model())


@pytest.fixture(scope="module")
def camera() -> Camera:
    return Camera("own", 360, 288, np.array([[600, 0, 179.5], [0, 600, 143.5], [0, 0, 1.0]]), np.zeros(5), np.eye(4))


@pytest.fixture(scope="module")
def track(space) -> MonocularTrack:
    """A head that stands still, its jaw moving, before a camera that looks along z; lost in one frame."""
    model = space.model
    # turned about x: the head's y axis is up, the picture's down
    placement = np.stack([from_vector(np.array([np.pi, 0.0, 0.0, 0.0, 0.0, 0.8]))] * FRAMES)
    jaw = np.zeros((FRAMES, 3))
    jaw[:, 0] = 0.02 * np.arange(FRAMES)
    states = [FrameState.STARTED, *[FrameState.TRACKED] * (FRAMES - 1)]
    states[LOST], states[LOST + 1] = FrameState.LOST, FrameState.RESTARTED
    expression, residual = np.zeros((FRAMES, len(model.expression_basis))), np.full(FRAMES, 0.01)
    for array in (placement, expression, jaw, residual):
        array[LOST] = np.nan
    return MonocularTrack(
        model.digest,
        np.arange(FRAMES) / 25,
        tuple(states),
        np.zeros(len(model.shape_basis)),
        expression,
        jaw,
        placement,
        1.0,
        np.zeros((FRAMES, 3, 9)),
        residual,
        np.ones(FRAMES),
        np.ones(FRAMES),
        np.zeros(model.vertices.shape),
    )


@pytest.fixture(scope="module")
def corrected(space, track, camera) -> CorrectedClip:
    """Contours are what the base's own meshes show, missed in one frame; the correction opens the lips."""
    see = MeshContours.of(np.asarray(space.model.vertices, float), space.mouth, space.model.regions)
    meshes = np.array(list(track.meshes(space.model)), float)
    found = [see(np.nan_to_num(mesh), camera) if k not in (LOST, MISSED) else None for k, mesh in enumerate(meshes)]
    shapes = {name: getattr(found[0], name).shape for name in ("outer", "inner")}
    rings = {
        name: np.stack([np.full(shape, np.nan) if each is None else getattr(each, name) for each in found])
        for name, shape in shapes.items()
    }
    contours = ContourSequence(confidence=np.ones((FRAMES, 2)), **rings)
    take = SeenTake.of(space, track, camera, contours.contours())
    opened = meshes.copy()
    lower = space.model.regions["lips_lower"] | space.model.regions["lips_inner_lower"]
    opened[:, lower, 1] += OPENED_M
    opened[MISSED] = np.nan
    return CorrectedClip(take, contours, opened.astype(np.float32))


@pytest.fixture(scope="module")
def clip(space, track, corrected) -> LipClip:
    return judge_clip("said", space.model, track, corrected, (Word("bin", 0.0, 0.2), Word("now", 0.2, 0.28)))


def test_what_a_mesh_shows_is_no_distance_from_itself(clip):
    told = np.isfinite(clip.contour_px[clip.row(BASE)]).all(axis=1)
    assert np.flatnonzero(~told).tolist() == [LOST, MISSED]
    # places on one ring lie on the other: rounding of pixels
    assert np.nanmax(clip.contour_px[clip.row(BASE)]) < 1e-6
    outer, inner = clip.mean_contour_px(CORRECTED)
    # lower lips moved down by 4 mm at 0.8 m, 600 px: 3 px of a half of either ring
    assert 0.3 < outer < 3.0
    assert 0.3 < inner < 3.0


def test_the_gap_is_wider_by_what_the_correction_opens(space, clip):
    wider = clip.gap(CORRECTED) - clip.gap(BASE)
    assert np.flatnonzero(~np.isfinite(wider)).tolist() == [LOST, MISSED]
    # lips meet at an angle to the way they are opened along
    assert (np.abs(wider[np.isfinite(wider)] - 1e3 * OPENED_M) < 0.35e3 * OPENED_M).all()
    assert (np.diff(clip.gap(BASE)[LOST + 1 :]) > 0).all()


def test_frames_without_an_answer_are_told_by_what_is_missing(clip):
    assert (clip.lost.tolist(), clip.found_again.tolist(), clip.uncorrected.tolist()) == ([LOST], [LOST + 1], [MISSED])
    figures = {figure.name: figure.value for figure in clip_figures([clip])}
    assert (figures["lips.lost_frames"], figures["lips.uncorrected_frames"]) == (1, 1)
    assert figures["lips.photometric_residual"] == pytest.approx(0.01)
    assert figures["lips.base_outer_contour_px"] < 1e-6 < figures["lips.outer_contour_px"]


def test_closures_are_counted_over_all_clips_that_tell_of_words(clip):
    silent = replace(clip, name="silent", words=())
    assert silent.closure_test(BASE) is None
    assert [closure.word for closure in clip.closures] == ["bin"]
    totals = closure_totals([clip, silent, replace(clip, name="other")])
    assert [(total.method, total.closures, total.unseen) for total in totals] == [(BASE, 2, 0), (CORRECTED, 2, 0)]
    assert closure_totals([silent]) == []


def test_a_clip_comes_back_from_its_file(clip, tmp_path):
    clip.save(tmp_path / "clip.npz")
    back = LipClip.load(tmp_path / "clip.npz")
    assert (back.name, back.methods, back.states, back.words) == (clip.name, clip.methods, clip.states, clip.words)
    np.testing.assert_array_equal(back.gap_mm, clip.gap_mm)
    np.testing.assert_array_equal(back.contour_px, clip.contour_px)
    (tmp_path / "other.npz").write_bytes(b"nothing")
    with pytest.raises(ArtifactError):
        LipClip.load(tmp_path / "other.npz")
