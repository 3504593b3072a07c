"""Figures, their limits and their file; registration against a scan; a session's figures from its folder."""

import json

import numpy as np
import pytest
from pydantic import ValidationError

from headcap.artifacts import ArtifactError, save_json, write_manifest
from headcap.evaluation.metrics import describe, load_metrics, make_figure, save_metrics
from headcap.evaluation.registration import compare_registration, count_flipped, place_scan
from headcap.evaluation.session import SessionFolder, evaluate_session, spread
from headcap.evaluation.settings import EvaluateSettings
from headcap.evaluation.truth import Truth
from headcap.geometry.transforms import from_vector, invert, transform
from headcap.reconstruction.points import PointCloud
from headcap.registration.scan import Scan
from headcap.sync.offsets import TimeOffsets


def figure(name, value, **limits):
    return make_figure(name, value, session="s", take=None, settings=EvaluateSettings(limits=limits.get("limits", {})))


@pytest.mark.parametrize(
    ("name", "value", "ok"),
    [
        ("track.drift_median_mm", 0.15, True),
        ("track.drift_median_mm", 0.1501, False),
        ("reconstruct.completeness_1mm", 94.0, True),
        ("reconstruct.completeness_1mm", 93.9, False),
        ("track.drift_median_mm", float("nan"), False),
        ("track.drift_all_median_mm", 5.0, None),
    ],
)
def test_limits_hold_on_the_side_that_is_good(name, value, ok):
    assert figure(name, value).ok is ok


def test_a_session_sets_and_lifts_limits():
    assert figure("track.drift_median_mm", 0.2, limits={"track.drift_median_mm": 0.3}).ok is True
    assert figure("track.drift_median_mm", 0.2, limits={"track.drift_median_mm": None}).ok is None


def test_a_limit_of_no_known_figure_is_refused_by_name():
    with pytest.raises(ValidationError, match="drift_medain"):
        EvaluateSettings(limits={"track.drift_medain_mm": 1.0})


def test_metrics_file_has_the_published_form_and_comes_back(tmp_path):
    figures = (figure("track.drift_median_mm", 0.1), figure("sync.offset_error_ms", float("nan")))
    save_metrics(tmp_path / "metrics.json", figures)
    document = json.loads((tmp_path / "metrics.json").read_text())
    assert document["schema"] == "headcap.metrics/1"
    assert set(document["figures"][0]) == {"name", "value", "unit", "session", "take", "limit", "ok"}
    assert load_metrics(tmp_path / "metrics.json") == figures


def test_another_file_is_refused(tmp_path):
    (tmp_path / "metrics.json").write_text('{"schema": "headcap.metrics/0", "figures": []}')
    with pytest.raises(ArtifactError, match="metrics/0"):
        load_metrics(tmp_path / "metrics.json")


def test_a_line_tells_value_limit_and_verdict():
    assert "0.2 mm (<= 0.15: PAST ITS LIMIT)" in describe(figure("track.drift_median_mm", 0.2))
    assert "97 % (>= 94: ok)" in describe(figure("reconstruct.completeness_1mm", 97.0))
    assert "not measured" in describe(figure("track.drift_median_mm", float("nan")))


def test_registration_error_leaves_out_what_no_scan_shows(still_world):
    template = still_world.template({"eyes": np.arange(41 * 41) == 5 * 41 + 5})
    lifted = template.vertices + np.array([0, 0, 1e-4])
    lifted[5 * 41 + 5] += [0, 0, 0.01]
    errors = compare_registration(template.with_vertices(lifted), still_world.motion(0.0), still_world.triangles)
    assert errors.figures()["register.error_p95_mm"] == pytest.approx(0.1, abs=1e-9)
    assert np.isnan(errors.surface_mm[5 * 41 + 5])
    assert np.isnan(errors.surface_mm[:41]).all()  # the sheet's border: beyond it the scan has nothing to compare with


def test_a_scan_is_placed_where_register_left_it(still_world, tmp_path):
    base_from_scan = from_vector(np.array([0.3, -0.8, 0.4, 0.5, -1.0, 0.2]))
    save_json(tmp_path / "placement.json", "scan_placement", 1, {"base_from_scan": base_from_scan.tolist()})
    plane = still_world.motion(0.0)
    scan = Scan(transform(invert(base_from_scan), plane), still_world.triangles)
    errors = compare_registration(still_world.template(), *place_scan(scan, tmp_path / "placement.json"))
    assert errors.figures()["register.error_p95_mm"] < 1e-9


def test_flipped_and_empty_triangles_are_counted(still_world):
    vertices, triangles = still_world.motion(0.0).copy(), still_world.triangles.copy()
    assert count_flipped(vertices, triangles) == 0
    triangles[700] = triangles[700][[0, 2, 1]]
    assert count_flipped(vertices, triangles) == 1
    triangles[200, 1] = triangles[200, 0]
    assert count_flipped(vertices, triangles) == 2


def test_a_session_folder_yields_every_figure(moving_world, tmp_path):
    session = SessionFolder(tmp_path / "study")
    new_from_world = from_vector(np.array([0.3, -0.8, 0.4, 0.5, -1.0, 0.2]))
    count = len(moving_world.rig)
    start_s = tuple(start + 0.002 for start in moving_world.start_s)
    names = moving_world.rig.names
    offsets = TimeOffsets("take", names, start_s, (0.0,) * count, (1.0,) * count, ("clap",) * count)
    offsets.save(session.offsets("take"))
    write_manifest(
        session.offsets("take"), kind="time_offsets", stage="sync", settings_digest="", inputs=[], figures={"confidence_min": 0.9}
    )
    positions = np.stack([transform(new_from_world, moving_world.motion(t)) for t in moving_world.time_s])
    session.sequence("take").parent.mkdir(parents=True)
    sequence = moving_world.sequence(positions, session.sequence("take").parent)
    moved = type(sequence)("take", sequence.time_s + 0.002, sequence.chunks)
    moved.save(session.sequence("take"))
    moving_world.template().save(session.template)
    colours, ones = np.zeros((len(positions[0]), 3), np.uint8), np.ones(len(positions[0]), np.float32)
    for frame in (0, 6):
        points = positions[frame].astype(np.float32)
        cloud = PointCloud(points, points, ones, colours, float(moved.time_s[frame]))
        cloud.save(session.clouds("take")[0].parent / f"frame_{frame:06d}.ply" if frame else _first_cloud(session))
    figures = evaluate_session(
        session,
        ["take"],
        rig=moving_world.rig.transformed(new_from_world),
        truth=Truth(moving_world.folder),
        settings=EvaluateSettings(surface_samples=5_000),
    )
    values = {figure.name: figure.value for figure in figures}
    assert values["sync.confidence_min"] == 0.9
    assert "rig.pixel_mm" not in values  # no template was placed in the rig's world
    assert values["sync.offset_error_ms"] < 1e-9
    assert values["calibrate.centre_error_mm"] < 1e-9
    assert values["reconstruct.points"] == 41 * 41
    # rounding of truth to 4 um steps and of world coordinates near 1 m to float32: at most 8 um
    assert values["reconstruct.error_p90_mm"] < 0.008
    assert values["track.drift_p95_mm"] < 0.008
    assert values["track.lip_gap_error_mm"] is None
    assert session.tracking_errors("take").is_file()


def _first_cloud(session):
    return session.folder / "reconstruct" / "take" / "frame_000000.ply"


def test_spread_keeps_both_ends():
    assert spread(list(range(10)), 4) == [0, 3, 6, 9]
    assert spread([1, 2], 4) == [1, 2]
