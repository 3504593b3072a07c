"""Bases and weights that go out come in again: displacements, names, order; and other programs see the same faces."""

import json
import struct

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.export import write_basis
from headcap.expressions import ExpressionBasis
from headcap.expressions.basis_files import read_basis
from headcap.expressions.weight_curves import WeightCurves, read_weights, write_weights

SIDE = 9
NAMES = ("zygomatic", "jawOpen", "brow up/left", "1st", "Ünder", "neutral")
"""In no order, and not all of them names of files or prims."""


@pytest.fixture
def basis(rng):
    x, y = np.meshgrid(np.linspace(-0.08, 0.08, SIDE), np.linspace(-0.1, 0.1, SIDE))
    vertices = np.stack([x.ravel(), y.ravel(), (0.05 - 3 * x**2 - 2 * y**2).ravel()], axis=1)
    corner = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).ravel()
    triangles = np.concatenate(
        [np.stack([corner, corner + 1, corner + SIDE], 1), np.stack([corner + 1, corner + SIDE + 1, corner + SIDE], 1)]
    )
    shapes = 0.01 * rng.normal(size=(len(NAMES), SIDE * SIDE, 3))
    # local and global ones: sparse targets and full ones
    for i in range(4):
        shapes[i, (np.arange(SIDE * SIDE) // SIDE) != i] = 0
    return ExpressionBasis(NAMES, vertices, shapes, triangles)


@pytest.fixture
def curves(rng):
    return WeightCurves(NAMES, 2.0 + np.arange(7) / 30, rng.uniform(-0.1, 1.1, (7, len(NAMES))))


@pytest.mark.parametrize(
    ("name", "atol"),
    # text has nine digits: half a unit of 1e-9 in each of two positions below 1 m, and single precision of what is read
    [("set", 1e-9), ("face.glb", 0), ("face.usda", 0), ("face.usdc", 0), ("face.usd", 0), ("face.npz", 0)],
)
def test_a_basis_that_goes_out_comes_in(basis, tmp_path, name, atol):
    write_basis(tmp_path / name, basis)
    found = read_basis(tmp_path / name)
    assert found.names == basis.names
    np.testing.assert_array_equal(found.neutral, basis.neutral)
    np.testing.assert_allclose(found.displacements, basis.displacements, rtol=1.2e-7 if atol else 0, atol=atol)
    np.testing.assert_array_equal(found.triangles, basis.triangles)


@pytest.mark.real
def test_ict_facekits_basis_goes_out_and_comes_in(test_data, tmp_path):
    basis = read_basis(test_data / "ict_head" / "ict_head.npz")
    assert len(basis) == 53
    for name in ("face.glb", "face.usdc"):
        write_basis(tmp_path / name, basis)
        found = read_basis(tmp_path / name)
        assert found.names == basis.names
        np.testing.assert_array_equal(found.displacements, basis.displacements)
    # the OBJ set of a few is the text of them all
    names = ("jawOpen", "browDown_L", "mouthRollLower")
    few = basis.chosen(np.array([basis.names.index(name) for name in names]))
    write_basis(tmp_path / "set", few)
    found = read_basis(tmp_path / "set")
    assert found.names == names
    # nine digits of positions below 1 m, twice
    np.testing.assert_allclose(found.displacements, few.displacements, rtol=1.2e-7, atol=1e-9)


def test_another_reader_of_obj_sees_the_shapes(basis, tmp_path):
    import trimesh

    write_basis(tmp_path / "set", basis)
    index = json.loads((tmp_path / "set" / "shapes.json").read_text())
    assert [entry["name"] for entry in index["shapes"]] == list(NAMES)
    for entry, shape in zip(index["shapes"], basis.displacements, strict=True):
        mesh = trimesh.load(tmp_path / "set" / entry["file"], process=False, maintain_order=True)
        np.testing.assert_allclose(mesh.vertices, basis.neutral.astype(float) + shape, atol=1e-9)
        np.testing.assert_array_equal(mesh.faces, basis.triangles)


def test_a_set_without_its_index_is_read_by_the_names_of_its_files(basis, tmp_path):
    write_basis(tmp_path / "set", basis.chosen([0, 1]))
    (tmp_path / "set" / "shapes.json").unlink()
    found = read_basis(tmp_path / "set")
    assert found.names == ("jawOpen", "zygomatic")


def test_a_set_replaces_a_set_and_nothing_else(basis, tmp_path):
    write_basis(tmp_path / "set", basis)
    write_basis(tmp_path / "set", basis.chosen([1, 0]))
    assert sorted(file.name for file in (tmp_path / "set").iterdir()) == [
        "jawOpen.obj", "neutral.obj", "shapes.json", "zygomatic.obj"
    ]  # fmt: skip
    assert [entry.name for entry in tmp_path.iterdir()] == ["set"]
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="holds something else"):
        write_basis(tmp_path / "mine", basis)
    assert (tmp_path / "mine" / "notes.txt").read_text() == "mine"


def test_a_set_that_fails_half_way_leaves_the_old_one(basis, tmp_path, monkeypatch):
    write_basis(tmp_path / "set", basis.chosen([0]))
    monkeypatch.setattr("headcap.export.expressions.json.dumps", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        write_basis(tmp_path / "set", basis)
    monkeypatch.undo()
    assert read_basis(tmp_path / "set").names == ("zygomatic",)
    assert [entry.name for entry in tmp_path.iterdir()] == ["set"]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda index: index["shapes"][0].update(file="gone.obj"), "no gone.obj"),
        (lambda index: index.pop("neutral"), "without 'neutral'"),
        (lambda index: index.update(unit="ell"), "unit 'ell'"),
        (lambda index: index["shapes"].append(index["shapes"][0]), "6 names for 7 shapes"),
    ],
)
def test_an_index_that_does_not_fit_its_folder_is_told(basis, tmp_path, change, told):
    write_basis(tmp_path / "set", basis)
    index = json.loads((tmp_path / "set" / "shapes.json").read_text())
    change(index)
    (tmp_path / "set" / "shapes.json").write_text(json.dumps(index))
    with pytest.raises(InputError, match=told):
        read_basis(tmp_path / "set")


