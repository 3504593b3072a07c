"""`headcap fit`: meshes or a face's landmarks become curves that `headcap animate` reads; each mistake has its message."""

import csv

import numpy as np
import pytest

from headcap.artifacts import Manifest, manifest_path, save_json
from headcap.cameras import Camera, Rig
from headcap.cli import main
from headcap.geometry.transforms import from_vector
from headcap.heads import HeadCoefficients
from headcap.neck.animation.curves import CoefficientCurves
from headcap.neck.landmarks.files import load_landmarks, save_landmarks
from headcap.neck.landmarks.landmarks import LandmarkPoints, Landmarks
from headcap.registration.sequence import MeshSequence, save_chunk

FRAMES, RATE_HZ = 30, 30.0
PLACED = from_vector(np.array([0.1, 0.4, 0.0, 0.2, 1.1, 0.1]))


@pytest.fixture(scope="module")
def posed() -> HeadCoefficients:
    t = np.arange(FRAMES) / RATE_HZ
    theta = np.zeros((FRAMES, 2, 3))
    theta[:, 0, 1], theta[:, 1, 0] = 0.3 * np.sin(2 * np.pi * t), 0.1 * np.sin(6 * t) ** 2
    placement = np.tile(PLACED, (FRAMES, 1, 1))
    return HeadCoefficients(None, np.sin(np.outer(t, [3.0, 5.0, 7.0])), theta, np.zeros((FRAMES, 3)), placement)


@pytest.fixture(scope="module")
def files(tmp_path_factory, neck, posed):
    """model, meshes, landmarks in 3D (JSON and CSV) and in a picture, and the rig."""
    folder = tmp_path_factory.mktemp("session")
    neck.save(folder / "model.npz")
    meshes = neck.evaluate(neck.person("somebody"), posed, 2e-3 * np.sin(np.arange(FRAMES) / 4), 1.0)
    save_chunk(folder / "chunk_000.npy", meshes)
    time_s = 0.5 + np.arange(FRAMES) / RATE_HZ
    MeshSequence("talk", time_s, (folder / "chunk_000.npy",)).save(folder / "sequence.json")
    names = [name for name in sorted(neck.head.landmarks) if name != "larynx"]
    points = LandmarkPoints.joined(
        [LandmarkPoints.named(neck.head, names), LandmarkPoints.of_triangles(neck.head, [900], [[0.2, 0.3, 0.5]], ["scar"])]
    )
    seen = points.at(meshes.astype(float))
    seen[3, 5] = np.nan
    save_landmarks(folder / "face.json", Landmarks(points, time_s, seen))
    matrix = np.array([[1200.0, 0, 640], [0, 1200.0, 360], [0, 0, 1]])
    from_head = np.array([[1.0, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0.9], [0, 0, 0, 1]])
    camera = Camera("front", 1280, 720, matrix, np.zeros(5), from_head @ np.linalg.inv(PLACED))
    side = Camera("side", 10, 10, matrix, np.zeros(5), np.eye(4))
    save_json(folder / "rig.json", "rig", 1, Rig((camera, side)).to_json())
    save_landmarks(folder / "pixels.json", Landmarks(points, time_s, camera.project(seen)[0], camera))
    with (folder / "face.csv").open("w", newline="") as handle:
        writer = csv.writer(handle)
        writer.writerow(["time_s", "landmark", "x_m", "y_m", "z_m"])
        for t, frame in zip(time_s, seen, strict=True):
            for name, place in zip([*names, "triangle:900:0.2:0.3:0.5"], frame, strict=True):
                if np.isfinite(place).all():
                    writer.writerow([t, name, *place])
    return folder


def run(files, *options: str) -> int:
    return main(["fit", str(files / "model.npz"), "--person", "somebody", *map(str, options)])


def test_files_of_landmarks_say_the_same(files, neck):
    first, second = load_landmarks(files / "face.json", neck.head), load_landmarks(files / "face.csv", neck.head)
    assert np.array_equal(first.time_s, second.time_s)
    assert np.array_equal(first.seen, second.seen, equal_nan=True)
    assert np.array_equal(first.points.corners, second.points.corners)
    assert np.allclose(first.points.shares, second.points.shares)
    assert not first.visible[3, 5]


@pytest.mark.parametrize("source", ["--meshes", "--landmarks", "csv", "pixels"])
def test_what_is_fitted_animates_the_person_as_they_moved(files, neck, posed, tmp_path, capsys, source):
    curves, out = tmp_path / "curves.json", tmp_path / "again.json"
    options = {
        "--meshes": ["--meshes", files / "sequence.json"],
        "--landmarks": ["--landmarks", files / "face.json"],
        "csv": ["--landmarks", files / "face.csv", "--still-trunk"],
        "pixels": [
            "--landmarks",
            files / "pixels.json",
            "--camera",
            files / "rig.json",
            "--camera-name",
            "front",
            "--still-trunk",
        ],
    }[source]
    assert run(files, *options, "--out", curves) == 0
    told = capsys.readouterr().out
    assert "held: identity" in told
    assert f"wrote {curves}" in told
    assert Manifest.load(manifest_path(curves)).stage == "fit"
    found = CoefficientCurves.load(curves)
    assert found.time_s[0] == 0.0
    assert main(["animate", str(files / "model.npz"), "--person", "somebody", "--curves", str(curves), "--out", str(out)]) == 0
    again, true = MeshSequence.load(out).positions(), MeshSequence.load(files / "sequence.json").positions()
    still = neck.evaluate(neck.person("somebody"), HeadCoefficients(placement=PLACED), 0.0, 1.0)
    neck_of = neck.head.regions["neck"]
    error = np.linalg.norm(again - true, axis=2)[:, neck_of].mean()
    # the neck follows what turns the head: it is off by what the larynx does (up to 1 mm in a part of it) and little else
    assert error < 0.25 * np.linalg.norm(still - true, axis=2)[:, neck_of].mean()
    assert np.degrees(np.abs(found.channels["neck"] - posed.pose[:, 0])).mean() < 1.5


