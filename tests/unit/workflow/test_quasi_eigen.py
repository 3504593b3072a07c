import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from headcap.artifacts import load_json
from headcap.cli import main
from headcap.evaluation.expressions import KIND, SCHEMA
from headcap.export.expressions import write_basis
from headcap.expressions import ExpressionBasis, QuasiEigenFaces
from headcap.expressions.basis_files import read_basis
from headcap.expressions.weight_curves import WeightCurves, read_weights, write_weights

SIDE, FRAMES = 19, 60


@dataclass(frozen=True)
class Face:
    """A bulging square of skin that moves in five places, its border at rest."""

    basis: ExpressionBasis
    frames: NDArray[np.float32]
    """(f, n, 3) metres, with the head's motion."""
    still: NDArray[np.float32]
    """The same without."""


@pytest.fixture(scope="module")
def face():
    rng = np.random.default_rng(4)
    x, y = np.meshgrid(np.linspace(-0.08, 0.08, SIDE), np.linspace(-0.1, 0.1, SIDE))
    neutral = np.stack([x, y, 0.06 - 5 * (x**2 + 0.6 * y**2)], axis=2).reshape(-1, 3)
    corner = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).ravel()
    triangles = np.concatenate(
        [np.stack([corner, corner + 1, corner + SIDE], 1), np.stack([corner + 1, corner + SIDE + 1, corner + SIDE], 1)]
    )
    # the border moves by less than a thousandth of the middle: it tells the head's motion
    centres = np.array([[0, -0.04], [0.025, -0.03], [-0.025, -0.03], [0, 0.03], [0.02, 0.0]])
    near = np.exp(-((neutral[None, :, :2] - centres[:, None]) ** 2).sum(axis=2) / (2 * 0.012**2))
    shapes = near[:, :, None] * rng.normal(size=(5, 1, 3)) * 0.006
    time = np.arange(FRAMES) / 30
    weights = 0.5 - 0.5 * np.cos(2 * np.pi * time[:, None] * rng.uniform(0.6, 2.5, 5))
    still = neutral + (weights @ shapes.reshape(5, -1)).reshape(FRAMES, -1, 3)
    turn = 0.1 * np.sin(time)
    rotation = np.stack([[[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]] for a in turn])
    frames = np.einsum("fij,fnj->fni", rotation, still) + np.array([0.01, 0.0, 0.02])
    names = ("jaw", "left", "right", "brow", "cheek")
    return Face(ExpressionBasis(names, neutral, shapes, triangles), frames.astype(np.float32), still.astype(np.float32))


@pytest.fixture(scope="module")
def sculpted(face):
    """The shapes with a part of their neighbours in them, each with a bump beside it that the performer never makes."""
    rows = face.basis.rows + 0.3 * np.roll(face.basis.rows, 1, axis=0)
    peaks = np.linalg.norm(face.basis.displacements, axis=2).argmax(axis=1)
    beside = face.basis.neutral[peaks, :2] + [0.0, 0.018]
    bumps = np.exp(-((face.basis.neutral[None, :, :2] - beside[:, None]) ** 2).sum(axis=2) / (2 * 0.008**2))
    made = rows.reshape(face.basis.displacements.shape) + 0.004 * bumps[:, :, None] * [0.0, 0.0, 1.0]
    return ExpressionBasis(face.basis.names, face.basis.neutral, made, face.basis.triangles)


@pytest.fixture(scope="module")
def results(face, sculpted, tmp_path_factory):
    folder = tmp_path_factory.mktemp("quasi_eigen")
    np.save(folder / "take.npy", face.frames)
    write_basis(folder / "hand", sculpted)
    assert run(folder) == 0
    return folder


def run(folder: Path, *options: str) -> int:
    given = ["--performance", str(folder / "take.npy"), "--basis", str(folder / "hand"), "--out", str(folder / "out")]
    return main(["quasi-eigen", *given, *options])


def test_faces_reproduce_what_the_hand_made_shapes_do_not(results, sculpted):
    faces = QuasiEigenFaces.load(results / "out" / "faces.npz")
    assert faces.quasi.names == sculpted.names
    figures = load_json(results / "out" / "errors.json", KIND, SCHEMA)["figures"]
    # all five directions of the performance are among the five shapes' projections
    assert figures["quasi_eigen.displacement_qe_pct"] < 1 < 10 < figures["quasi_eigen.displacement_hand_pct"]
    page = (results / "out" / "expressions.html").read_text()
    assert all(name in page for name in sculpted.names)


@pytest.mark.parametrize("form", ["basis", "basis.glb", "basis.usdc"])
def test_every_form_of_the_basis_with_the_weights_gives_the_performance(results, face, form):
    found = read_basis(results / "out" / form)
    curves = read_weights(results / "out" / "weights.csv").of(found.names)
    away = np.linalg.norm(found.blend(curves.weights) - face.still, axis=2)
    assert len(curves) == FRAMES
    # what displacement_qe_pct says of motions of up to 15 mm, and the rest of the head's motion
    assert np.sqrt((away**2).mean()) < 0.1e-3
    assert read_weights(results / "out" / "weights.json").names == found.names


