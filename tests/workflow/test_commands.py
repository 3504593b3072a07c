"""The commands beside the workflow: what they print and how they end."""

import json
from pathlib import Path

import pytest

from headcap.cli import main
from headcap.evaluation.metrics import Figure, save_metrics


def test_metrics_are_printed_and_a_limit_that_is_not_kept_shows_in_the_status(tmp_path: Path, capsys) -> None:
    kept = Figure("register.error_median_mm", 0.1, "mm", "demo", None, 0.15, True)
    save_metrics(tmp_path / "metrics.json", [kept])
    assert main(["metrics", str(tmp_path)]) == 0
    assert "register.error_median_mm" in capsys.readouterr().out
    save_metrics(tmp_path / "metrics.json", [kept, Figure("sync.offset_error_ms", 0.4, "ms", "demo", "pose_01", 0.1, False)])
    assert main(["metrics", str(tmp_path / "metrics.json")]) == 1
    assert "PAST ITS LIMIT" in capsys.readouterr().out


def test_schema_command_writes_what_it_checks(tmp_path: Path, capsys) -> None:
    assert main(["schema", "--check", "--folder", str(tmp_path)]) == 1
    assert "headcap schema --write" in capsys.readouterr().err
    assert main(["schema", "--write", "--folder", str(tmp_path)]) == 0
    assert main(["schema", "--check", "--folder", str(tmp_path)]) == 0
    assert json.loads((tmp_path / "session.json").read_text())["additionalProperties"] is False


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["check", "nothing.yaml"], "nothing.yaml cannot be read"),
        (["metrics", "nowhere"], "nowhere"),
        (["provenance", "nothing.json"], "no manifest beside it"),
        (["export", "sequence.json", "out", "--format", "fbx"], "'fbx'; expected one of"),
    ],
)
def test_bad_input_is_one_message_and_status_1(arguments: list[str], told: str, capsys, monkeypatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 1
    assert told in capsys.readouterr().err


def test_wrong_usage_is_status_2() -> None:
    with pytest.raises(SystemExit) as caught:
        main(["no-such-command"])
    assert caught.value.code == 2


@pytest.mark.real
def test_check_names_a_missing_camera_wherever_it_is_missed(test_data: Path, tmp_path: Path, capsys) -> None:
    session = (Path(__file__).parents[2] / "config/sessions/ict_rig.yaml").read_text()
    broken = session.replace("${HEADCAP_TEST_DATA:-../shared/data}", str(test_data)).replace("- name: cam03", "- name: cam33")
    (tmp_path / "broken.yaml").write_text(broken)
    assert main(["check", str(tmp_path / "broken.yaml")]) == 1
    told = capsys.readouterr().err
    assert all(f"{place} (cam33)" in told for place in ("calibration.files", "takes.pose_01.files", "takes.speech_01.files"))
