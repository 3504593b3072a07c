"""The adapter between a rule and a stage's `run`."""

import importlib.util
from pathlib import Path
from types import SimpleNamespace

import pytest
from pydantic import BaseModel, ConfigDict, Field

from headcap.errors import InputError

SPEC = importlib.util.spec_from_file_location("adapter", Path(__file__).parents[2] / "pipeline" / "adapter.py")
adapter = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(adapter)


class Settings(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")
    level: float = Field(1.0, gt=0, description="of something")


class Named(list):
    """Files of a job as Snakemake hands them out: a list whose entries have names."""

    def __init__(self, **entries: object) -> None:
        super().__init__(entries.values())
        self.entries = entries

    def items(self):
        return self.entries.items()


def job(tmp_path: Path, **params: object) -> SimpleNamespace:
    return SimpleNamespace(
        input=Named(clouds=["a.json", "b.json"], rig="rig.json"),
        output=Named(result=str(tmp_path / "out" / "result.json")),
        params=Named(**params),
        log=[str(tmp_path / "logs" / "stage.log")],
        wildcards=["demo", "pose_01"],
        rule="stage",
        threads=1,
    )


def stage(*, clouds: list[Path], rig: Path, result: Path, frames: tuple[int, int] | None, settings: Settings) -> None:
    if settings.level > 5:
        raise InputError("the level is 9", expected="at most 5", remedy="Lower it.")
    result.write_text(f"{[cloud.name for cloud in clouds]} {rig.name} {frames} {settings.level}")


@pytest.fixture(autouse=True)
def no_watchdog(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(adapter, "_die_with_parent", lambda: None)


def test_names_and_types_reach_the_stage(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    adapter.run_rule(stage, job(tmp_path, frames=[3, 7], settings={"level": 2}, source="abc"))
    assert (tmp_path / "out" / "result.json").read_text() == "['a.json', 'b.json'] rig.json (3, 7) 2.0"
    assert "finished in" in (tmp_path / "logs" / "stage.log").read_text()


def test_a_session_may_have_no_file_of_a_kind(tmp_path: Path) -> None:
    given = job(tmp_path, frames=None, settings={})
    given.input = Named(clouds=[], rig="rig.json")
    assert adapter.arguments(stage, given)["clouds"] == []


def test_rule_and_stage_must_agree(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match=r"do not agree on \['frames', 'frmes'\]"):
        adapter.arguments(stage, job(tmp_path, frmes=None, settings={}))


def test_failure_is_one_message_and_a_traceback_in_the_log(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    with pytest.raises(SystemExit) as caught:
        adapter.run_rule(stage, job(tmp_path, frames=None, settings={"level": 9}))
    assert caught.value.code == 1
    told = capsys.readouterr().err
    assert "error in stage (demo, pose_01): the level is 9; expected at most 5. Lower it." in told
    assert "Traceback" in (tmp_path / "logs" / "stage.log").read_text()