def test_fewer_frames_than_shapes_are_refused_before_anything_is_written(face, sculpted, tmp_path, capsys):
    np.save(tmp_path / "take.npy", face.frames[:4])
    write_basis(tmp_path / "hand", sculpted)
    assert run(tmp_path) == 1
    assert "at least as many as the basis has shapes, 5" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_performance_of_another_topology_is_told_with_both_counts(face, sculpted, tmp_path, capsys):
    np.save(tmp_path / "take.npy", face.frames[:, : 17 * SIDE])
    write_basis(tmp_path / "hand", sculpted)
    assert run(tmp_path) == 1
    told = capsys.readouterr().err
    assert str(SIDE * SIDE) in told
    assert str(17 * SIDE) in told


@pytest.mark.parametrize(
    ("option", "told"),
    [(("--components", "many"), "components"), (("--coverage", "1.5"), "coverage"), (("--locality", "2"), "locality")],
)
def test_settings_out_of_range_are_named(results, capsys, option, told):
    assert run(results, *option) == 1
    assert told in capsys.readouterr().err


def write_markers(path: Path, face: Face, vertices: NDArray) -> None:
    """Those vertices as a recording in millimetres."""
    labels = [f"m{vertex}" for vertex in vertices]
    header = ["time_s", *(f"{label}_{axis}" for label in labels for axis in "xyz")]
    rows = np.column_stack([np.arange(FRAMES) / 30, 1e3 * face.frames[:, vertices].reshape(FRAMES, -1)])
    path.write_text(",".join(header) + "\n" + "\n".join(",".join(f"{value:.6f}" for value in row) for row in rows))


def markers(face: Face) -> tuple[NDArray, NDArray]:
    """Every second vertex inside, and the border's corners and middles, which are rigid."""
    grid = np.arange(SIDE * SIDE).reshape(SIDE, SIDE)
    rigid = grid[:: SIDE // 2, [0, -1]].ravel()
    return grid[3:-3:2, 3:-3:2].ravel(), rigid


@pytest.mark.parametrize(("on_markers", "neutral"), [(True, False), (False, False), (False, True)])
def test_marker_recordings_go_all_the_way(face, sculpted, tmp_path, on_markers, neutral):
    moving, rigid = markers(face)
    write_markers(tmp_path / "take.csv", face, np.concatenate([moving, rigid]))
    write_basis(tmp_path / "hand", sculpted)
    ties = {f"m{vertex}": int(vertex) for vertex in moving}
    (tmp_path / "ties.json").write_text(json.dumps(ties))
    given = ["--performance", str(tmp_path / "take.csv"), "--basis", str(tmp_path / "hand"), "--out", str(tmp_path / "out")]
    more = ["--unit", "mm", "--marker-vertices", str(tmp_path / "ties.json"), "--rigid", *(f"m{vertex}" for vertex in rigid)]
    more += ["--on-markers"] if on_markers else []
    # the performer at rest as a mesh of its own
    more += ["--neutral", str(tmp_path / "hand" / "neutral.obj")] if neutral else []
    assert main(["quasi-eigen", *given, *more]) == 0
    faces = QuasiEigenFaces.load(tmp_path / "out" / "faces.npz")
    assert len(faces.quasi.neutral) == (len(moving) if on_markers else len(face.basis.neutral))
    figures = load_json(tmp_path / "out" / "errors.json", KIND, SCHEMA)["figures"]
    assert figures["quasi_eigen.displacement_qe_pct"] < 2 < figures["quasi_eigen.displacement_hand_pct"]


def test_weights_go_from_one_basis_to_another_and_back(face, tmp_path):
    mixed = ExpressionBasis(
        ("a", "b", "c", "d", "e"),
        face.basis.neutral,
        np.tensordot(np.eye(5) + 0.4 * np.eye(5, k=1), face.basis.displacements, 1),
        face.basis.triangles,
    )
    for name, basis in (("one", face.basis), ("other", mixed)):
        write_basis(tmp_path / f"{name}.glb", basis)
    weights = np.random.default_rng(0).uniform(size=(6, 5))
    write_weights(tmp_path / "one.csv", WeightCurves(face.basis.names, np.arange(6) / 30, weights))
    for here, there in (("one", "other"), ("other", "one")):
        bases = ["--from", str(tmp_path / f"{here}.glb"), "--to", str(tmp_path / f"{there}.glb")]
        target = tmp_path / f"{there}_{here}.csv"
        source = tmp_path / ("one.csv" if here == "one" else "other_one.csv")
        assert main(["convert-weights", str(source), *bases, "--out", str(target)]) == 0
    back = read_weights(tmp_path / "one_other.csv").weights
    # single precision of shapes of millimetres
    np.testing.assert_allclose(back, weights, atol=1e-4)
