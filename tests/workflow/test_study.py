"""A tiny study of people who come as meshes, from rehearsal to the page of the neck: what is held out trains nothing."""

from pathlib import Path

import pytest
import yaml

from headcap.artifacts.provenance import provenance_tree
from headcap.evaluation.metrics import load_metrics
from headcap.expressions import QuasiEigenFaces
from headcap.expressions.basis_files import read_basis
from headcap.expressions.weight_curves import read_weights
from headcap.neck import NeckModel
from headcap.neck.fits import NeckFits
from headcap.speech import SpeechRegressor

TAKES = [
    {"name": "pose_01", "kind": "pose", "duration_s": 1.2},
    {"name": "expression_01", "kind": "expression", "duration_s": 1.2},
    {"name": "speech_01", "kind": "speech", "duration_s": 3.0},
]
STUDY = {
    "study": "necks",
    "mesh_subjects": [
        {"subject": name, "rehearse_meshes": {"seed": seed, "rate_hz": 15, "takes": TAKES, **more}}
        for seed, name, more in ((11, "cora", {"sculpt": {}}), (12, "dave", {}), (13, "emma", {}))
    ],
    "held_out": ["emma"],
    "groups": [{"name": "everybody", "people": ["cora", "dave", "emma"], "coefficients": "phi"}],
    # what counts here is that all stages go together
    "train_expressions": {"expression": {"expressions": 8, "identities": 1, "transferred": 6}, "pose": {"rounds": 1}},
    "train_neck": {"speech": {"iterations": 3, "reduced": 20}},
}


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory, lasting_workflow) -> Path:
    folder = tmp_path_factory.mktemp("study")
    (folder / "necks.yaml").write_text(yaml.safe_dump(STUDY))
    status, output = lasting_workflow(folder, "necks.yaml").finish()
    assert status == 0, output
    return folder


def test_the_held_out_person_trains_nothing_and_is_fitted(finished: Path) -> None:
    results = finished / "results/necks"
    assert [person.name for person in NeckModel.load(results / "train_neck/model.npz").people] == ["cora", "dave"]
    fits = NeckFits.load(results / "fit_neck/emma/fits.npz")
    assert fits.held_out
    assert [person.name for person in NeckModel.load(results / "fit_neck/emma/model.npz").people] == ["emma"]


def test_figures_of_everybody_and_of_every_voice(finished: Path) -> None:
    figures = {(figure.name, figure.session) for figure in load_metrics(finished / "results/necks/metrics.json")}
    drops = {f"neck.{stage}_error_drop_mm" for stage in ("pose", "expression", "speech")}
    assert {(name, person) for name in drops for person in ("cora", "dave", "emma")} <= figures
    assert {("speech.phi_error", voice) for voice in ("cora", "dave", "everybody")} <= figures
    assert ("speech.phi_error", "emma") not in figures
    assert ("speech.tau_error", "everybody") not in figures


def test_a_group_of_phi_alone_leaves_the_larynx_at_rest(finished: Path) -> None:
    assert SpeechRegressor.load(finished / "results/necks/train_speech/everybody.npz").drives == ("phi",)


def test_the_page_tells_who_is_who_and_where_it_comes_from(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(finished)
    page = (finished / "results/necks/report_neck/neck.html").read_text()
    for told in ("held out", "Figure 7", "Figure 8", "Figure 9", "Figure 11", "Figure 12", "Figure 13", "Figure 14"):
        assert told in page
    tree = "\n".join(provenance_tree("results/necks/report_neck/neck.html"))
    assert "results/emma/rehearse_meshes/rehearsal.json" in tree
    assert "CHANGED" not in tree
    assert "MISSING" not in tree


def test_hand_made_expressions_become_quasi_eigen_faces(finished: Path) -> None:
    results = finished / "results/cora"
    faces = QuasiEigenFaces.load(results / "quasi_eigen/faces.npz")
    basis = read_basis(results / "quasi_eigen/basis.glb")
    assert basis.names == faces.quasi.names
    # 1.2 s of expressions and 3 s of speech at 15 frames a second
    assert len(read_weights(results / "quasi_eigen/weights.csv").of(basis.names)) == 63
    figures = {(figure.name, figure.session): figure for figure in load_metrics(finished / "results/necks/metrics.json")}
    assert figures["quasi_eigen.qe_over_pca", "cora"].ok
    assert figures["quasi_eigen.hand_over_qe", "cora"].ok
    assert ("quasi_eigen.alpha_qe_pct", "dave") not in figures
    assert "jaw_open" in (results / "report_expressions/expressions.html").read_text()
    assert not (finished / "results/dave/quasi_eigen").exists()
