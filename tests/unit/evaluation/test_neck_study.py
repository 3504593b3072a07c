"""A study's tables: rows are differences of the fits' errors, limits hold for people held out, and the file comes back."""

import json
from dataclasses import replace

import numpy as np
import pytest

from headcap.artifacts import ArtifactError
from headcap.errors import InputError
from headcap.evaluation.neck import LarynxCurve, LarynxFile
from headcap.evaluation.neck_study import PAPER_REGRESSORS, NeckStudy, RegressorRow, StudySubject, collect_study
from headcap.evaluation.settings import EvaluateSettings
from headcap.neck.fits import NeckFits, TakeFit
from headcap.neck.fitting.speech import SpeechFit
from headcap.neck.voice.errors import VoiceErrorRow, VoiceErrors
from headcap.speech import FeatureSet, SpeechErrors

CLOCK = np.arange(90) / 30
HEIGHT_M = 0.006 * np.sin(5 * CLOCK)


def take(name: str, kind: str, **errors_mm: float) -> TakeFit:
    """Of constant errors; the larynx slides as it truly does, a tenth of a second late."""
    f = len(CLOCK)
    slide = np.interp(CLOCK - 0.1, CLOCK, HEIGHT_M)
    speech = SpeechFit(slide, np.ones(f), np.zeros((f, 2)))
    still = np.broadcast_to(np.eye(4), (f, 4, 4))
    errors = {stage: np.full(f, error) for stage, error in errors_mm.items()}
    return TakeFit(name, kind, CLOCK, speech, np.zeros((f, 2, 3)), np.zeros((f, 3)), still, errors)


def fits(person: str, held_out: bool, larynx_mm: float = 0.3) -> NeckFits:
    spoken = {"base": 0.5, "expression": 0.25, "full": 0.125, "without_larynx": larynx_mm, "without_speech": 0.2}
    takes = (take("turn", "pose", base=2.0, pose=0.5), take("face", "expression", base=1.0, expression=0.75))
    return NeckFits(person, (*takes, take("talk", "speech", **spoken)), held_out)


ERRORS = SpeechErrors(60, 0, 0.002, 0.004, 1e-6, 4e-6, 0.01, 0.02)
VOICE = VoiceErrors(
    voice="anna",
    kind="user",
    model_version="v1",
    trained=("anna",),
    tested=("anna",),
    left_out="takes",
    shared_sound=0.0,
    rows=(
        VoiceErrorRow(FeatureSet.PAPER, False, 240, ERRORS),
        VoiceErrorRow(FeatureSet.POOLED, False, 240, ERRORS),
        VoiceErrorRow(FeatureSet.POOLED, True, 240, ERRORS),
    ),
)


def regressor_row(feature_set: FeatureSet) -> RegressorRow:
    return RegressorRow.of(VOICE, next(row for row in VOICE.rows if row.feature_set == feature_set))


@pytest.fixture
def study() -> NeckStudy:
    truth = {"talk": LarynxCurve(CLOCK, HEIGHT_M, clock_shift_s=0.1)}
    people = [StudySubject(fits("anna", False), True, truth), StudySubject(fits("ben", True), False, truth)]
    return NeckStudy.of("demo", people, [regressor_row(FeatureSet.PAPER), regressor_row(FeatureSet.POOLED)])


def test_rows_are_the_differences_of_the_stages(study):
    anna, ben = study.drops
    assert (anna.pose_mm, anna.expression_mm, anna.speech_mm) == (1.5, 0.25, 0.125)
    assert (anna.held_out, anna.recorded, ben.held_out, ben.recorded) == (False, True, True, False)
    assert (ben.frames, ben.skipped) == (270, 0)
    assert study.ablation[1].full_mm == 0.125
    assert study.ablation[1].rises
    assert not replace(study.ablation[1], without_larynx_mm=0.1).rises


def test_the_larynx_is_compared_on_one_clock(study):
    assert study.larynx[1].correlation == pytest.approx(1.0, abs=1e-3)
    wrong = StudySubject(fits("ben", True), False, {"talk": LarynxCurve(CLOCK, HEIGHT_M)})
    assert NeckStudy.of("demo", [wrong]).larynx[0].correlation < 0.95
    with pytest.raises(InputError, match="take song of ben"):
        NeckStudy.of("demo", [StudySubject(fits("ben", True), False, {"song": LarynxCurve(CLOCK, HEIGHT_M)})])


