"""The report: one offline page with every figure; parts that were not made are left out; equal input, equal bytes."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from headcap.evaluation.metrics import make_figure
from headcap.evaluation.settings import EvaluateSettings
from headcap.report.html import write_report, write_summary
from headcap.report.pictures import mean_seen


@pytest.fixture(scope="module")
def page(inputs, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(inputs, path)
    return path.read_text()


def test_every_figure_stands_in_the_report_with_its_verdict(inputs, page):
    for figure in inputs.figures:
        assert figure.name in page
    assert "2 of 3 figures are within their limits" in page
    assert page.count('class="gate bad"') == 1
    assert page.count('class="gate good"') == 2


def test_the_page_is_offline_and_whole(page):
    assert not re.search(r"https?:|//cdn|<script|<link|@import|url\(", page)
    assert set(re.findall(r'src="([a-z:/]+)', page)) == {"data:image/jpeg", "data:image/png"}
    assert "default-src 'none'" in page
    assert len(page) < 8e6
    for section in ("expect", "figures", "sync", "calibration", "register", "take-smile", "made"):
        assert f'id="{section}"' in page
        assert f'href="#{section}"' in page


def test_what_sync_drew_and_what_the_tracker_was_left_with_are_shown(inputs, page, bare, tmp_path):
    assert "the clap in every camera" in page
    assert "what the tracker was left with" in page
    take = replace(inputs.takes[0], residuals=None, sync_figure=None)
    write_report(replace(bare, takes=(take,)), tmp_path / "report.html")
    told = (tmp_path / "report.html").read_text()
    assert "start times of smile" in told
    assert "the clap in every camera" not in told
    assert "what the tracker was left with" not in told


def test_the_neck_shows_what_was_trained_and_no_more(bare, tmp_path):
    drawn = np.full((40, 60, 3), 128, np.uint8)
    heard = make_figure("speech.tau_error", 2.5, session="s", take=None, settings=EvaluateSettings())
    write_report(replace(bare, neck_pictures=(drawn, drawn), figures=(heard,)), tmp_path / "both.html")
    write_report(replace(bare, neck_pictures=(drawn,)), tmp_path / "one.html")
    both, one = ((tmp_path / name).read_text() for name in ("both.html", "one.html"))
    assert ("predicted from sound" in both, "predicted from sound" in one) == (True, False)
    assert 'id="neck"' in one
    assert "speech.tau_error" in both
    assert "mm2" in both


def test_provenance_versions_and_settings_are_told(page):
    assert "abababababababab" in page
    assert "numpy 2" in page
    assert "&#34;steps&#34;: 5" in page


def test_text_of_the_session_is_escaped(page):
    assert "<nobody>" not in page
    assert "&lt;nobody&gt;" in page


def test_a_waived_gate_is_shown_as_past_its_limit(bare, tmp_path):
    write_report(replace(bare, allowed=("track.drift_p95_mm",)), tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "past it, waived" in page
    assert page.count('class="gate bad"') == 1


def test_limits_that_go_by_the_pixel_are_marked_and_explained(bare, page, tmp_path):
    assert "Limits of lengths are stated for pixels" not in page
    own = EvaluateSettings(limits={"track.drift_p95_mm": 3.0}).at_pixel(0.69)
    values = {"rig.pixel_mm": 0.69, "track.drift_median_mm": 0.2, "track.drift_p95_mm": 0.9, "sync.offset_error_ms": 0.01}
    figures = [make_figure(name, value, session="s", take=None, settings=own) for name, value in values.items()]
    write_report(replace(bare, figures=tuple(figures)), tmp_path / "report.html")
    told = (tmp_path / "report.html").read_text()
    # half as large again as the reference pixel: 0.15 mm becomes 0.225; the session's own limit and milliseconds stay
    assert re.findall(r"≤ ([0-9.]+\*?)<", told) == ["0.1", "0.225*", "3"]
    assert "a pixel covers 0.69 mm, so these limits are 1.50 times as large" in told
    assert "3 of 3 figures are within their limits" in told


def test_a_gate_shows_the_worst_take(bare, tmp_path):
    figures = [
        make_figure("reconstruct.completeness_1mm", value, session="s", take=take, settings=EvaluateSettings())
        for take, value in (("a", 97.0), ("b", 95.0), ("c", 99.0))
    ]
    write_report(replace(bare, figures=tuple(figures)), tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "worst of 3: b" in page


def test_what_was_not_made_is_left_out(bare, tmp_path):
    write_report(bare, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert 'id="calibration"' not in page
    assert 'id="expect"' not in page
    assert "track.drift_median_mm" in page


def test_equal_input_gives_equal_bytes(inputs, page, tmp_path):
    write_report(inputs, tmp_path / "again.html")
    assert (tmp_path / "again.html").read_text() == page


def test_summary_shows_photograph_points_mesh_and_error(inputs, tmp_path):
    write_summary(inputs, tmp_path / "summary.png")
    sheet = cv2.imread(str(tmp_path / "summary.png"))
    assert sheet.shape[0] == 560
    assert sheet.shape[1] > 3 * 300


def test_a_summary_of_nothing_is_refused(bare, tmp_path):
    with pytest.raises(ValueError, match="nothing to show"):
        write_summary(bare, tmp_path / "summary.png")


def test_mean_over_frames_counts_only_what_is_seen():
    values = np.array([[1.0, np.nan, 5.0], [3.0, np.nan, 7.0]])
    seen = np.array([[True, True, True], [True, True, False]])
    np.testing.assert_array_equal(mean_seen(values, seen), [2.0, np.nan, 5.0])
