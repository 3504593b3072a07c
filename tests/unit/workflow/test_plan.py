import copy
from pathlib import Path

import pytest
import yaml

from headcap.errors import InputErrors
from headcap.settings import Session
from headcap.workflow.plan import check_session, load_plan, rehearsed_session

REPOSITORY = Path(__file__).parents[3]
CAMERAS = ("left", "middle", "right")


@pytest.fixture
def session(tmp_path: Path) -> dict:
    """A session whose files all exist."""
    for name in ("calibration", "pose_01"):
        (tmp_path / name).mkdir()
        for camera in CAMERAS:
            (tmp_path / name / f"{camera}.mp4").touch()
    (tmp_path / "scan.ply").touch()
    board = {"type": "charuco", "dictionary": "DICT_5X5_100", "squares": [7, 9], "square_size_mm": 25, "marker_size_mm": 18}
    return {
        "session": "test",
        "subject": "nobody",
        "data_root": str(tmp_path),
        "rate_hz": 60,
        "cameras": [{"name": camera} for camera in CAMERAS],
        "board": board,
        "calibration": {"files": "calibration/{camera}.mp4"},
        "takes": [{"name": "pose_01", "kind": "pose", "files": "pose_01/{camera}.mp4"}],
        "scan": {"file": "scan.ply", "unit": "mm"},
    }


def told(document: dict) -> str:
    with pytest.raises(InputErrors) as caught:
        load_plan(document)
    return str(caught.value)


def test_a_good_session_is_accepted(session: dict) -> None:
    plan = load_plan(session)
    assert plan.name == "test"
    assert list(plan.sessions["test"].recordings("pose_01")) == list(CAMERAS)


def test_everything_wrong_is_told_at_once_and_by_name(session: dict) -> None:
    session["rate_hz"] = "sixty"
    session["takes"][0]["knid"] = "pose"
    session["cameras"][1]["framing"] = "hands"
    session["scan"]["file"] = "skan.ply"
    session["calibration"]["files"] = "kalibration/{camera}.mp4"
    session["board"]["square_size_mm"] = -1
    message = told(session)
    for part in ("rate_hz: 'sixty'", "takes.0.knid: unknown key", "Did you mean kind?", "cameras.1.framing: 'hands'"):
        assert part in message
    for part in ("skan.ply is not there", "board.square_size_mm", *(f"kalibration/{camera}.mp4" for camera in CAMERAS)):
        assert part in message
    # each once: three recordings and five more
    assert message.count("\n- ") + 1 == 8


@pytest.mark.parametrize("value", ["60", [60], None, True])
def test_wrong_types_are_refused_without_guessing(session: dict, value: object) -> None:
    session["rate_hz"] = value
    assert "rate_hz" in told(session)


def test_missing_key_is_named_and_hides_nothing(session: dict) -> None:
    session["calibration"]["files"] = "kalibration/{camera}.mp4"
    del session["scan"]
    message = told(session)
    assert "scan: missing" in message
    assert "kalibration/left.mp4 is not there" in message


def test_a_camera_may_be_missing_where_the_take_says_so(session: dict) -> None:
    (Path(session["data_root"]) / "pose_01" / "left.mp4").unlink()
    assert "takes.pose_01.files (left)" in told(session)
    session["takes"][0]["missing"] = ["left"]
    assert list(load_plan(session).sessions["test"].recordings("pose_01")) == ["middle", "right"]
    session["takes"][0]["missing"] = ["lfet"]
    assert "no camera is called lfet" in told(session)


def test_names_are_given_once(session: dict) -> None:
    session["cameras"][2]["name"] = "left"
    assert "left is named twice" in told(session)


def test_limits_and_waivers_name_figures_that_exist(session: dict) -> None:
    session["limits"], session["allow"] = {"calibrate.poses": 3, "reconstruct.point": 5}, ["calibrate.covrage"]
    message = told(session)
    assert "no figure is called reconstruct.point" in message
    assert "no figure is called calibrate.covrage" in message
    assert "calibrate.poses" not in message


