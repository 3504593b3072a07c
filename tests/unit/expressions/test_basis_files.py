"""Shapes come in as they lie in their files, vertex by vertex, and what makes them useless is named."""

import json
import struct

import numpy as np
import pytest

from headcap.errors import InputError, InputErrors
from headcap.expressions import ExpressionBasis, QuasiEigenFaces
from headcap.expressions.basis_checks import BasisChecks, checked, offset_as_a_whole
from headcap.expressions.basis_files import model_basis, read_basis
from headcap.geometry.transforms import from_vector, transform
from headcap.heads import procedural_model

SIDE = 13
N = SIDE * SIDE
UP = np.array([0, 1.5, 0])
NAMES = ("jawOpen", "mouthSmile_L", "browUp", "blink")


def sheet():
    """A curved sheet of the size of a face: vertices (n, 3), quads and triangles."""
    x, y = np.meshgrid(np.linspace(-0.08, 0.08, SIDE), np.linspace(-0.1, 0.1, SIDE))
    vertices = np.stack([x.ravel(), y.ravel(), (0.05 - 3 * x**2 - 2 * y**2).ravel()], axis=1)
    corner = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).ravel()
    quads = np.stack([corner, corner + 1, corner + SIDE + 1, corner + SIDE], axis=1)
    return vertices, quads, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]], axis=1).reshape(-1, 3)


def bump(vertices, at, radius, direction):
    """A displacement (n, 3) that ends where the bump does."""
    near = np.clip(1 - np.square((vertices[:, :2] - at) / radius).sum(axis=1), 0, None) ** 2
    return near[:, None] * np.asarray(direction)


@pytest.fixture
def basis():
    vertices, _, triangles = sheet()
    shapes = [
        bump(vertices, (0.0, -0.06), 0.05, (0, -0.02, -0.004)),
        bump(vertices, (0.04, -0.04), 0.03, (0.008, 0.006, 0)),
        bump(vertices, (0.0, 0.06), 0.04, (0, 0.007, 0.001)),
        bump(vertices, (0.03, 0.03), 0.02, (0, -0.009, 0.002)),
    ]
    return ExpressionBasis(NAMES, vertices, shapes, triangles)


def write_obj(path, vertices, quads, *, seam=False, scale=1.0):
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in (scale * np.asarray(vertices, float)).tolist()]
    if seam:
        lines += [f"vt {k / (4 * len(quads)):.9g} 0.5" for k in range(4 * len(quads))]
        lines += [
            "f " + " ".join(f"{v + 1}/{4 * i + k + 1}" for k, v in enumerate(quad)) for i, quad in enumerate(quads.tolist())
        ]
    else:
        lines += ["f " + " ".join(str(v + 1) for v in quad) for quad in quads.tolist()]
    path.write_text("\n".join(lines) + "\n")


@pytest.fixture
def folder(tmp_path, basis):
    """As a modelling program leaves them: quads, texture coordinates of their own at every corner, millimetres."""
    quads = sheet()[1]
    folder = tmp_path / "shapes"
    folder.mkdir()
    write_obj(folder / "Neutral.obj", basis.neutral, quads, seam=True, scale=1e3)
    for name, displacement in zip(basis.names, basis.displacements, strict=True):
        shape = basis.neutral.astype(float) + displacement
        write_obj(folder / f"{name}.obj", shape, quads, seam=True, scale=1e3)
    return folder


def replaced(basis, name, displacement):
    """The basis with one shape changed."""
    shapes = basis.displacements.copy()
    shapes[basis.names.index(name)] = displacement
    return ExpressionBasis(basis.names, basis.neutral, shapes, basis.triangles)


# -- a folder of meshes --------------------------------------------------------------------------------------------------------


def test_a_folder_gives_every_vertex_its_number_whatever_seams_say(folder, basis):
    found = read_basis(folder, unit="mm")
    assert found.names == tuple(sorted(NAMES))
    order = [found.names.index(name) for name in NAMES]
    # nine digits of positions below 0.1 m, twice
    np.testing.assert_allclose(found.displacements[order], basis.displacements, atol=1.1e-9)
    np.testing.assert_allclose(found.neutral, basis.neutral, atol=1e-8)
    np.testing.assert_array_equal(found.triangles, basis.triangles)


