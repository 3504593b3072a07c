from pathlib import Path

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.geometry.transforms import from_vector, invert, transform
from headcap.heads import base_head
from headcap.meshes.topology import submesh
from headcap.registration.align import AlignSettings
from headcap.registration.nonrigid import NonrigidSettings
from headcap.registration.picks import read_picks
from headcap.registration.register import RegisterSettings, register_scan
from headcap.registration.scan import check_scan

QUICK = RegisterSettings(
    align=AlignSettings(starts=24, finalists=1),
    nonrigid=NonrigidSettings(lengths_mm=(40, 20, 10), rounds=1, samples=1500),
    texture_px=64,
)
SCAN_FROM_HEAD = from_vector(np.array([0.4, -1.9, 0.3, 0.3, -1.2, 0.4]))
PICKED = ("chin", "nose_tip", "crown", "cheekbone_left")


@pytest.fixture(scope="module")
def places() -> np.ndarray:
    """Where each vertex of the base head lies on the scan: wider, and cheeks pushed out by 8 mm."""
    points = base_head().vertices * [1.05, 1.02, 0.97]
    points[:, 2] += 0.008 * np.exp(-((np.abs(points[:, 0]) - 0.04) ** 2 + (points[:, 1] + 0.03) ** 2) / 0.02**2)
    return transform(SCAN_FROM_HEAD, points)


@pytest.fixture(scope="module")
def scan(places):
    """The skin alone, its vertices in another order."""
    head = base_head()
    inside = head.regions["eyes"] | head.regions["mouth_interior"]
    triangles, used = submesh(head.triangles, ~inside[head.triangles].all(1))
    order = np.random.default_rng(3).permutation(len(used))
    return check_scan(places[used][order], np.argsort(order)[triangles].astype(np.int32), None)


def errors_mm(scan, picks: dict | None, places: np.ndarray) -> np.ndarray:
    """(n,) how far from their places vertices come to lie."""
    found = register_scan(base_head(), scan, QUICK, picks)
    return 1e3 * np.linalg.norm(transform(invert(found.base_from_scan), found.template.vertices) - places, axis=1)


def test_picks_pull_their_landmarks_and_what_lies_around_them(scan, places) -> None:
    head = base_head()
    picked = [head.landmarks[name] for name in PICKED]
    without = errors_mm(scan, None, places)
    held = errors_mm(scan, dict(zip(PICKED, places[picked], strict=True)), places)
    # held fifteen times as hard as what the plate moves along with them: a tenth of where they would lie is left, and the
    # distance of a vertex to its neighbour, a millimetre or two, is not passed
    assert held[picked].max() < 0.5
    assert held[head.landmarks["cheekbone_left"]] < 0.3 * without[head.landmarks["cheekbone_left"]]
    near = np.linalg.norm(head.vertices - head.vertices[head.landmarks["cheekbone_left"]], axis=1) < 0.015
    assert np.median(held[near]) < 0.6 * np.median(without[near])


def test_a_pick_wins_over_geometry_that_says_nothing_along_the_surface(scan, places) -> None:
    head = base_head()
    cheek = head.landmarks["cheekbone_left"]
    aside = int(np.argmin(np.abs(np.linalg.norm(places - places[cheek], axis=1) - 0.008)))
    picks = {name: places[head.landmarks[name]] for name in PICKED} | {"cheekbone_left": places[aside]}
    found = register_scan(base_head(), scan, QUICK, picks)
    landed = transform(invert(found.base_from_scan), found.template.vertices[[cheek]])[0]
    # eight millimetres beside its place, and nearly all of the way there
    assert 1e3 * np.linalg.norm(landed - places[aside]) < 2.0


def test_picks_come_in_metres(tmp_path: Path) -> None:
    path = tmp_path / "picks.json"
    path.write_text('{"chin": [10, -20, 300]}')
    assert read_picks(path, "mm")["chin"].tolist() == pytest.approx([0.01, -0.02, 0.3])


@pytest.mark.parametrize("content", ["{", '{"chin": [1, 2]}', '{"chin": "left"}', "[1, 2]", '{"chin": [1, 2, NaN]}'])
def test_anything_else_is_refused(tmp_path: Path, content: str) -> None:
    path = tmp_path / "picks.json"
    path.write_text(content)
    with pytest.raises(InputError, match=r"picks\.json"):
        read_picks(path, "mm")
