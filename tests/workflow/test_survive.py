"""Kills, a full disk and two runs at once, on the real workflow with tiny rendered recordings, up to the first stages.

The next run repairs itself and ends in the digests of an undisturbed run.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from headcap.synthetic.rehearsal import CALIBRATION, plan, rehearse_recording
from headcap.synthetic.settings import RehearsalSettings

SOUND = "results/tiny/sync/board/sound.json"
TAKE = "results/tiny/ingest/pose_01.json"
REHEARSAL = {
    "seed": 1,
    "arc": {"cameras": 3},
    "video": {"width": 64, "height": 96, "rate_hz": 30},
    "board": {"duration_s": 0.5},
    "takes": [{"name": "pose_01", "kind": "pose", "duration_s": 0.5}],
}
BOARD = {"type": "charuco", "dictionary": "DICT_5X5_100", "squares": [7, 9], "square_size_mm": 25.0, "marker_size_mm": 18.0}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory, lasting_workflow) -> Path:
    """A folder in which the workflow ran to its end."""
    folder = tmp_path_factory.mktemp("undisturbed")
    settings = RehearsalSettings.model_validate(REHEARSAL)
    cameras = plan(settings).rig.names
    for camera in cameras:
        for recording in (CALIBRATION, "pose_01"):
            rehearse_recording(settings, recording, camera, folder)
    (folder / "scan.ply").touch()
    session = {
        "session": "tiny",
        "subject": "rehearsed",
        "data_root": ".",
        "rate_hz": 30,
        "cameras": [{"name": camera} for camera in cameras],
        "board": BOARD,
        "calibration": {"files": "calibration/{camera}.mp4"},
        "takes": [{"name": "pose_01", "kind": "pose", "files": "takes/pose_01/{camera}.mp4"}],
        "scan": {"file": "scan.ply", "unit": "mm"},
    }
    (folder / "tiny.yaml").write_text(yaml.safe_dump(session))
    status, output = lasting_workflow(folder).finish(SOUND, TAKE)
    assert status == 0, output
    return folder


@pytest.fixture
def workflow(undisturbed: Path, tmp_path: Path, workflow_in):
    """The workflow in a copy of that folder, in which two stages still have to run."""
    shutil.copytree(undisturbed, tmp_path / "run")
    for result in (SOUND, TAKE):
        (tmp_path / "run" / result).unlink()
    return workflow_in(tmp_path / "run")


@pytest.mark.parametrize("victim", ["stage", "snakemake", "group"])
def test_killed_in_the_middle_of_writing(workflow, workflow_in, undisturbed: Path, victim: str) -> None:
    workflow.kill_in_writing("sound.json", victim, SOUND, TAKE)
    assert not (workflow.folder / SOUND).exists()
    status, output = workflow.finish(SOUND, TAKE)
    assert status == 0, output
    assert workflow.digests() == workflow_in(undisturbed).digests()


def test_full_disk_is_an_error_and_leaves_nothing_half_written(workflow, workflow_in, undisturbed: Path) -> None:
    status, output = workflow.finish(SOUND, HEADCAP_TEST_FULL="400")
    assert status != 0
    assert "error in sync_board" in output or "error in ingest" in output or "error in check_takes" in output
    assert not (workflow.folder / SOUND).exists()
    assert list((workflow.folder / "results").rglob("*.tmp*")) == []
    status, output = workflow.finish(SOUND, TAKE)
    assert status == 0, output
    assert workflow.digests() == workflow_in(undisturbed).digests()


def test_of_two_runs_at_once_one_refuses(workflow) -> None:
    workflow.stop_in_writing("sound.json", SOUND, TAKE)
    status, output = workflow.finish(SOUND, TAKE)
    assert status != 0
    assert "cannot be locked" in output
    command = [sys.executable, "-m", "headcap.cli", "run", "tiny.yaml"]
    second = subprocess.run(command, cwd=workflow.folder, capture_output=True, text=True, check=False)
    assert second.returncode == os.EX_TEMPFAIL
    assert "another run is at work" in second.stdout