def glb(path):
    from pygltflib import GLTF2

    return GLTF2().load(str(path))


def test_glb_tells_names_bounds_and_the_animation(basis, curves, tmp_path):
    write_basis(tmp_path / "face.glb", basis, curves)
    gltf = glb(tmp_path / "face.glb")
    mesh, blob = gltf.meshes[0], gltf.binary_blob()
    assert mesh.extras["targetNames"] == list(NAMES)
    assert len(mesh.weights) == len(mesh.primitives[0].targets) == len(NAMES)
    positions = [mesh.primitives[0].attributes.POSITION, *(target["POSITION"] for target in mesh.primitives[0].targets)]
    for number, array in zip(positions, [basis.neutral, *basis.displacements], strict=True):
        accessor = gltf.accessors[number]
        np.testing.assert_array_equal([accessor.min, accessor.max], [array.min(axis=0), array.max(axis=0)])
    # few vertices move in the first four
    assert [gltf.accessors[number].sparse is not None for number in positions] == [False, *[True] * 4, False, False]
    (channel,), (sampler,) = gltf.animations[0].channels, gltf.animations[0].samplers
    assert (channel.target.path, channel.target.node, sampler.interpolation) == ("weights", 0, "LINEAR")

    def floats(number):
        view = gltf.bufferViews[gltf.accessors[number].bufferView]
        return np.frombuffer(blob, "<f4", gltf.accessors[number].count, view.byteOffset)

    np.testing.assert_allclose(floats(sampler.input), np.arange(7) / 30, atol=1e-7)
    np.testing.assert_array_equal(floats(sampler.output).reshape(7, -1), curves.weights.astype(np.float32))


def test_glb_has_no_offset_into_no_view(basis, tmp_path):
    """What the format's validator refuses (UNSATISFIED_DEPENDENCY) and the library writes by default."""
    write_basis(tmp_path / "face.glb", basis)
    content = (tmp_path / "face.glb").read_bytes()
    (length,) = struct.unpack("<I", content[12:16])
    accessors = json.loads(content[20 : 20 + length])["accessors"]
    assert sum("sparse" in accessor for accessor in accessors) >= 4
    assert all("bufferView" in accessor or "byteOffset" not in accessor for accessor in accessors)
    assert len(content) == struct.unpack("<I", content[8:12])[0]


def test_normals_of_glb_follow_the_shapes(basis, tmp_path):
    from headcap.expressions.basis_gltf import _Document
    from headcap.meshes.normals import vertex_normals

    write_basis(tmp_path / "face.glb", basis)
    document = _Document(tmp_path / "face.glb")
    primitive = document.gltf.meshes[0].primitives[0]
    rest = document.array(document.gltf.accessors[primitive.attributes.NORMAL])
    for target, shape in zip(primitive.targets, basis.displacements, strict=True):
        turned = rest + document.array(document.gltf.accessors[target["NORMAL"]])
        # the formula's vertices are rounded to single precision before: 1e-8 m over edges of a centimetre
        np.testing.assert_allclose(turned, vertex_normals(basis.neutral.astype(float) + shape, basis.triangles), atol=1e-4)


