"""A tiny study of lips, from rehearsal to the page: two people before a camera, one of them held out; then a single video."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from headcap.artifacts.provenance import provenance_tree
from headcap.cli import main
from headcap.evaluation.lips_study import LipStudy
from headcap.evaluation.metrics import load_metrics
from headcap.lips.artifact import LipRegressor
from headcap.lips.monocular import MonocularTrack
from headcap.registration.sequence import MeshSequence

TAKES = [
    {"name": name, "kind": "lips", "duration_s": 1.0, "lip_tattoo": False, "lip_shapes": ["smile", "jaw_open"]}
    for name in ("lips_01", "lips_02")
]
TURN = {"name": "turn_01", "kind": "turn", "duration_s": 1.0}
VIDEO = {"width": 270, "height": 480}
STUDY = {
    "study": "mouths",
    "mesh_subjects": [
        {"subject": name, "rehearse_meshes": {"seed": seed, "rate_hz": 10, "video": VIDEO, "takes": takes}}
        for seed, name, takes in ((31, "hana", TAKES), (36, "karl", [TURN, *TAKES[:1]]))
    ],
    "held_out": ["karl"],
    # what counts here is that all stages go together
    "train_lips": {
        "test_takes": ["lips_02"],
        "pictures_per_take": 4,
        "contours": {"boosting": {"trees": 12}},
        "regression": {"every": 2, "folds": 2},
    },
}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory, lasting_workflow) -> Path:
    folder = tmp_path_factory.mktemp("lips")
    (folder / "mouths.yaml").write_text(yaml.safe_dump(STUDY))
    status, output = lasting_workflow(folder, "mouths.yaml").finish()
    assert status == 0, output
    return folder


def test_regressors_know_whom_they_were_trained_on(finished: Path) -> None:
    trained = finished / "results/mouths/train_lips"
    generic, own = (LipRegressor.load(trained / f"{name}.npz") for name in ("generic", "of_hana"))
    assert generic.persons == own.persons == ("hana",)
    assert (generic.relation("karl"), own.relation("hana")) == ("GR", "PS")
    # the take that tests somebody's own regressor trains only the one for strangers, which sees all takes in a mirror as well
    assert generic.regression.figures["frames"] == 2 * 2 * own.regression.figures["frames"]


def test_a_take_in_which_the_head_turns_tells_the_others_who_it_is(finished: Path) -> None:
    folder = finished / "results/mouths/track_monocular/karl"
    turned, own = (MonocularTrack.load(folder / f"{take}.npz") for take in ("turn_01", "lips_01"))
    assert own.layer.any()
    np.testing.assert_array_equal(own.layer, turned.layer)
    np.testing.assert_array_equal(own.shape, turned.shape)
    # it tells of nothing else
    assert not (finished / "results/mouths/find_contours/karl/turn_01.npz").exists()


def test_tables_compare_every_method_that_may_be_tested(finished: Path) -> None:
    study = LipStudy.load(finished / "results/mouths/evaluate_lips/tables.json")
    methods = {row.scope: set() for row in study.rows}
    for row in study.rows:
        methods[row.scope].add(row.method)
    assert {"base", "PS", "contour"} <= methods["hana"]
    assert {"base", "GR", "GR affine", "GR shape", "GR distances", "GR reprojected"} <= methods["karl"]
    assert not {"PS", "MS", "contour"} & methods["karl"]
    figures = {(figure.name, figure.session) for figure in load_metrics(finished / "results/mouths/metrics.json")}
    assert {("lips.gr_error_drop_pct", "karl"), ("lips.ps_error_drop_pct", "hana")} <= figures


def test_who_brings_the_true_neutral_head_errs_less(finished: Path) -> None:
    """What a person's own regressor starts from is known exactly, whatever ten frames can teach."""
    study = LipStudy.load(finished / "results/mouths/evaluate_lips/tables.json")
    base, own = (study.row(method, "hana").error_mm.value for method in ("base", "PS"))
    assert own < base


def test_the_page_tells_who_is_who_and_where_it_comes_from(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(finished)
    page = (finished / "results/mouths/report_lips/lips.html").read_text()
    for told in ("held out, as meshes and a video", "Table 1", "Figure 14", "Figure 15", "Base tracker: karl, lips_01"):
        assert told in page
    tree = "\n".join(provenance_tree("results/mouths/evaluate_lips/tables.json"))
    assert "results/karl/rehearse_meshes/rehearsal.json" in tree
    assert "CHANGED" not in tree


def test_a_single_video_is_corrected_by_the_studys_kit(finished: Path, capsys: pytest.CaptureFixture) -> None:
    kit, video = finished / "results/mouths/train_lips/lips.npz", finished / "results/karl/rehearse_meshes/lips_01.mp4"
    assert main(["lips", str(video), "--regressor", str(kit), "--out", str(finished / "single")]) == 0
    assert "of 10 frames corrected" in capsys.readouterr().out
    made = {path.name for path in (finished / "single").iterdir()}
    assert {"track.npz", "camera.json", "contours.npz", "side_by_side.mp4", "overlay.mp4", "lips.html", "metrics.json"} <= made
    sequence = MeshSequence.load(finished / "single/corrected.json")
    meshes = sequence.positions()
    answered = np.isfinite(meshes).all(axis=(1, 2))
    assert answered.any()
    # a head, in metres, before a camera whose focal length was estimated
    assert 0.15 < np.ptp(meshes[answered][0][:, 1]) < 0.6


def test_a_kit_of_another_kind_is_refused(finished: Path, capsys: pytest.CaptureFixture) -> None:
    video, wrong = finished / "results/karl/rehearse_meshes/lips_01.mp4", finished / "results/mouths/train_lips/generic.npz"
    assert main(["lips", str(video), "--regressor", str(wrong), "--out", str(finished / "refused")]) == 1
    assert "lip_kit" in capsys.readouterr().err
    assert not (finished / "refused").exists()
