"""Detectors' files: what is read, what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

from headcap.cameras import Camera
from headcap.errors import InputError
from headcap.geometry.transforms import rigid, transform
from headcap.heads import procedural_model
from headcap.lips.monocular.detections import SCHEMES, load_detections, matched, place
from headcap.lips.monocular.finder import FACING
from headcap.lips.monocular.surface import FaceSurface


@pytest.fixture
def points(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(0, 500, (68, 2))


def test_json_by_frame_and_as_a_list(tmp_path: Path, points: np.ndarray):
    by_frame = tmp_path / "a.json"
    by_frame.write_text(json.dumps({"frames": [{"frame": 3, "points": points.tolist()}, {"frame": 4, "points": None}]}))
    found = load_detections(by_frame)
    assert list(found) == [3]
    assert np.array_equal(found[3], points)
    rows = points.tolist()
    rows[5] = None
    listed = tmp_path / "b.json"
    listed.write_text(json.dumps([None, [*rows]]))
    found = load_detections(listed)
    assert list(found) == [1]
    assert np.isnan(found[1][5]).all()
    assert np.array_equal(np.delete(found[1], 5, axis=0), np.delete(points, 5, axis=0))


def test_csv_long_and_wide(tmp_path: Path, points: np.ndarray):
    long = tmp_path / "a.csv"
    rows = [f"2,{k},{x!r},{y!r}" for k, (x, y) in enumerate(points.tolist()) if k != 7]
    long.write_text("frame,index,x_px,y_px\n" + "\n".join(rows))
    found = load_detections(long)
    assert np.isnan(found[2][7]).all()
    assert np.array_equal(np.delete(found[2], 7, axis=0), np.delete(points, 7, axis=0))
    wide = tmp_path / "b.csv"
    names = ["frame", "confidence", *(f"{axis}_{k}" for axis in "xy" for k in range(68))]
    wide.write_text(", ".join(names) + "\n" + ", ".join(["9", "0.9", *(repr(v) for v in points.T.ravel().tolist())]))
    assert np.array_equal(load_detections(wide)[9], points)


def test_mesh_points_of_both_sizes(tmp_path: Path, rng: np.random.Generator):
    for count in (468, 478):
        path = tmp_path / f"{count}.json"
        path.write_text(json.dumps([rng.uniform(0, 9, (count, 3)).tolist()]))
        assert load_detections(path)[0].shape == (count, 2)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.txt", ""),
        ("a.json", "{"),
        ("a.json", "[[[1, 2]]]"),
        ("a.json", '{"people": []}'),
        ("a.csv", "time,x\n1,2"),
        ("a.csv", ""),
        ("a.csv", "frame,index,x_px,y_px\n1,0,2.0,far"),
        ("a.csv", "frame,x_0,x_1,y_0\n1,2,3,4"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, name: str, text: str):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError):
        load_detections(tmp_path / name)


def test_a_head_is_placed_by_its_own_landmarks():
    surface = FaceSurface(procedural_model(shapes=2, expressions=3))
    camera = Camera("a", 640, 480, np.array([[900.0, 0, 319.5], [0, 900, 239.5], [0, 0, 1]]), np.zeros(5), np.eye(4))
    true = rigid(FACING, [0.03, -0.02, 0.8])
    seen = camera.project(transform(true, surface.in_head(surface.at_rest(np.eye(4)))))[0]
    for scheme in (68, 478):
        points = np.full((scheme, 2), np.nan)
        for name, at in SCHEMES[scheme].items():
            points[at] = seen[surface.number[surface.model.landmarks[name]]]
        found = place(surface, matched(surface, points, camera, 0.03))
        assert np.allclose(found, true, atol=1e-5)
    points[list(SCHEMES[478].values())[:-5]] = np.nan
    with pytest.raises(InputError, match="detected points"):
        matched(surface, points, camera, 0.03)
