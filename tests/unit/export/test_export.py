"""What is exported reads back with positions, order, units, texture coordinates and picture as they were."""

import struct

import numpy as np
import pytest
import trimesh

from headcap.artifacts import ArtifactError
from headcap.export import read_pc2, write_glb, write_npz, write_obj, write_pc2
from headcap.export.seams import split_at_seams
from headcap.registration import MeshSequence, Template
from headcap.registration.sequence import save_chunk


@pytest.fixture
def template() -> Template:
    """Two triangles that share an edge, torn apart in the texture along it."""
    vertices = np.array([[0.0, 0, 0], [0.1, 0, 0], [0.1, 0.1, 0.02], [0, 0.1, 0]])
    uv = np.array([[0.1, 0.9], [0.4, 0.9], [0.4, 0.6], [0.6, 0.9], [0.9, 0.6], [0.6, 0.6]])
    texture = np.zeros((8, 8, 3), np.uint8)
    texture[7, 0] = 250, 10, 20  # u small, v large: the lower left of the picture
    return Template(
        vertices,
        np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        uv,
        np.array([[0, 1, 2], [3, 4, 5]], np.int32),
        texture=texture,
        texture_known=np.ones((8, 8), bool),
    )


@pytest.fixture
def sequence(template, tmp_path) -> MeshSequence:
    positions = np.stack([template.vertices + 0.01 * t for t in range(5)])
    save_chunk(tmp_path / "a.npy", positions[:3])
    save_chunk(tmp_path / "b.npy", positions[3:])
    return MeshSequence("take", np.arange(5) / 60, (tmp_path / "a.npy", tmp_path / "b.npy"))


def test_seams_split_the_vertices_on_them_and_no_others(template):
    split = split_at_seams(template)
    assert np.bincount(split.source).tolist() == [2, 1, 2, 1]
    np.testing.assert_array_equal(split.source[split.triangles], template.triangles)
    np.testing.assert_array_equal(split.uv[split.triangles], template.uv[template.uv_triangles])


def test_glb_reads_back(template, tmp_path):
    moved = template.vertices + np.array([0, 0, 0.5])
    write_glb(tmp_path / "head.glb", template, moved)
    mesh = next(iter(trimesh.load(tmp_path / "head.glb", process=False).geometry.values()))
    split = split_at_seams(template)
    np.testing.assert_allclose(mesh.vertices, moved[split.source], atol=1e-7)
    np.testing.assert_array_equal(mesh.faces, split.triangles)
    # trimesh hands v back counted upwards
    np.testing.assert_allclose(mesh.visual.uv, split.uv * [1, -1] + [0, 1], atol=1e-6)
    np.testing.assert_array_equal(np.asarray(mesh.visual.material.baseColorTexture.convert("RGB")), template.texture)


def test_glb_counts_v_downwards_inside(template, tmp_path):
    # glTF puts (0, 0) at the upper left of the picture, as the template does: the file must hold uv unchanged
    write_glb(tmp_path / "head.glb", template)
    content = (tmp_path / "head.glb").read_bytes()
    assert struct.unpack("<4sI", content[:8]) == (b"glTF", 2)
    assert split_at_seams(template).uv.astype("<f4").tobytes() in content


def test_obj_reads_back_in_the_templates_order(template, tmp_path):
    write_obj(tmp_path / "head.obj", template)
    lines = (tmp_path / "head.obj").read_text().splitlines()
    vertices = np.array([line.split()[1:] for line in lines if line.startswith("v ")], float)
    np.testing.assert_allclose(vertices, template.vertices, rtol=1e-8)
    coordinates = np.array([line.split()[1:] for line in lines if line.startswith("vt ")], float)
    np.testing.assert_allclose(coordinates, template.uv * [1, -1] + [0, 1], rtol=1e-8)
    assert lines[-1] == "f 1/4 3/5 4/6"
    loaded = trimesh.load(tmp_path / "head.obj", process=False)
    assert loaded.visual.material.image.size == (8, 8)


def test_pc2_reads_back_over_chunks(template, sequence, tmp_path):
    write_pc2(tmp_path / "take.pc2", sequence, first_frame=12)
    cache = read_pc2(tmp_path / "take.pc2")
    np.testing.assert_array_equal(cache.positions, sequence.positions())
    assert (cache.first_frame, cache.frames_per_sample) == (12.0, 1.0)


def test_pc2_header_is_the_published_one(sequence, tmp_path):
    write_pc2(tmp_path / "take.pc2", sequence)
    header = (tmp_path / "take.pc2").read_bytes()[:32]
    assert header == b"POINTCACHE2\0" + struct.pack("<iiffi", 1, 4, 0.0, 1.0, 5)


def test_a_damaged_pc2_is_refused(sequence, tmp_path):
    path = tmp_path / "take.pc2"
    write_pc2(path, sequence)
    path.write_bytes(path.read_bytes()[:-4])
    with pytest.raises(ArtifactError, match="cut short"):
        read_pc2(path)
    path.write_bytes(b"something else")
    with pytest.raises(ArtifactError, match="no PC2"):
        read_pc2(path)


def test_npz_opens_without_pickle(template, sequence, tmp_path):
    write_npz(tmp_path / "take.npz", template, sequence)
    with np.load(tmp_path / "take.npz", allow_pickle=False) as archive:
        np.testing.assert_array_equal(archive["verts"], sequence.positions())
        np.testing.assert_array_equal(archive["f"], template.triangles)
        np.testing.assert_allclose(archive["vt"][:, 1], 1 - template.uv[:, 1], rtol=1e-6)
        assert archive["v_template"].dtype == np.float32


def test_positions_of_another_topology_are_refused(template, tmp_path):
    with pytest.raises(ValueError, match="do not fit"):
        write_glb(tmp_path / "head.glb", template, np.zeros((3, 3)))
    with pytest.raises(ValueError, match="do not fit"):
        write_obj(tmp_path / "head.obj", template, np.zeros((3, 3)))
