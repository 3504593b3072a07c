"""The people of a study: frames read across files as if they were one, neutral heads in the model's frame."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from headcap.errors import InputError
from headcap.geometry.transforms import transform
from headcap.heads.procedural import base_head
from headcap.neck.subjects import NeckSubject, neutral_in_model_frame
from headcap.registration.sequence import JoinedMeshes, MeshSequence, save_chunk


def parts() -> list[np.ndarray]:
    random = np.random.default_rng(3)
    return [random.normal(size=(count, 5, 3)).astype(np.float32) for count in (4, 0, 1, 7)]


@pytest.mark.parametrize(
    "chosen", [slice(None), slice(2, 9), slice(20, 30), slice(None, None, 3), np.array([11, 0, 4]), np.arange(12) % 2 == 0]
)
def test_joined_frames_are_those_of_the_parts_in_a_row(chosen):
    np.testing.assert_array_equal(JoinedMeshes(parts(), 5)[chosen], np.concatenate(parts())[chosen])


def test_joining_nothing_gives_no_frames():
    assert JoinedMeshes([], 5).shape == (0, 5, 3)
    assert JoinedMeshes([], 5)[0:10].shape == (0, 5, 3)


def test_a_neutral_head_comes_back_from_any_place_in_the_room(model):
    placement = np.eye(4)
    placement[:3, :3], placement[:3, 3] = Rotation.from_rotvec([0.3, -1.0, 0.2]).as_matrix(), (0.4, 1.2, -0.3)
    head = base_head()
    found = neutral_in_model_frame(model, head.with_vertices(transform(placement, head.vertices)))
    # the model's vertices are the base head's, in double precision
    np.testing.assert_allclose(found, head.vertices, atol=1e-9)


def test_another_topology_is_refused(model):
    head = base_head()
    with pytest.raises(InputError, match="the topology of procedural"):
        neutral_in_model_frame(model, replace(head, triangles=head.triangles[:, ::-1]))


def test_takes_are_dealt_out_by_kind(model, tmp_path):
    head = base_head()
    sequences = {}
    for number, (name, frames) in enumerate({"nod": 3, "smile": 2, "talk": 4, "shake": 1}.items()):
        save_chunk(tmp_path / f"{name}.npy", np.full((frames, len(head.vertices), 3), number))
        sequences[name] = MeshSequence(name, np.arange(frames) / 30, (tmp_path / f"{name}.npy",))
    kinds = {"nod": "pose", "smile": "expression", "talk": "speech", "shake": "pose"}
    subject = NeckSubject.of(model, "ada", head, sequences, kinds)
    training = subject.training_subject()
    assert [int(mesh[0, 0]) for mesh in training.pose[:]] == [0, 0, 0, 3]
    assert len(training.expression) == 2
    assert training.seen is None
    assert [take.name for take in subject.of_kind("speech", "pose")] == ["nod", "talk", "shake"]
