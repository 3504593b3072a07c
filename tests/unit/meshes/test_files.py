"""Meshes out of files: every vertex once, in the file's order, whatever else the file says of it."""

import numpy as np
import pytest
import trimesh

from headcap.errors import InputError
from headcap.meshes.files import read_coloured_mesh, read_mesh
from headcap.meshes.normals import triangle_normals

CUBE = """
mtllib none.mtl
v 0 0 0
v 1 0 0 # a corner
v 1 1 0
v 0 1 0
  v 9 9 9 1.0
v 0 0 1e0
v 1 0 1
v 1 1 1
v 0 1 1
vt 0 0
vt 1 0
vt 1 1
vn 0 0 1
"""
UNUSED = 4
QUADS = np.array([[0, 3, 2, 1], [5, 6, 7, 8], [0, 1, 6, 5], [1, 2, 7, 6], [2, 3, 8, 7], [3, 0, 5, 8]])


def written(folder, faces, head=CUBE):
    path = folder / "mesh.obj"
    path.write_text(head + "".join(f"f {' '.join(face)}\n" for face in faces))
    return path


def fans(polygons):
    return np.array([(p[0], p[k], p[k + 1]) for p in polygons for k in range(1, len(p) - 1)])


@pytest.mark.parametrize("form", ["{}", "{}/{}", "{}/{}/1", "{}//1"])
@pytest.mark.parametrize("offset", [1, -9], ids=["from the first", "from the last"])
def test_obj_keeps_its_vertices_with_seams_quads_and_negative_indices(tmp_path, form, offset):
    # a texture coordinate by the corner's place in its face: every vertex lies on seams
    faces = [[form.format(vertex + offset, k % 3 + 1) for k, vertex in enumerate(quad)] for quad in QUADS]
    vertices, triangles = read_mesh(written(tmp_path, faces))
    assert (vertices.shape, vertices.dtype, triangles.dtype) == ((9, 3), np.float64, np.int32)
    assert np.array_equal(vertices[UNUSED], [9, 9, 9])
    assert np.array_equal(triangles, fans(QUADS))
    volume = np.einsum("nk,nk->", triangle_normals(vertices, triangles), vertices[triangles[:, 0]]) / 6
    assert abs(volume) == pytest.approx(1)


def test_obj_of_parts_counts_back_from_where_it_stands(tmp_path):
    path = tmp_path / "parts.obj"
    one = "o part\nusemtl {}\nv 0 0 {}\nv 1 0 0\nv 1 1 0\nv .5 1.5 0\nv 0 1 0\n"
    text = (
        one.format("b", 1)
        + "f -5 -4 -3 -2 -1\n"
        + one.format("a", 2)
        + "f -5 -4 -1 \\\n -2\r\n"
        + one.format("b", 3)
        + "f 1 8 15\n"
    )
    path.write_bytes(text.encode())
    vertices, triangles = read_mesh(path)
    assert np.array_equal(vertices[[0, 5, 10], 2], [1, 2, 3])
    assert len(vertices) == 15
    assert np.array_equal(triangles, fans([[0, 1, 2, 3, 4], [5, 6, 9, 8], [0, 7, 14]]))


@pytest.mark.parametrize("ending", ["ply", "obj", "off"])
def test_every_kind_of_file_gives_the_mesh_that_was_written(tmp_path, ending):
    ball = trimesh.creation.icosphere(2)
    order = np.random.default_rng(4).permutation(len(ball.vertices))
    vertices, triangles = np.array(ball.vertices)[np.argsort(order)], order[np.array(ball.faces)]
    trimesh.Trimesh(vertices, triangles, process=False).export(tmp_path / f"ball.{ending}")
    found, same = read_mesh(tmp_path / f"ball.{ending}")
    assert np.array_equal(same, triangles)
    assert np.allclose(found, vertices, atol=1e-7)


@pytest.mark.parametrize("ending", ["ply", "obj"])
def test_colours_stay_with_their_vertices(tmp_path, ending):
    ball = trimesh.creation.icosphere(2)
    colours = np.random.default_rng(5).integers(0, 256, (len(ball.vertices), 3), dtype=np.uint8)
    trimesh.Trimesh(ball.vertices, ball.faces, vertex_colors=colours, process=False).export(tmp_path / f"ball.{ending}")
    vertices, triangles, found = read_coloured_mesh(tmp_path / f"ball.{ending}")
    assert np.array_equal(triangles, ball.faces)
    assert np.allclose(vertices, ball.vertices, atol=1e-7)
    assert np.abs(found.astype(int) - colours).max() <= 1
    plain, _ = read_mesh(tmp_path / f"ball.{ending}")
    assert np.array_equal(vertices, plain)


def test_a_textured_obj_is_coloured_without_being_torn(tmp_path):
    from PIL import Image

    Image.fromarray(np.full((8, 8, 3), (200, 100, 50), np.uint8)).save(tmp_path / "skin.png")
    (tmp_path / "none.mtl").write_text("newmtl skin\nmap_Kd skin.png\n")
    faces = [[f"{vertex + 1}/{k % 3 + 1}" for k, vertex in enumerate(quad)] for quad in QUADS]
    plain = CUBE.replace(" # a corner", "").replace("  v 9 9 9 1.0", "v 9 9 9") + "usemtl skin\n"
    vertices, triangles, colours = read_coloured_mesh(written(tmp_path, faces, plain))
    assert vertices.shape == (9, 3)
    assert np.array_equal(triangles, fans(QUADS))
    assert np.array_equal(colours, np.tile([200, 100, 50], (9, 1)))


def test_an_obj_without_readable_colours_keeps_its_shape(tmp_path):
    vertices, _, colours = read_coloured_mesh(written(tmp_path, (QUADS + 1).astype(str)))
    assert len(vertices) == 9
    assert colours is None


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (None, "cannot be read"),
        ("", "no vertices"),
        ("v 1 2\nf 1 1 1\n", "cannot be read"),
        ("v 1 2 three\n", "cannot be read"),
        ("v 1 2 3\nv 1 2 4\nf 1 2\n", "a face of 2 corners"),
        ("v 1 2 3\nv 1 2 4\nf 1 2 3\n", "beyond its 2"),
        ("v 1 2 3\nv 1 2 4\nf 1 2 0\n", "beyond its 2"),
        ("v 1 2 3\nv 1 2 4\nf 1 2 one\n", "cannot be read"),
    ],
)
def test_broken_obj_is_refused(tmp_path, content, reason):
    path = tmp_path / "broken.obj"
    if content is not None:
        path.write_text(content)
    with pytest.raises(InputError, match=reason) as refused:
        read_mesh(path, expected="a head", remedy="Look again.")
    assert "a head" in str(refused.value)
    assert "Look again." in str(refused.value)
