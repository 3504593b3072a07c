"""Kills and a full disk: the next run repairs itself and ends in the digests of an undisturbed run.

The workflow is the real one, on three tiny rendered recordings, up to the board's start times.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from headcap.artifacts import digest_file, digest_settings
from headcap.synthetic.rehearsal import CALIBRATION, plan, rehearse_recording
from headcap.synthetic.settings import RehearsalSettings

REPOSITORY = Path(__file__).parents[2]
SOUND = "results/tiny/sync/board/sound.json"
TAKE = "results/tiny/ingest/pose_01.json"

REHEARSAL = {
    "seed": 1,
    "arc": {"cameras": 3},
    "video": {"width": 64, "height": 96, "rate_hz": 30},
    "board": {"duration_s": 0.5},
    "takes": [{"name": "pose_01", "kind": "pose"}],
}


def start(folder: Path, *targets: str, **environment: str) -> subprocess.Popen:
    """The workflow in a process group of its own."""
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(REPOSITORY / "Snakefile"), "--configfile", "tiny.yaml"]
    variables = os.environ | {"PYTHONPATH": str(Path(__file__).parent / "paused")} | environment
    options = ["--cores", "1", *(targets or (SOUND, TAKE))]
    # through a pipe: a file would be cut short by the limit that stands for a full disk
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    return subprocess.Popen([*command, *options], cwd=folder, env=variables, start_new_session=True, **pipes)


def finish(folder: Path, *targets: str, **environment: str) -> tuple[int, str]:
    """Exit status and output of a run to its end."""
    run = start(folder, *targets, **environment)
    output, _ = run.communicate(timeout=120)
    return run.returncode, output


def digests(folder: Path) -> dict[str, str]:
    """Of every result but logs and timings; of manifests without the commit, which may move while the tests run."""
    results = folder / "results"
    files = [path for path in results.rglob("*") if path.is_file() and not {"logs", "benchmarks"} & set(path.parts)]
    return {str(path.relative_to(results)): digest(path) for path in files}


def digest(path: Path) -> str:
    if path.name.endswith(".manifest.json"):
        content = json.loads(path.read_text()) | {"commit": ""}
        return digest_settings(**content)
    return digest_file(path)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the workflow ran to its end."""
    folder = tmp_path_factory.mktemp("undisturbed")
    settings = RehearsalSettings.model_validate(REHEARSAL)
    cameras = plan(settings).rig.names
    for camera in cameras:
        rehearse_recording(settings, CALIBRATION, camera, folder)
        rehearse_recording(settings, "pose_01", camera, folder)
    (folder / "scan.ply").touch()
    board = {"type": "charuco", "dictionary": "DICT_5X5_100", "squares": [7, 9], "square_size_mm": 25.0, "marker_size_mm": 18.0}
    session = {
        "session": "tiny",
        "subject": "rehearsed",
        "data_root": ".",
        "rate_hz": 30,
        "cameras": [{"name": camera} for camera in cameras],
        "board": board,
        "calibration": {"files": "calibration/{camera}.mp4"},
        "takes": [{"name": "pose_01", "kind": "pose", "files": "takes/pose_01/{camera}.mp4"}],
        "scan": {"file": "scan.ply", "unit": "mm"},
    }
    (folder / "tiny.yaml").write_text(yaml.safe_dump(session))
    status, output = finish(folder)
    assert status == 0, output
    return folder


@pytest.fixture
def folder(undisturbed: Path, tmp_path: Path) -> Iterator[Path]:
    """A copy of that folder in which two stages still have to run."""
    copied = tmp_path / "run"
    shutil.copytree(undisturbed, copied)
    for result in (SOUND, TAKE):
        (copied / result).unlink()
    yield copied
    stopped = copied / "stopped"
    if stopped.exists():
        kill(int(stopped.read_text()))


def start_and_stop_in_writing(folder: Path, name: str) -> tuple[subprocess.Popen, int]:
    """A run whose stage waits in the middle of writing a file; the run and the stage's process id."""
    stopped = folder / "stopped"
    run = start(folder, HEADCAP_TEST_STOP=name, HEADCAP_TEST_STOPPED=str(stopped))
    wait_until(stopped.exists, f"{name} is written")
    return run, int(stopped.read_text())


def wait_until(condition, what: str, timeout_s: float = 60) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, f"waited in vain until {what}"
        time.sleep(0.05)


def kill(process: int) -> None:
    try:
        os.kill(process, signal.SIGKILL)
    except ProcessLookupError:
        return


def is_alive(process: int) -> bool:
    status = Path(f"/proc/{process}/stat")
    return status.exists() and status.read_text().rsplit(")", 1)[1].split()[0] != "Z"


@pytest.mark.parametrize("victim", ["stage", "snakemake", "group"])
@pytest.mark.parametrize("name", ["sound.json"])
def test_killed_in_the_middle_of_writing(folder: Path, undisturbed: Path, victim: str, name: str) -> None:
    run, stage = start_and_stop_in_writing(folder, name)
    if victim == "stage":
        kill(stage)
    elif victim == "snakemake":
        run.kill()
    else:
        os.killpg(run.pid, signal.SIGKILL)
    assert run.wait(timeout=60) != 0
    # a stage does not outlive the run it belongs to
    wait_until(lambda: not is_alive(stage), "the stage has ended")
    assert not (folder / SOUND).exists()
    status, output = finish(folder)
    assert status == 0, output
    assert digests(folder) == digests(undisturbed)


def test_full_disk_is_an_error_and_leaves_nothing_half_written(folder: Path, undisturbed: Path) -> None:
    # the log of a stage has a line or two before its file grows past this
    status, output = finish(folder, SOUND, HEADCAP_TEST_FULL="400")
    assert status != 0
    assert "error in sync_board" in output
    assert not (folder / SOUND).exists()
    assert [path for path in (folder / "results").rglob("*.tmp*")] == []
    status, output = finish(folder)
    assert status == 0, output
    assert digests(folder) == digests(undisturbed)


def test_of_two_runs_at_once_one_refuses(folder: Path) -> None:
    run, _ = start_and_stop_in_writing(folder, "sound.json")
    try:
        status, output = finish(folder)
        assert status != 0
        assert "cannot be locked" in output
        command = [sys.executable, "-m", "headcap.cli", "run", "tiny.yaml"]
        second = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        assert second.returncode == os.EX_TEMPFAIL
        assert "another run is at work" in second.stdout
    finally:
        os.killpg(run.pid, signal.SIGKILL)
        run.wait()


def test_a_run_with_nothing_to_do_does_nothing(undisturbed: Path) -> None:
    before = digests(undisturbed)
    status, output = finish(undisturbed)
    assert status == 0
    assert "Nothing to be done" in output
    assert digests(undisturbed) == before