def test_ply_and_obj_lie_in_one_folder(folder, basis):
    import trimesh

    shape = 1e3 * (basis.neutral.astype(float) + basis.displacements[3])
    (folder / "blink.obj").unlink()
    trimesh.Trimesh(shape, basis.triangles[::-1], process=False).export(folder / "blink.ply")
    found = read_basis(folder, unit="mm")
    # ply holds single precision: of 100 mm
    np.testing.assert_allclose(found.displacements[found.names.index("blink")], basis.displacements[3], atol=2e-8)


def test_the_neutral_face_may_be_named_or_lie_elsewhere(folder, basis, tmp_path):
    rest = (folder / "Neutral.obj").rename(folder / "frame_0.obj")
    with pytest.raises(InputError, match="no neutral face among the 5"):
        read_basis(folder, unit="mm")
    by_name = read_basis(folder, neutral="frame_0", unit="mm")
    elsewhere = read_basis(folder, neutral=rest.rename(tmp_path / "elsewhere.obj"), unit="mm")
    np.testing.assert_array_equal(by_name.displacements, elsewhere.displacements)
    with pytest.raises(InputError, match="no neutral face nowhere"):
        read_basis(folder, neutral="nowhere", unit="mm")


def test_two_neutral_faces_are_named(folder):
    (folder / "rest.obj").write_bytes((folder / "Neutral.obj").read_bytes())
    with pytest.raises(InputError, match=r"Neutral\.obj, rest\.obj"):
        read_basis(folder, unit="mm")


def test_another_topology_is_told_with_file_and_count(folder):
    lines = (folder / "browUp.obj").read_text().splitlines()
    (folder / "browUp.obj").write_text("\n".join([*lines, "v 0 0 0"]))
    with pytest.raises(InputError, match=rf"browUp\.obj of {N + 1} vertices.*expected {N} and .* as Neutral\.obj"):
        read_basis(folder, unit="mm")


def test_vertices_joined_in_another_way_are_another_topology(folder, basis):
    quads = sheet()[1][:, [1, 2, 3, 0]]
    write_obj(folder / "browUp.obj", basis.neutral, quads, scale=1e3)
    with pytest.raises(InputError, match=r"browUp\.obj .* joined in another way"):
        read_basis(folder, unit="mm")


def test_a_wrong_unit_is_told_by_its_size(folder):
    with pytest.raises(InputError, match="200 m across"):
        read_basis(folder)
    with pytest.raises(InputError, match="unit 'furlong'"):
        read_basis(folder, unit="furlong")


@pytest.mark.parametrize("other", ["blink.ply", "BLINK.obj"])
def test_one_name_in_two_files_is_refused(folder, other):
    (folder / other).write_bytes((folder / "blink.obj").read_bytes())
    with pytest.raises(InputError, match="one file per shape"):
        read_basis(folder, unit="mm")


def test_a_folder_without_meshes_and_paths_that_are_no_basis_are_refused(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "broken.npz").write_text("x")
    np.savez(tmp_path / "other.npz", a=np.zeros(2))
    for name, told in (("empty", "no mesh in"), ("absent", "no file"), ("notes.txt", "notes.txt as a basis")):
        with pytest.raises(InputError, match=told):
            read_basis(tmp_path / name)
    for name in ("broken.npz", "other.npz"):
        with pytest.raises(InputError, match=name):
            read_basis(tmp_path / name)


def test_a_folder_with_the_neutral_face_alone_is_no_basis(folder):
    for name in NAMES:
        (folder / f"{name}.obj").unlink()
    with pytest.raises(InputError, match="without shapes"):
        read_basis(folder, unit="mm")


# -- what makes shapes useless -------------------------------------------------------------------------------------------------


def test_flat_and_doubled_shapes_are_all_told_at_once(basis, folder):
    (folder / "browUp.obj").write_bytes((folder / "Neutral.obj").read_bytes())
    (folder / "blink.obj").write_bytes((folder / "jawOpen.obj").read_bytes())
    with pytest.raises(InputErrors) as caught:
        read_basis(folder, unit="mm")
    told = str(caught.value)
    assert "flat shapes: browUp.obj" in told
    assert "blink.obj and jawOpen.obj are one shape" in told


