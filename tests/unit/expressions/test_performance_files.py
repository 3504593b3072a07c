"""Performances read from every format alike: rigid motion out, displacements true, what cannot be used refused by name."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from headcap.errors import InputError
from headcap.export import write_pc2
from headcap.expressions.head_motion import find_still, fit_rigid_frames, moved_frames
from headcap.expressions.performance_files import read_performance
from headcap.geometry.transforms import fit_rigid, from_vector, invert
from headcap.heads import base_head
from headcap.registration import MeshSequence
from headcap.registration.sequence import save_chunk

ROUNDING_M = 2e-7
"""Positions up to a metre in single precision, rotated and subtracted."""


def all_frames(performance):
    return np.concatenate(list(performance.blocks()))


def write_obj(path, vertices, triangles, decimals=9):
    lines = [f"v {x:.{decimals}f} {y:.{decimals}f} {z:.{decimals}f}" for x, y, z in vertices]
    path.write_text("\n".join([*lines, "vt 0.5 0.5", *[f"f {a}/1 {b}/1 {c}/1" for a, b, c in triangles + 1]]) + "\n")


def write_ply(path, vertices, triangles):
    import trimesh

    trimesh.Trimesh(vertices, triangles, process=False).export(path)


def write_usd(path, take, *, unit_m=1.0, up="Y", scale=1.0):
    from pxr import Gf, Usd, UsdGeom, Vt

    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, unit_m)
    UsdGeom.SetStageUpAxis(stage, up)
    stage.SetTimeCodesPerSecond(24)
    UsdGeom.Xform.Define(stage, "/person").AddScaleOp().Set(Gf.Vec3f(scale))
    mesh = UsdGeom.Mesh.Define(stage, "/person/head")
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([3] * len(take.triangles)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray(take.triangles.ravel().tolist()))
    points = mesh.CreatePointsAttr()
    axes = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) if up == "Z" else np.eye(3)
    for k, positions in enumerate(take.meshes):
        points.Set(Vt.Vec3fArray.FromNumpy((positions @ axes.T / unit_m / scale).astype(np.float32)), 101 + k)
    stage.GetRootLayer().Save()


def sources(take, folder):
    """The same take in all formats, each in metres."""
    save_chunk(folder / "a.npy", take.meshes[:7])
    save_chunk(folder / "b.npy", take.meshes[7:])
    sequence = MeshSequence("take", np.arange(12) / 30, (folder / "a.npy", folder / "b.npy"))
    sequence.save(folder / "take.json")
    np.save(folder / "take.npy", take.meshes)
    write_pc2(folder / "take.pc2", sequence)
    write_usd(folder / "take.usdc", take)
    for kind, write in (("obj", write_obj), ("ply", write_ply)):
        (folder / kind).mkdir()
        for k, positions in enumerate(take.meshes):
            write(folder / kind / f"frame_{k}.{kind}", positions, take.triangles)
    return [folder / name for name in ("take.json", "take.npy", "take.pc2", "take.usdc", "obj", "ply")]


def test_every_format_gives_the_true_displacements_without_the_heads_motion(small_take, tmp_path):
    for source in sources(small_take, tmp_path):
        performance = read_performance(source, neutral=small_take.neutral, triangles=small_take.triangles)
        found = all_frames(performance)
        assert found.dtype == np.float32, source
        assert len(performance) == len(found) == 12, source
        np.testing.assert_allclose(found, small_take.displacements, atol=ROUNDING_M, err_msg=str(source))
        # blocks are read anew and are the same
        np.testing.assert_array_equal(all_frames(performance), found)
        assert performance.figures["still_residual_mm"] < 1e-3


@pytest.mark.parametrize(("unit", "metres"), [("cm", 0.01), ("mm", 0.001)])
def test_units_are_those_the_caller_names(small_take, tmp_path, unit, metres):
    np.save(tmp_path / "take.npy", small_take.meshes / metres)
    write_obj(tmp_path / "neutral.obj", small_take.neutral / metres, small_take.triangles)
    performance = read_performance(tmp_path / "take.npy", neutral=tmp_path / "neutral.obj", unit=unit)
    np.testing.assert_allclose(all_frames(performance), small_take.displacements, atol=ROUNDING_M)
    with pytest.raises(InputError, match=rf"m across when read in m; .*would be a head's in .*{unit}"):
        read_performance(tmp_path / "take.npy", neutral=tmp_path / "neutral.obj")


def test_a_usd_stage_says_its_own_unit_axes_times_and_transforms(small_take, tmp_path):
    write_usd(tmp_path / "take.usda", small_take, unit_m=0.01, up="Z", scale=10.0)
    performance = read_performance(tmp_path / "take.usda", neutral=small_take.neutral)
    np.testing.assert_allclose(all_frames(performance), small_take.displacements, atol=ROUNDING_M)
    assert performance.time_s[:2] == pytest.approx([101 / 24, 102 / 24])
    np.testing.assert_array_equal(performance.triangles, small_take.triangles)


def test_without_a_neutral_the_first_frame_is_it_and_the_source_says_so(small_take, tmp_path):
    np.save(tmp_path / "take.npy", small_take.meshes)
    performance = read_performance(tmp_path / "take.npy", triangles=small_take.triangles)
    assert performance.source == "take.npy (neutral: the first frame)"
    # its motion is the unit matrix but for the rounding of double precision
    assert np.abs(all_frames(performance)[0]).max() < 1e-15
    with pytest.raises(InputError, match="no triangles"):
        read_performance(tmp_path / "take.npy")


def test_several_takes_follow_one_another(small_take, tmp_path):
    np.save(tmp_path / "a.npy", small_take.meshes[:5])
    np.save(tmp_path / "b.npy", small_take.meshes[5:])
    performance = read_performance(
        [tmp_path / "a.npy", tmp_path / "b.npy"], neutral=small_take.neutral, triangles=small_take.triangles, rate_hz=10
    )
    np.testing.assert_allclose(all_frames(performance), small_take.displacements, atol=ROUNDING_M)
    assert performance.time_s == pytest.approx(np.arange(12) / 10)


def test_files_are_taken_in_the_order_of_their_numbers(small_take, tmp_path):
    for k, positions in enumerate(small_take.meshes):
        write_obj(tmp_path / f"f{k}.obj", positions, small_take.triangles)
    performance = read_performance(tmp_path, neutral=small_take.neutral)
    np.testing.assert_allclose(all_frames(performance)[10], small_take.displacements[10], atol=ROUNDING_M)


def test_a_file_of_another_topology_is_named_with_both_counts(small_take, tmp_path):
    n, m = len(small_take.neutral), len(small_take.triangles)
    for k in range(3):
        write_obj(tmp_path / f"f{k}.obj", small_take.meshes[k], small_take.triangles)
    write_obj(tmp_path / "f2.obj", small_take.meshes[2][:-1], small_take.triangles[small_take.triangles.max(1) < n - 1])
    with pytest.raises(InputError, match=rf"f2\.obj has \d+ triangles; expected the {m} of f0\.obj"):
        read_performance(tmp_path)
    write_obj(tmp_path / "f2.obj", np.vstack([small_take.meshes[2], [[0, 0, 0]]]), small_take.triangles)
    with pytest.raises(InputError, match=rf"f2\.obj has {n + 1} vertices; expected the {n} of f0\.obj"):
        read_performance(tmp_path)
    write_obj(tmp_path / "f2.obj", small_take.meshes[2], (small_take.triangles + 1) % n)
    with pytest.raises(InputError, match=r"f2\.obj has other triangles"):
        read_performance(tmp_path)
    # the same surface, its faces in another order, is no other topology
    write_obj(tmp_path / "f2.obj", small_take.meshes[2], small_take.triangles[::-1])
    np.testing.assert_allclose(all_frames(read_performance(tmp_path))[2], small_take.displacements[2], atol=ROUNDING_M)
    np.save(tmp_path / "take.npy", small_take.meshes[:, :-2])
    with pytest.raises(InputError, match=rf"has {n} vertices; expected the {n - 2} of take\.npy"):
        read_performance(tmp_path / "take.npy", neutral=small_take.neutral, triangles=small_take.triangles)


def test_frames_that_are_no_numbers_are_named_and_nothing_is_dropped(small_take, tmp_path):
    broken = small_take.meshes.copy()
    broken[[3, 7, 8, 9], 5] = np.nan
    np.save(tmp_path / "take.npy", broken)
    with pytest.raises(InputError, match=r"take\.npy: 4 of 12 frames .* no numbers: 3, 7 to 9;"):
        read_performance(tmp_path / "take.npy", neutral=small_take.neutral, triangles=small_take.triangles)


def test_a_neutral_that_is_none_is_refused_with_its_offset_and_place(small_take, tmp_path):
    np.save(tmp_path / "take.npy", small_take.meshes)
    other = small_take.neutral.copy()
    patch = np.flatnonzero((other[:, 2] > 0.05) & (other[:, 1] < 0))
    other[patch, 1] += 0.03
    with pytest.raises(InputError, match=r"the offset is largest at vertex \d+: \d+\.\d mm") as refused:
        read_performance(tmp_path / "take.npy", neutral=other, triangles=small_take.triangles)
    assert int(str(refused.value).split("at vertex ")[1].split(":")[0]) in patch


@pytest.mark.parametrize("extent", [2e-4, 200.0])
def test_a_size_that_is_no_heads_is_refused(small_take, tmp_path, extent):
    np.save(tmp_path / "take.npy", small_take.meshes[:1] / 0.24 * extent)
    with pytest.raises(InputError, match="m across when read in m; expected a face or head"):
        read_performance(tmp_path / "take.npy", triangles=small_take.triangles)


def test_unknown_missing_mixed_and_damaged_sources_are_refused(small_take, tmp_path):
    with pytest.raises(InputError, match="no performance at"):
        read_performance(tmp_path / "none.npy")
    (tmp_path / "take.fbx").write_text("")
    with pytest.raises(InputError, match=r"take\.fbx is of a kind"):
        read_performance(tmp_path / "take.fbx")
    np.save(tmp_path / "flat.npy", np.zeros((4, 5)))
    with pytest.raises(InputError, match=r"flat\.npy holds float64 of shape \(4, 5\)"):
        read_performance(tmp_path / "flat.npy")
    (tmp_path / "short.pc2").write_bytes(b"POINTCACHE2\0")
    (tmp_path / "broken.usda").write_text("no usd")
    for name in ("short.pc2", "broken.usda"):
        with pytest.raises(InputError, match=name):
            read_performance(tmp_path / name)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="neither OBJ nor PLY"):
        read_performance(tmp_path / "empty")
    write_obj(tmp_path / "empty/a.obj", small_take.neutral, small_take.triangles)
    write_ply(tmp_path / "empty/b.ply", small_take.neutral, small_take.triangles)
    with pytest.raises(InputError, match="both"):
        read_performance(tmp_path / "empty")


def test_a_usd_file_without_or_with_several_animated_meshes_is_refused(small_take, tmp_path):
    from pxr import Usd, UsdGeom, Vt

    write_usd(tmp_path / "take.usda", small_take)
    stage = Usd.Stage.Open(str(tmp_path / "take.usda"))
    second = UsdGeom.Mesh.Define(stage, "/person/teeth").CreatePointsAttr()
    for code in (101, 102):
        second.Set(Vt.Vec3fArray.FromNumpy(np.zeros((4, 3), np.float32)), code)
    stage.GetRootLayer().Save()
    with pytest.raises(InputError, match="animated meshes /person/head, /person/teeth"):
        read_performance(tmp_path / "take.usda")
    performance = read_performance(tmp_path / "take.usda", prim="/person/head")
    assert len(performance) == 12
    still = Usd.Stage.CreateNew(str(tmp_path / "still.usda"))
    UsdGeom.Mesh.Define(still, "/head")
    still.GetRootLayer().Save()
    with pytest.raises(InputError, match="1 meshes, none with points sampled"):
        read_performance(tmp_path / "still.usda")


def test_beyond_the_face_displacements_fade_and_inside_it_they_stay(tmp_path):
    head, random = base_head(), np.random.default_rng(3)
    motion = from_vector(0.1 * random.normal(size=(6, 6)))
    jaw = np.clip((-0.02 - head.vertices[:, 1]) / 0.05, 0, 1)[:, None] * [0, -0.01, 0.0]
    # the neck bends: no expression
    bent = np.clip((-0.1 - head.vertices[:, 1]) / 0.1, 0, 1)[:, None] * [0.05, 0, 0.0]
    amount = np.linspace(0, 1, 6)[:, None, None]
    moving = jaw * head.regions["face"][:, None] + bent * head.regions["neck"][:, None]
    meshes = np.einsum("fij,fnj->fni", motion[:, :3, :3], head.vertices + amount * moving) + motion[:, None, :3, 3]
    np.save(tmp_path / "take.npy", meshes)
    found = all_frames(read_performance(tmp_path / "take.npy", neutral=head, still=head.regions["scalp"]))
    face = head.regions["face"]
    np.testing.assert_allclose(found[:, face], (amount * moving)[:, face], atol=5e-7)
    low = head.regions["neck"] & (head.vertices[:, 1] < -0.17)
    assert np.abs(moving[low]).max() > 0.03
    assert not found[:, low].any()
    sides = np.linalg.norm(found[-1], axis=1)
    assert (sides <= np.linalg.norm(moving, axis=1) + 5e-7).all()


def test_what_holds_still_is_found_and_motion_on_it_alone_is_exact(small_take):
    still, residual = find_still(small_take.meshes, small_take.neutral, 0.3)
    moving = np.abs(small_take.displacements).max(axis=(0, 2)) > 1e-4
    assert still.mean() >= 0.3
    assert not (still & moving).any()
    assert residual < 1e-6
    motion = fit_rigid_frames(small_take.meshes[:, still], small_take.neutral[still])
    np.testing.assert_allclose(motion, invert(small_take.world_from_head), atol=1e-6)


def test_batched_rigid_fits_are_those_one_by_one_and_blind_to_gaps(rng):
    target, weights = rng.normal(size=(9, 3)), rng.random((5, 9))
    points = rng.normal(size=(5, 9, 3))
    for motion, one, weight in zip(fit_rigid_frames(points, target, weights), points, weights, strict=True):
        np.testing.assert_allclose(motion, fit_rigid(one, target, weight), atol=1e-10)
    weights[:, 2], points[:, 2] = 0, np.nan
    seen = np.arange(9) != 2
    np.testing.assert_allclose(
        fit_rigid_frames(points, target, weights), fit_rigid_frames(points[:, seen], target[seen], weights[:, seen]), atol=1e-12
    )
    mirrored = np.tile(target * [1, 1, -1], (2, 1, 1))
    assert np.linalg.det(fit_rigid_frames(mirrored, target)[:, :3, :3]) == pytest.approx([1, 1])
    assert moved_frames(fit_rigid_frames(points[:1, seen], target[seen]), points[:1, seen]).shape == (1, 8, 3)


@pytest.mark.real
def test_the_head_motion_of_a_real_take_is_found_without_regions(test_data, tmp_path):
    truth, topology = np.load(test_data / "ict_rig/truth/expression_01.npz"), np.load(test_data / "ict_rig/truth/topology.npz")
    chosen = np.arange(0, len(truth["time_s"]), 4)
    # half the vertices are enough: the skin comes first
    triangles = topology["faces"][(topology["faces"] < 26000).all(axis=1)]
    first = truth["first_m"][:26000]
    meshes = first + truth["vertices_mm_i16"][chosen, :26000] * np.float32(4e-6)
    np.save(tmp_path / "take.npy", meshes)
    performance = read_performance(tmp_path / "take.npy", triangles=triangles)
    found = all_frames(performance)
    turned = Rotation.from_rotvec(truth["head_rotvec"][chosen])
    # nothing fades without regions, so what was done to each frame is the rigid motion itself
    undone = np.array([fit_rigid(mesh, first + moved) for mesh, moved in zip(meshes, found + meshes[0] - first, strict=True)])
    error_deg = np.degrees((Rotation.from_matrix(undone[:, :3, :3]) * turned * turned[0].inv()).magnitude())
    assert np.degrees((turned * turned[0].inv()).magnitude()).max() > 1
    # at 0.1 m a tenth of a degree is 0.2 mm of skin
    assert np.sqrt((error_deg**2).mean()) < 0.1
    assert performance.figures["still_residual_mm"] < 0.3
