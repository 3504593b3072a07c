"""True meshes of another topology: what is carried over is what was given, and errors do not see the difference."""

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.evaluation.lip_truth import TrueMeshes, carried_meshes, correspondence_of, judge_against
from headcap.evaluation.truth import Truth
from headcap.geometry.transforms import from_vector, transform
from headcap.heads import base_head, procedural_model
from headcap.lips.correction import canonical_meshes
from headcap.lips.takes import MouthSpace
from headcap.meshes.subdivision import subdivide_butterfly
from headcap.registration.sequence import MeshSequence, save_chunk
from headcap.synthetic.mesh_takes import mesh_subject

FRAMES = 4
SIZE, PLACE = 1.1, from_vector(np.array([0.2, -0.1, 0.3, 0.5, 0.2, 1.0]))
DETECTED = ("menton", "mouth_upper", "mouth_lower", "subnasale", "nose_tip", "nose_bridge", "eye_outer_left", "eye_outer_right",
            "eye_inner_left", "eye_inner_right", "mouth_corner_left", "mouth_corner_right")  # fmt: skip


@pytest.fixture(scope="module")
def space():
    return MouthSpace.of(procedural_model())


@pytest.fixture(scope="module")
def subject():
    return mesh_subject(5)


@pytest.fixture(scope="module")
def meshes(subject):
    return subject.take("lips", 60, 30.0).meshes[9::14][:FRAMES].astype(float)


@pytest.fixture(scope="module")
def tie(space, subject, twin):
    return correspondence_of(space.model, space.mouth, np.asarray(subject.neutral_m, float), twin)


@pytest.fixture(scope="module")
def twin(subject, meshes):
    """The same motion on four times the triangles, vertices in no order, elsewhere and larger; one frame is not known."""
    head = base_head()
    step = subdivide_butterfly(head.triangles, len(head.vertices))
    finer = [transform(PLACE, SIZE * step.carry(mesh)) for mesh in (subject.neutral_m, *meshes)]
    order = np.random.default_rng(0).permutation(len(finer[0]))
    number = np.argsort(order)
    landmarks = {name: int(number[head.landmarks[name]]) for name in DETECTED}
    known = [mesh[order] for mesh in finer[1:]]
    return TrueMeshes(number[step.triangles].astype(np.int32), finer[0][order], landmarks, [*known, None].__getitem__)


class Seen:
    """As much of a `SeenTake` as is judged: a base track that is the truth, or half of its motion."""

    def __init__(self, space, subject, meshes, share):
        moved = subject.neutral_m + share * (meshes - subject.neutral_m)
        self.neutral = subject.neutral_m.astype(float)
        self.base = canonical_meshes(moved, self.neutral, space.mouth.steady)

    def __len__(self):
        return len(self.base.meshes)


def own_truth(subject, meshes):
    return TrueMeshes(base_head().triangles, subject.neutral_m, {}, list(meshes).__getitem__)


def judged(space, seen, true, frames=FRAMES):
    return judge_against(space, seen, {}, true, np.arange(frames) / 30, person="a", take="b")


def test_truth_of_the_same_topology_is_taken_as_it_is(space, subject, meshes):
    true = own_truth(subject, meshes)
    tie = correspondence_of(space.model, space.mouth, np.asarray(space.model.vertices, float), true)
    carried = np.stack(list(carried_meshes(tie, true, FRAMES)))
    np.testing.assert_array_equal(carried[:, space.mouth.vertices], meshes[:, space.mouth.vertices])
    exact = judged(space, Seen(space, subject, meshes, 1.0), true)
    # files hold micrometres in float32
    assert exact.error_mm.max() < 1e-3
    assert np.abs(exact.gap_mm[0] - exact.gap_mm[1]).max() < 1e-3