def test_files_may_be_given_camera_by_camera(session: dict) -> None:
    session["takes"][0]["files"] = {camera: f"pose_01/{camera}.mp4" for camera in CAMERAS}
    assert load_plan(session).sessions["test"].recordings("pose_01")["left"].endswith("pose_01/left.mp4")
    del session["takes"][0]["files"]["right"]
    assert "no file for right" in told(session)


def test_board_file_is_read_before_any_job(session: dict) -> None:
    (Path(session["data_root"]) / "board.yaml").write_text("type: charuco\nsqares: [7, 9]\n")
    session["board"] = "board.yaml"
    assert "sqares" in told(session)


def test_frames_must_be_in_order(session: dict) -> None:
    session["takes"][0]["frames"] = [5, 2]
    assert "frames [5, 2] are not in order" in told(session)


def test_data_root_reads_the_environment(session: dict, monkeypatch: pytest.MonkeyPatch) -> None:
    root = session["data_root"]
    session["data_root"] = "${HEADCAP_SOME_ROOT:-/nowhere}"
    assert "/nowhere is no folder" in told(session)
    monkeypatch.setenv("HEADCAP_SOME_ROOT", root)
    load_plan(session)


def test_a_study_checks_all_its_sessions(session: dict) -> None:
    other = copy.deepcopy(session)
    message = told({"study": "two", "sessions": [session, other]})
    assert "two sessions or subjects are called test" in message
    other["session"], other["rate_hz"] = "other", -1
    assert "rate_hz" in told({"study": "two", "sessions": [session, other]})
    other["rate_hz"] = 30
    assert list(load_plan({"study": "two", "sessions": [session, other]}).sessions) == ["test", "other"]


def test_a_rehearsed_session_needs_only_its_rehearsal() -> None:
    document = {"session": "demo", "rehearse": {"seed": 3, "arc": {"cameras": 5}}}
    session = load_plan(document).sessions["demo"]
    assert len(session.cameras) == 5
    assert session.data_root == "results/demo/rehearse"
    assert "rehearse.sead: unknown key" in told({"session": "demo", "rehearse": {"sead": 3}})


def test_what_a_rehearsed_session_says_itself_stands() -> None:
    document = {"session": "demo", "rehearse": {"seed": 3}, "clapper_m": [0.0, 0.0, 1.0]}
    session = load_plan(document).sessions["demo"]
    assert session.clapper_m == (0.0, 0.0, 1.0)
    described = rehearsed_session(session.rehearse, "demo")
    assert Session.model_validate(described).takes == session.takes


@pytest.mark.parametrize("path", ["config/demo.yaml"])
def test_shipped_studies_are_accepted(path: str) -> None:
    load_plan(yaml.safe_load((REPOSITORY / path).read_text()))


@pytest.mark.real
def test_shipped_session_is_accepted(test_data: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HEADCAP_TEST_DATA", str(test_data))
    session, errors = check_session(yaml.safe_load((REPOSITORY / "config/sessions/ict_rig.yaml").read_text()))
    assert errors == []
    assert session.root == test_data / "ict_rig"


def test_hand_made_expressions_are_files_of_the_session(session: dict) -> None:
    assert "expression_basis: " in told(session | {"expression_basis": "sculpted"})
    folder = Path(session["data_root"]) / "sculpted"
    folder.mkdir()
    takes = [take | {"kind": "expression"} for take in session["takes"]]
    plan = load_plan(session | {"expression_basis": "sculpted", "takes": takes})
    assert plan.expression_people == (session["session"],)
    assert plan.expression_basis(session["session"]) == str(folder)
    assert load_plan(session | {"takes": takes}).expression_people == ()


def test_a_rehearsal_that_sculpts_brings_its_shapes() -> None:
    takes = [{"name": "expression_01", "kind": "expression", "duration_s": 1}]
    people = [
        {"subject": name, "rehearse_meshes": {"seed": 1, "takes": takes, **more}}
        for name, more in (("a", {"sculpt": {}}), ("b", {}))
    ]
    plan = load_plan({"study": "s", "mesh_subjects": people})
    assert plan.expression_people == ("a",)
    assert plan.expression_basis("a") == "results/a/rehearse_meshes/expressions.npz"