def test_a_scaled_shape_is_no_double_and_a_copy_with_noise_is(basis, rng):
    half = replaced(basis, "blink", 0.5 * basis.displacements[0])
    assert checked(half) is half
    noise = rng.normal(0, 1e-4 * np.sqrt(np.square(basis.displacements[0]).mean()), (N, 3))
    with pytest.raises(InputError, match="jawOpen and blink are one shape"):
        checked(replaced(basis, "blink", basis.displacements[0] + noise))


def test_numbers_that_are_none_are_counted_by_shape(basis):
    broken = basis.displacements[2].copy()
    broken[[3, 5]] = np.nan
    with pytest.raises(InputError, match=r"browUp \(2\)"):
        checked(replaced(basis, "browUp", broken))


def test_names_that_differ_in_case_alone_are_one_name(basis):
    with pytest.raises(InputError, match="Blink and blink"):
        checked(ExpressionBasis((*NAMES[:2], "Blink", "blink"), basis.neutral, basis.displacements, basis.triangles))


def test_a_shape_that_was_moved_as_a_whole_is_told_and_brought_back(basis):
    away = from_vector(np.array([0.0, np.deg2rad(2.0), 0.0, 0.0, 0.01, 0.0]))
    neutral = basis.neutral.astype(float)
    moved = replaced(basis, "browUp", transform(away, neutral + basis.displacements[2]) - neutral)
    with pytest.raises(InputError, match=r"browUp by 10\.\d+ mm and 2\.00 degrees"):
        checked(moved)
    found = checked(moved, align=True)
    # what single precision of the displacement leaves, as the lever of the placement shows it
    np.testing.assert_allclose(found.displacements, basis.displacements, atol=1e-7)
    assert checked(basis, align=True) is basis


def test_no_rigid_motion_is_seen_in_shapes_that_move_everything(basis, rng):
    neutral = basis.neutral.astype(float)
    stretched = neutral * [1.05, 0.97, 1.02]
    assert offset_as_a_whole(neutral, stretched) is None
    scanned = neutral + rng.normal(0, 5e-4, neutral.shape)
    assert offset_as_a_whole(neutral, scanned) is None


def test_a_neutral_face_that_is_none_is_told_with_the_place(basis):
    smile = bump(basis.neutral, (-0.04, -0.04), 0.03, (-0.006, 0.004, 0))
    shifted = ExpressionBasis(NAMES, basis.neutral + smile, basis.displacements - smile, basis.triangles)
    worst = int(np.linalg.norm(smile, axis=1).argmax())
    with pytest.raises(InputError, match=rf"most shapes leave the neutral face alike .* at vertex {worst}"):
        checked(shifted, align=True)


def test_a_neutral_face_that_lies_elsewhere_is_told_and_the_shapes_come_to_it(basis):
    away = from_vector(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.02]))
    neutral = transform(away, basis.neutral.astype(float))
    # one shape moves so much that its own placement could not be told
    basis = replaced(basis, "jawOpen", 0.004 * np.random.default_rng(1).normal(size=(N, 3)))
    elsewhere = ExpressionBasis(NAMES, neutral, basis.neutral + basis.displacements - neutral, basis.triangles)
    with pytest.raises(InputError, match=r"the neutral face lies 20\.00 mm and 0\.00 degrees"):
        checked(elsewhere)
    np.testing.assert_allclose(checked(elsewhere, align=True).displacements, basis.displacements, atol=1e-7)


def test_the_limits_are_settings(basis):
    with pytest.raises(InputError, match="flat shapes: browUp, blink"):
        checked(basis, checks=BasisChecks(flat_mm=np.linalg.norm(basis.displacements[3], axis=1).max() * 1e3))


# -- npz and head models -------------------------------------------------------------------------------------------------------


def test_npz_of_a_basis_of_quasi_eigen_faces_and_of_a_head_model_are_told_apart(basis, tmp_path):
    from headcap.expressions import Eigenfaces

    basis.save(tmp_path / "basis.npz")
    eigen = Eigenfaces(np.zeros((N, 3), np.float32), basis.displacements, np.arange(4.0, 0, -1), 10.0)
    QuasiEigenFaces(replaced(basis, "blink", 2 * basis.displacements[3]), eigen, basis, np.eye(4), ()).save(
        tmp_path / "quasi.npz"
    )
    model = procedural_model()
    model.save(tmp_path / "head.npz")
    for name in ("basis.npz", "quasi.npz"):
        np.testing.assert_array_equal(read_basis(tmp_path / name).displacements, basis.displacements)
    found = read_basis(tmp_path / "head.npz")
    assert found.names == model_basis(model).names
    np.testing.assert_array_equal(found.displacements, model.expression_basis)