def test_usd_plays_the_weights_as_eq_1_has_it(basis, curves, tmp_path):
    from pxr import Gf, Usd, UsdGeom, UsdSkel

    write_basis(tmp_path / "face.usdc", basis, curves)
    stage = Usd.Stage.Open(str(tmp_path / "face.usdc"))
    assert (stage.GetTimeCodesPerSecond(), stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (30, 60, 66)
    assert UsdSkel.BakeSkinning(UsdSkel.Root(stage.GetDefaultPrim()), Gf.Interval(60, 66))
    points = UsdGeom.Mesh(stage.GetPrimAtPath("/Head/face")).GetPointsAttr()
    for frame, row in enumerate(curves.weights):
        # single precision of 0.1 m, summed over six shapes
        np.testing.assert_allclose(np.array(points.Get(60 + frame)), basis.blend(row), atol=1e-7)


def test_weights_that_do_not_fit_are_refused(basis, curves, tmp_path):
    fewer = WeightCurves(NAMES[:3], curves.time_s, curves.weights[:, :3])
    for name in ("face.glb", "face.usda"):
        with pytest.raises(InputError, match="no weights of 1st, Ünder, neutral"):
            write_basis(tmp_path / name, basis, fewer)
    for name, told in (("set", "weights in set"), ("face.npz", "weights in face.npz"), ("face.fbx", r"\.fbx as a basis")):
        with pytest.raises(InputError, match=told):
            write_basis(tmp_path / name, basis, curves if name != "face.fbx" else None)
    assert not list(tmp_path.iterdir())


# -- weights -------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["weights.csv", "weights.json"])
def test_weights_survive_to_the_last_bit(curves, tmp_path, name):
    write_weights(tmp_path / name, curves)
    found = read_weights(tmp_path / name)
    assert found.names == curves.names
    np.testing.assert_array_equal(found.weights, curves.weights)
    np.testing.assert_array_equal(found.time_s, curves.time_s)


def test_curves_are_taken_by_name(curves):
    swapped = curves.of(NAMES[::-1])
    np.testing.assert_array_equal(swapped.weights, curves.weights[:, ::-1])


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "a header ''"),
        ("frame,smile\n0,1\n", "a header 'frame,smile'"),
        ("time_s,smile,smile\n0,1,1\n", "smile twice"),
        ("time_s,smile,frown\n0,1,1\n\n0.1,1\n", "line 4 of 2 numbers; expected 3"),
        ("time_s,smile\n0,1\n0.1,wide\n", "line 3: could not convert"),
        ("time_s,smile\n0,nan\n", "line 2 has a number that is not finite"),
        ("time_s,smile\n0,1\n0.2,1\n0.1,1\n", "line 4 is no later"),
    ],
)
def test_faults_of_a_table_are_told_by_line(tmp_path, text, told):
    (tmp_path / "weights.csv").write_text(text)
    with pytest.raises(InputError, match=told):
        read_weights(tmp_path / "weights.csv")


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("[", "weights.json"),
        ("[]", "weights.json"),
        ('{"names": ["a"], "time_s": [0]}', "'weights'"),
        ('{"names": ["a"], "time_s": [0], "weights": [[1], [2]]}', "1 times for 2 rows"),
        ('{"names": ["a"], "time_s": [0], "weights": [[1, 2]]}', "frame 0 of 3 numbers"),
        ('{"names": ["a"], "time_s": [0], "weights": [["b"]]}', "frame 0: could not convert"),
    ],
)
def test_faults_of_json_are_told_by_frame(tmp_path, content, told):
    (tmp_path / "weights.json").write_text(content)
    with pytest.raises(InputError, match=told):
        read_weights(tmp_path / "weights.json")


def test_other_endings_absent_files_and_numbers_that_are_none_are_refused(curves, tmp_path):
    with pytest.raises(InputError, match=r"\.csv or \.json"):
        write_weights(tmp_path / "weights.txt", curves)
    with pytest.raises(InputError, match=r"absent\.csv"):
        read_weights(tmp_path / "absent.csv")
    broken = curves.weights.copy()
    broken[4, 2] = np.nan
    with pytest.raises(InputError, match="frame 4"):
        write_weights(tmp_path / "weights.csv", WeightCurves(NAMES, curves.time_s, broken))
    assert not list(tmp_path.iterdir())