def test_curves_that_are_held_stay_and_are_named(files, posed, tmp_path, capsys, neck):
    CoefficientCurves(np.arange(FRAMES) / RATE_HZ, {"neck": posed.pose[:, 0], "jaw": posed.pose[:, 1]}, posed.placement).save(
        tmp_path / "pose.json"
    )
    options = [
        "--meshes",
        files / "sequence.json",
        "--hold",
        tmp_path / "pose.json",
        "--smooth",
        "8",
        "--out",
        tmp_path / "c.json",
    ]
    assert run(files, *options) == 0
    told = capsys.readouterr().out
    assert "held: identity, theta, placement; at rest: nothing" in told
    assert "in the order expression, larynx, speech" in told
    assert np.allclose(CoefficientCurves.load(tmp_path / "c.json").channels["neck"], posed.pose[:, 0])
    options = ["--meshes", files / "sequence.json", "--order", "pose,expression", "--out", tmp_path / "d.json"]
    assert run(files, *options) == 0
    assert "at rest: larynx, speech" in capsys.readouterr().out
    assert not CoefficientCurves.load(tmp_path / "d.json").channels["tau"].any()


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ([], "neither meshes nor landmarks"),
        (["--meshes", "sequence.json", "--landmarks", "face.json"], "meshes and landmarks"),
        (["--meshes", "sequence.json", "--camera", "rig.json"], "--camera with meshes"),
        (["--landmarks", "face.json", "--hold", "face.json"], "--hold with landmarks"),
        (["--landmarks", "face.json", "--smooth", "8"], "--smooth with landmarks"),
        (["--landmarks", "face.json", "--order", "pose"], "--order with landmarks"),
        (["--landmarks", "pixels.json", "--camera-name", "front"], "--camera-name without --camera"),
        (["--landmarks", "pixels.json", "--camera", "rig.json"], "a rig of 2 cameras"),
        (["--landmarks", "pixels.json", "--camera", "rig.json", "--camera-name", "top"], "camera top"),
        (["--landmarks", "pixels.json"], "pixels without a camera"),
        (["--landmarks", "face.json", "--camera", "rig.json", "--camera-name", "front"], "metres with a camera"),
        (["--landmarks", "rig.json"], "expected headcap.landmarks/1"),
        (["--landmarks", "model.npz"], "ends in .json or .csv"),
        (["--meshes", "sequence.json", "--order", "pose,walk"], "stage 'walk'"),
        (["--meshes", "sequence.json", "--out", "model.npz"], "ends in .json"),
        (["--meshes", "sequence.json", "--out", "sequence.json"], "to read and to write"),
        (["--meshes", "sequence.json", "--person", "nobody here"], "nobody here"),
    ],
)
def test_each_mistake_has_its_message(files, tmp_path, capsys, options, told):
    named = [str(files / option) if "." in option and not option.startswith("-") else option for option in options]
    out = [] if "--out" in options else ["--out", tmp_path / "curves.json"]
    assert run(files, *named, *out) == 1
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("time,landmark,x\n", "columns time, landmark, x"),
        ("time_s,landmark,x_m,y_m,z_m\n", "no landmarks"),
        ("time_s,landmark,x_m,y_m,z_m\n0,chin,1,two,3\n", "two"),
        ("time_s,landmark,x_m,y_m,z_m\n0,nostril,1,2,3\n", "nostril"),
        ("time_s,landmark,x_m,y_m,z_m\n0,vertex:x,1,2,3\n", "vertex:x"),
        ("time_s,landmark,x_m,y_m,z_m\n0,vertex:999999,1,2,3\n", "999999"),
        ("time_s,landmark,x_m,y_m,z_m\n0,chin,1,2,3\n", "at most 1 landmarks"),
    ],
)
def test_tables_of_landmarks_are_checked(files, tmp_path, capsys, text, told):
    (tmp_path / "bad.csv").write_text(text)
    assert run(files, "--landmarks", tmp_path / "bad.csv", "--out", tmp_path / "curves.json") == 1
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    "change",
    [
        {"points": [{"name": "chin", "triangle": 5}]},
        {"points": []},
        {"positions_m": [[1, 2]]},
        {"pixels": []},
        {"points": [{"name": "a", "vertex": "b"}]},
    ],
)
def test_records_of_landmarks_are_checked(files, tmp_path, capsys, change):
    content = {"time_s": [0.0], "points": [{"name": "chin"}], "positions_m": [[[0, 0, 0]]]} | change
    save_json(tmp_path / "bad.json", "landmarks", 1, content)
    assert run(files, "--landmarks", tmp_path / "bad.json", "--out", tmp_path / "curves.json") == 1
    assert "bad.json" in capsys.readouterr().err