def test_a_models_shapes_stand_on_the_identity_given(rng):
    model = procedural_model()
    identity = model.identity(rng.normal(size=len(model.shape_basis)))
    found = model_basis(model, identity, jaw_deg=10.0)
    weights = rng.uniform(0, 1, len(model.expression_basis)).astype(np.float32)
    expected = identity + np.einsum("k,kni->ni", weights, model.expression_basis)
    np.testing.assert_allclose(found.blend(np.append(weights, 0)), expected, atol=1e-6)
    # the chin goes down and back, the crown stays
    chin = found.displacements[-1, model.landmarks["chin"]]
    assert chin[1] < -0.005
    assert chin[2] < 0
    assert np.abs(found.displacements[-1, model.vertices[:, 1].argmax()]).max() < 1e-6
    with pytest.raises(InputError, match="an identity of"):
        model_basis(model, identity[:-1])


# -- glTF as other programs write it -------------------------------------------------------------------------------------------


class Gltf:
    """A document of plain dictionaries, so that nothing of what is tested has a part in it."""

    def __init__(self):
        self.data, self.views, self.accessors = b"", [], []

    def view(self, array):
        self.views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": array.nbytes})
        self.data += array.tobytes() + b"\0" * (-array.nbytes % 4)
        return len(self.views) - 1

    def accessor(self, array, kind, component=5126, **more):
        entry = {"bufferView": self.view(array), "componentType": component, "count": len(array), "type": kind}
        self.accessors.append(entry | more)
        return len(self.accessors) - 1

    def sparse(self, count, rows, values):
        told = {
            "count": len(rows),
            "indices": {"bufferView": self.view(rows.astype("<u2")), "componentType": 5123},
            "values": {"bufferView": self.view(values.astype("<f4"))},
        }
        self.accessors.append({"componentType": 5126, "count": count, "type": "VEC3", "sparse": told})
        return len(self.accessors) - 1

    def save(self, path, meshes, nodes):
        document = {
            "asset": {"version": "2.0", "generator": "another program"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": nodes,
            "meshes": meshes,
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{"byteLength": len(self.data)}],
        }
        if path.suffix == ".gltf":
            document["buffers"][0]["uri"] = "face data.bin"
            (path.parent / "face data.bin").write_bytes(self.data)
            path.write_text(json.dumps(document))
            return
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        body = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(self.data), 0x004E4942) + self.data
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)


def split_gltf(path, basis, *, names=NAMES, meshes=1):
    """Two primitives, every corner a vertex of its own, one target sparse, under a node that turns, scales and shifts."""
    gltf, half = Gltf(), len(basis.triangles) // 2
    primitives = []
    for triangles in (basis.triangles[:half], basis.triangles[half:]):
        corners = triangles.ravel()
        targets = []
        for shape in basis.displacements[:-1]:
            targets.append({"POSITION": gltf.accessor(np.ascontiguousarray(shape[corners], "<f4"), "VEC3")})
        last = basis.displacements[-1][corners]
        rows = np.flatnonzero(last.any(axis=1))
        targets.append({"POSITION": gltf.sparse(len(corners), rows, last[rows]) if len(rows) else gltf.accessor(last, "VEC3")})
        attributes = {
            "POSITION": gltf.accessor(np.ascontiguousarray(basis.neutral[corners], "<f4"), "VEC3"),
            "TEXCOORD_0": gltf.accessor(np.arange(2 * len(corners), dtype="<f4").reshape(-1, 2), "VEC2"),
        }
        indices = gltf.accessor(np.arange(len(corners), dtype="<u2"), "SCALAR", 5123)
        primitives.append({"attributes": attributes, "indices": indices, "targets": targets})
    face = {"name": "face", "primitives": primitives}
    if names:
        face["extras"] = {"targetNames": list(names)}
    nodes = [
        {"children": [1], "translation": [0.0, 1.5, 0.0]},
        {"mesh": 0, "rotation": [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)], "scale": [2.0, 2.0, 2.0]},
    ]
    gltf.save(path, [face | {"name": f"face{i}"} for i in range(meshes)], nodes)