def test_limits_hold_for_people_held_out(study):
    found = {(figure.session, figure.name): figure for figure in study.figures(EvaluateSettings())}
    assert found["ben", "neck.pose_error_drop_mm"].ok
    assert found["ben", "neck.larynx_part_mm"].value == pytest.approx(0.175)
    assert found["anna", "neck.pose_error_drop_mm"].limit is None
    # a recorded subject's larynx is held to the limit of tracked meshes, another's to that of true ones
    assert found["anna", "neck.larynx_correlation"].limit < found["ben", "neck.larynx_correlation_of_meshes"].limit
    worse = NeckStudy.of("demo", [StudySubject(fits("ben", True, larynx_mm=0.12), False)])
    verdicts = {figure.name: figure.ok for figure in worse.figures(EvaluateSettings())}
    assert verdicts["neck.larynx_part_mm"] is False


def test_a_person_with_fewer_kinds_of_takes_has_shorter_rows():
    silent = NeckFits("cleo", (take("turn", "pose", base=2.0, pose=0.5),), True)
    found = NeckStudy.of("demo", [StudySubject(silent, False)])
    assert (found.drops[0].expression_mm, found.drops[0].speech_mm) == (None, None)
    assert found.ablation == ()
    assert "neck.speech_error_drop_mm" not in {figure.name for figure in found.figures(EvaluateSettings())}


def test_table_2_is_in_millimetres(study):
    row = study.regressors[0]
    assert (row.feature_set, row.training_frames, row.test_frames) == ("paper", 240, 60)
    assert (row.phi, row.tau, row.alpha) == (2.0, 1.0, 0.01)
    assert (row.phi_of_mean, row.tau_of_mean) == (4.0, 4.0)
    assert PAPER_REGRESSORS[-1].tau is None


def test_a_study_travels_in_a_file(study, tmp_path):
    study.save(tmp_path / "neck_study.json")
    assert NeckStudy.load(tmp_path / "neck_study.json") == study
    content = json.loads((tmp_path / "neck_study.json").read_text())
    assert content["schema"] == "headcap.neck_study/1"
    del content["drops"][0]["speech_mm"]
    (tmp_path / "broken.json").write_text(json.dumps(content))
    with pytest.raises(ArtifactError, match="no whole study"):
        NeckStudy.load(tmp_path / "broken.json")


def test_a_study_is_collected_from_its_files(tmp_path):
    people = [fits("anna", False), fits("ben", True)]
    for one in people:
        one.save(tmp_path / f"{one.person}.npz")
    VOICE.save(tmp_path / "anna.errors.json")
    np.savez(tmp_path / "talk.larynx.npz", time_s=CLOCK, larynx_dy_m=HEIGHT_M)
    found = collect_study(
        "demo",
        [tmp_path / "anna.npz", tmp_path / "ben.npz"],
        [tmp_path / "anna.errors.json"],
        recorded=["ben"],
        larynxes=[LarynxFile("ben", "talk", heights=tmp_path / "talk.larynx.npz")],
    )
    assert [row.recorded for row in found.drops] == [False, True]
    # of a voice, the rows trained as the kept one was
    assert [row.feature_set for row in found.regressors] == ["paper", "pooled"]
    assert [(row.subject, row.take) for row in found.larynx] == [("ben", "talk")]


def test_figures_of_voices_and_own_limits(study):
    figures = study.figures(EvaluateSettings(), {"ben": {"neck.larynx_correlation_of_meshes": 1.5}})
    by_name = {(figure.name, figure.session): figure for figure in figures}
    assert by_name["speech.phi_error", "anna"].value == pytest.approx(2.0)
    assert by_name["speech.tau_error_of_mean", "anna"].value == pytest.approx(4.0)
    assert by_name["neck.larynx_correlation_of_meshes", "ben"].ok is False
    assert by_name["neck.larynx_correlation", "anna"].ok is True
