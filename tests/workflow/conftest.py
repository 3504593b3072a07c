"""The workflow in a folder of its own: started, stopped while it writes, killed, and its results compared."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from headcap.artifacts import digest_file, digest_settings

REPOSITORY = Path(__file__).parents[2]


@dataclass
class Workflow:
    """Runs of one session file, in the folder it lies in."""

    folder: Path
    session: str = "tiny.yaml"
    started: list[int] = field(default_factory=list)

    def start(self, *targets: str, **environment: str) -> subprocess.Popen:
        """A run in a process group of its own."""
        command = [sys.executable, "-m", "snakemake", "--snakefile", str(REPOSITORY / "Snakefile")]
        options = ["--cores", "1", *targets, "--configfile", self.session]
        variables = os.environ | {"PYTHONPATH": str(Path(__file__).parent / "paused")} | environment
        # through a pipe: a file would be cut short by the limit that stands for a full disk
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        run = subprocess.Popen([*command, *options], cwd=self.folder, env=variables, start_new_session=True, **pipes)
        self.started.append(run.pid)
        return run

    def finish(self, *targets: str, **environment: str) -> tuple[int, str]:
        """Exit status and output of a run to its end."""
        run = self.start(*targets, **environment)
        output, _ = run.communicate(timeout=600)
        return run.returncode, output

    def stop_in_writing(self, name: str, *targets: str) -> tuple[subprocess.Popen, int]:
        """A run whose stage waits in the middle of writing a file; the run and the stage's process id."""
        stopped = self.folder / "stopped"
        run = self.start(*targets, HEADCAP_TEST_STOP=name, HEADCAP_TEST_STOPPED=str(stopped))
        wait_until(stopped.exists, f"{name} is written")
        stage = int(stopped.read_text())
        self.started.append(stage)
        return run, stage

    def kill_in_writing(self, name: str, victim: str, *targets: str) -> None:
        """Kill a stage, Snakemake or the whole group while a file is written, and see that nothing lives on."""
        run, stage = self.stop_in_writing(name, *targets)
        if victim == "stage":
            kill(stage)
        elif victim == "snakemake":
            run.kill()
        else:
            os.killpg(run.pid, signal.SIGKILL)
        run.communicate(timeout=120)
        assert run.returncode != 0
        # a stage does not outlive the run it belongs to
        wait_until(lambda: not is_alive(stage), "the stage has ended")

    def digests(self) -> dict[str, str]:
        """Of every result but logs and timings; of manifests without the commit, which may move while the tests run."""
        results = self.folder / "results"
        files = [path for path in results.rglob("*") if path.is_file() and not {"logs", "benchmarks"} & set(path.parts)]
        return {str(path.relative_to(results)): digest(path) for path in files}

    def kill_all(self) -> None:
        """Whatever of its runs is still alive."""
        for process in self.started:
            kill(process)


def digest(path: Path) -> str:
    if path.name.endswith(".manifest.json"):
        return digest_settings(**(json.loads(path.read_text()) | {"commit": ""}))
    return digest_file(path)


def wait_until(condition: Callable[[], bool], what: str, timeout_s: float = 300) -> None:
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


@pytest.fixture
def workflow_in() -> Iterator[Callable[[Path], Workflow]]:
    """Makes workflows in folders; what they started ends with the test."""
    made: list[Workflow] = []

    def make(folder: Path) -> Workflow:
        made.append(Workflow(folder))
        return made[-1]

    yield make
    for workflow in made:
        workflow.kill_all()


@pytest.fixture(scope="module")
def lasting_workflow() -> type[Workflow]:
    """For results that several tests read."""
    return Workflow
