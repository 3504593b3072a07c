"""Artifacts: equal content gives equal digests, strangers are refused by name, nothing half-written is read."""

import numpy as np
import pytest

from headcap.artifacts import (
    ArtifactError,
    Manifest,
    atomic_path,
    digest_file,
    load_arrays,
    load_json,
    manifest_path,
    save_arrays,
    save_json,
    write_manifest,
)


def test_arrays_come_back_and_digests_repeat(tmp_path):
    arrays = {"points": np.arange(6.0).reshape(2, 3), "mask": np.array([True, False])}
    for name in ("a.npz", "b.npz"):
        save_arrays(tmp_path / name, "thing", 3, arrays, {"unit": "m"})
    found, meta = load_arrays(tmp_path / "a.npz", "thing", 3)
    assert {name: value.tolist() for name, value in found.items()} == {name: value.tolist() for name, value in arrays.items()}
    assert meta == {"unit": "m"}
    assert digest_file(tmp_path / "a.npz") == digest_file(tmp_path / "b.npz")


@pytest.mark.parametrize(("kind", "schema"), [("other", 3), ("thing", 4)])
def test_another_kind_or_version_is_refused_by_name(tmp_path, kind, schema):
    save_arrays(tmp_path / "a.npz", "thing", 3, {})
    save_json(tmp_path / "a.json", "thing", 3, {})
    for load, name in ((load_arrays, "a.npz"), (load_json, "a.json")):
        with pytest.raises(ArtifactError, match=rf"headcap.thing/3, expected headcap.{kind}/{schema}"):
            load(tmp_path / name, kind, schema)


def test_a_file_cut_short_is_refused(tmp_path):
    save_arrays(tmp_path / "a.npz", "thing", 1, {"x": np.zeros(1000)})
    whole = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "a.npz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ArtifactError, match="damaged"):
        load_arrays(tmp_path / "a.npz", "thing", 1)


def test_an_interrupted_write_leaves_the_old_file(tmp_path):
    target = tmp_path / "a.txt"
    target.write_text("old")

    def write_and_fail() -> None:
        with atomic_path(target) as temporary:
            temporary.write_text("half")
            raise RuntimeError("power cut")

    with pytest.raises(RuntimeError, match="power"):
        write_and_fail()
    assert target.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_nan_figures_are_refused(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        save_json(tmp_path / "a.json", "thing", 1, {"value": float("nan")})


def test_manifest_names_its_inputs_by_digest(tmp_path):
    (tmp_path / "in.bin").write_bytes(b"in")
    (tmp_path / "out.bin").write_bytes(b"out")
    written = write_manifest(
        tmp_path / "out.bin", kind="thing", stage="track", settings_digest="s", inputs=[tmp_path / "in.bin"], figures={"x": 1}
    )
    assert Manifest.load(manifest_path(tmp_path / "out.bin")) == written
    assert written.inputs == {"in.bin": digest_file(tmp_path / "in.bin")}


def test_what_a_killed_writer_left_is_removed_by_the_next(tmp_path):
    left, other = tmp_path / ".frame_000001.4711.tmp.ply", tmp_path / ".frame_000010.4711.tmp.ply"
    left.touch()
    other.touch()
    with atomic_path(tmp_path / "frame_000001.ply") as temporary:
        temporary.write_text("whole")
    assert sorted(path.name for path in tmp_path.iterdir()) == [other.name, "frame_000001.ply"]