def test_errors_do_not_see_another_topology(space, subject, meshes, twin):
    """A vertex of the coarse mesh lies on the finer one, at a vertex of it, so nothing but the correspondence errs.

    Its places on the neutral face are off by what `correspond` is tested for, 0.03 mm median; a motion that varies over the
    mouth by as much as itself within its half width, 25 mm, adds a share of the motion as small as that place's error is there.
    """
    own = judged(space, Seen(space, subject, meshes, 0.5), own_truth(subject, meshes))
    other = judged(space, Seen(space, subject, np.concatenate([meshes, meshes[:1]]), 0.5), twin, FRAMES + 1)
    assert not other.truth_known[-1]
    assert other.truth_known[:-1].all()
    perfect = judged(space, Seen(space, subject, np.concatenate([meshes, meshes[:1]]), 1.0), twin, FRAMES + 1)
    transfer = perfect.error_mm[0, :-1]
    assert transfer.max() < 0.2
    assert own.error_mm[0].mean() > 5 * transfer.mean()
    # the triangle inequality: neither comparison can be off by more than the transfer itself; the truth is larger by a tenth,
    # and errors are in its own millimetres
    assert (np.abs(SIZE * own.error_mm[0] - other.error_mm[0, :-1]) <= transfer + 1e-3).all()
    assert other.scale == pytest.approx(1 / SIZE, rel=2e-3)


def test_lips_behind_the_line_between_them_keep_their_shape(space, subject, tie):
    """What has no counterpart is carried along: no triangle of the mouth becomes a line."""
    corners = space.mouth.triangles[space.mouth.layer]

    def areas(mesh):
        a, b, c = np.moveaxis(mesh[corners], 1, 0)
        return np.linalg.norm(np.cross(b - a, c - a), axis=1)

    share = areas(tie.registered) / (SIZE**2 * areas(subject.neutral_m))
    assert share.min() > 1e-3
    assert np.percentile(share, 2) > 0.2


def test_sequences_and_templates_that_do_not_fit_are_refused(tmp_path, subject, meshes):
    save_chunk(tmp_path / "a.npy", meshes)
    sequence = MeshSequence("a", np.arange(FRAMES) / 30, (tmp_path / "a.npy",))
    head = base_head()
    template = head.with_vertices(subject.neutral_m)
    true = TrueMeshes.of_sequence(sequence, template, FRAMES)
    np.testing.assert_allclose(true.at(2), meshes[2], atol=1e-6)
    with pytest.raises(InputError, match="4 true meshes"):
        TrueMeshes.of_sequence(sequence, template, FRAMES + 1)
    part = template.part(head.regions["face"])[0]
    with pytest.raises(InputError, match="true meshes of"):
        TrueMeshes.of_sequence(sequence, part, FRAMES)


def test_a_topology_without_landmarks_is_refused(space, subject, twin):
    bare = TrueMeshes(twin.triangles, twin.neutral, {"nose_tip": 3}, twin.at)
    with pytest.raises(InputError, match="1 landmarks"):
        correspondence_of(space.model, space.mouth, subject.neutral_m, bare)


@pytest.mark.real
def test_the_rig_s_truth_is_paired_with_a_camera_by_its_clock(test_data):
    truth = Truth(test_data / "ict_rig" / "truth")
    true = TrueMeshes.of_rig(truth, "speech_01", "cam07", np.arange(73) / 60)
    start_s, take = truth.start_s("speech_01")["cam07"], truth.take("speech_01")
    assert true.at(0) is None  # the camera began before the truth does
    np.testing.assert_allclose(true.at(30), take.at(start_s + 0.5), atol=1e-12)
    # two lips that meet, corners left and right
    places = {name: true.neutral[vertex] for name, vertex in true.landmarks.items()}
    assert np.linalg.norm(places["mouth_upper"] - places["mouth_lower"]) < 3e-3
    assert places["mouth_corner_left"][0] > places["mouth_corner_right"][0] + 0.04
    for take, camera in (("shouting", "cam07"), ("speech_01", "cam99")):
        with pytest.raises(InputError, match="called"):
            TrueMeshes.of_rig(truth, take, camera, np.arange(3) / 60)
