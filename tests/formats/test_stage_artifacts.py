"""What stages hand to one another comes back from its file as it was."""

import dataclasses

import numpy as np
import pytest

from headcap.artifacts import ArtifactError
from headcap.reconstruction import PointCloud
from headcap.registration import MeshSequence, Template
from headcap.registration.sequence import save_chunk
from headcap.sync import TimeOffsets


def test_point_cloud(tmp_path):
    random = np.random.default_rng(0)
    cloud = PointCloud(
        positions=random.normal(size=(7, 3)).astype(np.float32),
        normals=random.normal(size=(7, 3)).astype(np.float32),
        confidence=random.uniform(size=7).astype(np.float32),
        colours=random.integers(0, 255, (7, 3), dtype=np.uint8),
        time_s=np.float64(0.1234567890123),
    )
    cloud.save(tmp_path / "a.ply")
    again = PointCloud.load(tmp_path / "a.ply")
    for field in dataclasses.fields(cloud):
        assert np.array_equal(getattr(again, field.name), getattr(cloud, field.name)), field.name


def test_point_cloud_refuses_a_stranger_and_a_stump(tmp_path):
    (tmp_path / "a.ply").write_bytes(b"ply\nformat ascii 1.0\nend_header\n")
    with pytest.raises(ArtifactError, match=r"is no headcap\.point_cloud/1"):
        PointCloud.load(tmp_path / "a.ply")
    one = np.zeros((1, 3), np.float32)
    PointCloud(one, one, np.ones(1, np.float32), np.zeros((1, 3), np.uint8), 0.0).save(tmp_path / "b.ply")
    (tmp_path / "b.ply").write_bytes((tmp_path / "b.ply").read_bytes()[:-31])
    with pytest.raises(ArtifactError, match="cut short"):
        PointCloud.load(tmp_path / "b.ply")


def test_template(tmp_path):
    triangles = np.array([[0, 1, 2]], np.int32)
    template = Template(
        vertices=np.eye(3),
        triangles=triangles,
        uv=np.eye(3)[:, :2],
        uv_triangles=triangles,
        regions={"face": np.array([True, False, True])},
        landmarks={"nose_tip": 1},
        texture=np.zeros((4, 4, 3), np.uint8),
        texture_known=np.ones((4, 4), bool),
    )
    template.save(tmp_path / "t.npz")
    again = Template.load(tmp_path / "t.npz")
    assert again.landmarks == template.landmarks
    assert np.array_equal(again.regions["face"], template.regions["face"])
    assert np.array_equal(again.vertices, template.vertices)


def test_sequence_reads_chunks_in_order_and_misses_none(tmp_path):
    positions = np.random.default_rng(0).normal(size=(5, 4, 3)).astype(np.float32)
    chunks = (tmp_path / "chunk_000.npy", tmp_path / "chunk_001.npy")
    save_chunk(chunks[0], positions[:3])
    save_chunk(chunks[1], positions[3:])
    MeshSequence("speech_01", np.arange(5) / 60, chunks).save(tmp_path / "sequence.json")
    again = MeshSequence.load(tmp_path / "sequence.json")
    assert np.array_equal(again.positions(), positions)
    assert np.array_equal(np.stack(list(again)), positions)
    chunks[1].unlink()
    with pytest.raises(ArtifactError, match="chunk_001"):
        MeshSequence.load(tmp_path / "sequence.json")


def test_time_offsets_are_inverse_and_saved(tmp_path):
    offsets = TimeOffsets("speech_01", ("a", "b"), (0.01, 0.12), (0.0, 25.0), (1.0, 0.9), ("clap", "clap"))
    times = np.linspace(0, 100, 7)
    # 100 s keep 1e-13 in float64
    assert np.abs(offsets.own_time("b", offsets.common_time("b", times)) - times).max() < 1e-12
    offsets.save(tmp_path / "o.json")
    assert TimeOffsets.load(tmp_path / "o.json") == offsets