def placed(vectors):
    """By the node: a quarter turn about x, twice the size."""
    return 2 * vectors @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]).T


def test_gltf_split_at_every_corner_is_one_surface_again(basis, tmp_path):
    split_gltf(tmp_path / "face.glb", basis)
    found = read_basis(tmp_path / "face.glb")
    assert found.names == NAMES
    assert len(found.neutral) == N
    # by the order in which corners name them
    order = basis.triangles.ravel()[np.sort(np.unique(basis.triangles.ravel(), return_index=True)[1])]
    np.testing.assert_array_equal(order[found.triangles], basis.triangles)
    # single precision of 1.7 m and of 4 cm
    np.testing.assert_allclose(found.neutral, placed(basis.neutral[order]) + UP, atol=2e-7)
    np.testing.assert_allclose(found.displacements, placed(basis.displacements[:, order]), atol=5e-9)


def test_gltf_with_its_numbers_in_a_file_beside_reads_alike(basis, tmp_path):
    split_gltf(tmp_path / "face.glb", basis)
    split_gltf(tmp_path / "face.gltf", basis)
    one, two = read_basis(tmp_path / "face.glb"), read_basis(tmp_path / "face.gltf")
    np.testing.assert_array_equal(one.displacements, two.displacements)


def test_gltf_of_whole_numbers_that_stand_for_shares(basis, tmp_path):
    """As packers write it (KHR_mesh_quantization): 16 bits normalised, the node's scale brings metres back."""
    gltf, size = Gltf(), 0.125

    def packed(vectors):
        # rows begin at multiples of four bytes
        rows = np.zeros((N, 4), "<i2")
        rows[:, :3] = np.rint(vectors / size * 32767)
        number = gltf.accessor(rows, "VEC3", 5122, normalized=True)
        gltf.views[gltf.accessors[number]["bufferView"]]["byteStride"] = 8
        return number

    primitive = {
        "attributes": {"POSITION": packed(basis.neutral)},
        "indices": gltf.accessor(basis.triangles.ravel().astype("<u2"), "SCALAR", 5123),
        "targets": [{"POSITION": packed(shape)} for shape in basis.displacements],
    }
    face = {"primitives": [primitive], "extras": {"targetNames": list(NAMES)}}
    gltf.save(tmp_path / "face.glb", [face], [{"mesh": 0, "scale": [size] * 3}])
    found = read_basis(tmp_path / "face.glb")
    # half a step, and single precision
    np.testing.assert_allclose(found.neutral, basis.neutral, atol=0.51 * size / 32767)
    np.testing.assert_allclose(found.displacements, basis.displacements, atol=0.51 * size / 32767)


def test_vertices_that_part_in_some_shape_stay_two(basis, tmp_path):
    """As lips do that touch at rest: the sheet is torn along a row that only one shape opens."""
    row = np.arange(6 * SIDE, 7 * SIDE)
    twins = np.arange(N, N + SIDE)
    neutral = np.concatenate([basis.neutral, basis.neutral[row]])
    shapes = np.concatenate([basis.displacements, basis.displacements[:, row]], axis=1)
    shapes[0, twins] += (0, 0.004, 0)
    below = (basis.triangles >= row[-1] + 1).any(axis=1)
    triangles = basis.triangles.copy()
    lips = below[:, None] & np.isin(triangles, row)
    triangles[lips] = twins[np.searchsorted(row, triangles[lips])]
    split_gltf(tmp_path / "lips.glb", ExpressionBasis(NAMES, neutral, shapes, triangles))
    assert len(read_basis(tmp_path / "lips.glb").neutral) == N + SIDE


def test_gltf_without_names_numbers_its_shapes(basis, tmp_path):
    split_gltf(tmp_path / "face.glb", basis, names=())
    assert read_basis(tmp_path / "face.glb").names == ("shape_000", "shape_001", "shape_002", "shape_003")


def test_gltf_with_shapes_on_several_meshes_asks_which(basis, tmp_path):
    split_gltf(tmp_path / "faces.glb", basis, meshes=2)
    with pytest.raises(InputError, match="face0, face1"):
        read_basis(tmp_path / "faces.glb")
    assert len(read_basis(tmp_path / "faces.glb", part="face0")) == 4
    with pytest.raises(InputError, match="expected teeth"):
        read_basis(tmp_path / "faces.glb", part="teeth")


