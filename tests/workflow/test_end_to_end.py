"""A tiny rehearsed session from rendering to report; then stages killed while they write."""

import shutil
from pathlib import Path

import pytest
import yaml

from headcap.artifacts.provenance import provenance_tree
from headcap.evaluation.metrics import load_metrics
from headcap.neck import NeckModel
from headcap.neck.fits import NeckFits
from headcap.registration.sequence import MeshSequence
from headcap.registration.template import Template
from headcap.sync.timeline import TakeTimeline

SESSION = {
    "session": "tiny",
    "rehearse": {
        "seed": 3,
        "arc": {"cameras": 5, "half_angle_deg": 36, "rows_deg": [-12.0, 10.0]},
        "video": {"width": 216, "height": 384, "rate_hz": 15},
        "board": {"duration_s": 5.0, "hold_s": 0.2, "move_s": 0.1, "spread_m": [0.03, 0.03, 0.03], "tilt_deg": 24},
        "scan": {"triangles": 40000},
        "takes": [{"name": "speech_01", "kind": "speech", "duration_s": 0.6}],
    },
    "frames_per_job": {"reconstruct": 3, "track": 3},
    # five small cameras and a short board recording: what counts here is that all stages go together
    "limits": {"calibrate.poses": 3, "calibrate.coverage": 0.05, "calibrate.heldout_rms_px": 2, "calibrate.heldout_p95_px": 5},
}
CLOUDS = "results/tiny/reconstruct/speech_01/chunk_001.json"
MESHES = "results/tiny/track/speech_01/chunk_001.npy"
SEQUENCE = "results/tiny/track/speech_01/sequence.json"


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory, lasting_workflow) -> Path:
    """A folder in which the whole workflow ran."""
    folder = tmp_path_factory.mktemp("end_to_end")
    (folder / "tiny.yaml").write_text(yaml.safe_dump(SESSION))
    status, output = lasting_workflow(folder).finish()
    assert status == 0, output
    return folder


def test_every_stage_states_its_figures(finished: Path) -> None:
    figures = {figure.name: figure for figure in load_metrics(finished / "results/tiny/metrics.json")}
    assert {name.split(".")[0] for name in figures} >= {"sync", "calibrate", "register", "reconstruct", "track", "neck"}
    # a millimetre is two pixels of these cameras: gross faults of the wiring (units, frames of reference, clocks) are tens
    assert figures["track.surface_error_median_mm"].value < 1.0
    assert figures["track.drift_median_mm"].value < 1.0
    assert figures["calibrate.centre_error_mm"].value < 3.0
    assert figures["sync.offset_error_ms"].value < 1.0


def test_there_is_a_mesh_for_every_frame(finished: Path) -> None:
    results = finished / "results/tiny"
    timeline = TakeTimeline.load(results / "sync/speech_01.timeline.json")
    sequence = MeshSequence.load(results / "track/speech_01/sequence.json")
    assert sequence.time_s.tolist() == timeline.time_s.tolist()
    template = Template.load(results / "track/speech_01/start.npz")
    assert sequence.positions().shape == (len(timeline), len(template.vertices), 3)
    assert template.texture_known.any()


def test_the_speech_take_trains_a_neck(finished: Path) -> None:
    results = finished / "results/tiny"
    (fit,) = NeckFits.load(results / "fit_neck/tiny/fits.npz").takes
    model = NeckModel.load(results / "train_neck/model.npz")
    assert fit.take == "speech_01"
    assert fit.speech.phi.shape == (len(fit.time_s), len(model.head.speech_basis))
    assert model.person("tiny").larynx.weights_m.any()
    assert (results / "report_neck/neck.html").stat().st_size > 50_000


def test_report_and_provenance_reach_from_end_to_beginning(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(finished)
    assert (finished / "results/tiny/report/report.html").stat().st_size > 100_000
    told = "\n".join(provenance_tree("results/tiny/report/report.html"))
    assert "results/tiny/rehearse/takes/speech_01/cam00.mp4" in told
    assert "CHANGED" not in told
    assert "MISSING" not in told


def test_a_second_run_has_nothing_to_do(finished: Path, workflow_in) -> None:
    workflow = workflow_in(finished)
    before = workflow.digests()
    status, output = workflow.finish()
    assert status == 0
    assert "Nothing to be done" in output
    assert workflow.digests() == before


@pytest.mark.parametrize(
    ("result", "written", "victim"),
    [(CLOUDS, "frame_000004.ply", "stage"), (MESHES, "chunk_001.npy", "snakemake"), (SEQUENCE, "sequence.json", "group")],
    ids=["reconstruct", "track", "collect"],
)
def test_a_stage_killed_while_it_writes_is_repaired(
    finished: Path, tmp_path: Path, workflow_in, result: str, written: str, victim: str
) -> None:
    shutil.copytree(finished, tmp_path / "run")
    workflow = workflow_in(tmp_path / "run")
    (workflow.folder / result).unlink()
    workflow.kill_in_writing(written, victim, result)
    assert not (workflow.folder / result).exists()
    status, output = workflow.finish(result)
    assert status == 0, output
    assert workflow.digests() == workflow_in(finished).digests()