def test_gltf_with_one_name_for_two_shapes_is_refused(basis, tmp_path):
    split_gltf(tmp_path / "face.glb", basis, names=("a", "b", "c", "a"))
    with pytest.raises(InputError, match="names a and a"):
        read_basis(tmp_path / "face.glb")


def test_damaged_files_are_told_as_such(basis, tmp_path):
    split_gltf(tmp_path / "face.glb", basis)
    content = (tmp_path / "face.glb").read_bytes()
    (tmp_path / "face.glb").write_bytes(content[: len(content) // 3])
    (tmp_path / "face.usda").write_text("#usda 1.0\ndef Mesh {")
    for name in ("face.glb", "face.usda"):
        with pytest.raises(InputError, match=f"{name} cannot be read"):
            read_basis(tmp_path / name)


# -- USD as other programs write it --------------------------------------------------------------------------------------------


def write_usd(path, basis, quads, *, up="Z", names=NAMES):
    """Centimetres, z up, quads, left-handed, under a prim that shifts; shapes with and without point numbers."""

    def told(array):
        return "[" + ", ".join(f"({x:.9g}, {y:.9g}, {z:.9g})" for x, y, z in np.asarray(array, float).tolist()) + "]"

    def turned(vectors):
        return 100 * (np.stack([vectors[:, 0], -vectors[:, 2], vectors[:, 1]], axis=1) if up == "Z" else vectors)

    shapes = ""
    for i, shape in enumerate(basis.displacements.astype(float)):
        rows = np.flatnonzero(shape.any(axis=1)) if i % 2 else np.arange(N)
        numbers = f"int[] pointIndices = {rows.tolist()}" if i % 2 else ""
        shapes += f'def BlendShape "shape{i}" {{ vector3f[] offsets = {told(turned(shape[rows]))}\n{numbers}\n}}\n'
    path.write_text(f"""#usda 1.0
( metersPerUnit = 0.01
  upAxis = "{up}" )
def SkelRoot "Character" {{
  double3 xformOp:translate = (0, 0, 150)
  uniform token[] xformOpOrder = ["xformOp:translate"]
  def Mesh "face" ( prepend apiSchemas = ["SkelBindingAPI"] ) {{
    point3f[] points = {told(turned(basis.neutral))}
    int[] faceVertexCounts = {[4] * len(quads)}
    int[] faceVertexIndices = {quads[:, ::-1].ravel().tolist()}
    uniform token orientation = "leftHanded"
    uniform token[] skel:blendShapes = [{", ".join(f'"{name}"' for name in names)}]
    rel skel:blendShapeTargets = [{", ".join(f"</Character/face/shape{i}>" for i in range(len(basis)))}]
    {shapes}
  }}
}}
""")


def test_usd_in_centimetres_with_z_up_is_metres_with_y_up(basis, tmp_path):
    write_usd(tmp_path / "face.usda", basis, sheet()[1])
    found = read_basis(tmp_path / "face.usda")
    assert found.names == NAMES
    # single precision of 1.6 m, of 2 cm
    np.testing.assert_allclose(found.neutral, basis.neutral + UP, atol=2e-7)
    np.testing.assert_allclose(found.displacements, basis.displacements, atol=3e-9)
    outside = np.cross(*(found.neutral[found.triangles[:, k]] - found.neutral[found.triangles[:, 0]] for k in (1, 2)))
    assert (outside[:, 2] > 0).all()


def test_usd_without_shapes_or_with_shapes_of_other_points_is_refused(basis, tmp_path):
    write_usd(tmp_path / "face.usda", basis, sheet()[1])
    text = (tmp_path / "face.usda").read_text()
    (tmp_path / "none.usda").write_text(text.replace("rel skel:blendShapeTargets", "rel other"))
    with pytest.raises(InputError, match=r"none\.usda: none"):
        read_basis(tmp_path / "none.usda")
    (tmp_path / "short.usda").write_text(text.replace("int[] pointIndices = [", "int[] pointIndices = [0, "))
    with pytest.raises(InputError, match=r"mouthSmile_L of short\.usda: \d+ offsets for \d+ of 169 points"):
        read_basis(tmp_path / "short.usda")
