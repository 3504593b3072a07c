"""Runs the workflow as a user wants to see it: progress instead of Snakemake's log, and what went wrong at the end."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TextIO

from headcap.workflow.lock import run_is_alive
from headcap.workflow.progress import Progress

SNAKEFILE = Path(__file__).parents[3] / "Snakefile"


def run_workflow(
    configuration: Path | str,
    options: Sequence[str] = (),
    *,
    log: Path | str = "results/last_run.log",
    show: Callable[[str], None] = print,
) -> int:
    """Run Snakemake on a session or study file; returns its exit status, 75 where another run is at work."""
    if run_is_alive(".snakemake"):
        show("another run is at work in this folder; wait for it to end, or stop it")
        return os.EX_TEMPFAIL
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(_snakefile()), "--configfile", str(configuration), *options]
    Path(log).parent.mkdir(parents=True, exist_ok=True)
    started = time.monotonic()
    # into a file that is followed, not through a pipe: should this process be killed, the run itself goes on undisturbed
    with open(log, "w") as output, open(log) as written:
        environment = os.environ | {"PYTHONUNBUFFERED": "1"}
        with subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT, env=environment) as job:
            try:
                lines = _tell(_follow(job, written), show)
            except KeyboardInterrupt:
                # the terminal has interrupted Snakemake and its jobs too
                job.wait()
                show("stopped; the next run goes on from here")
                return 130
    if job.returncode:
        show(_failure(lines, log))
    else:
        show(f"done in {time.monotonic() - started:.0f} s")
    return job.returncode


def _follow(job: subprocess.Popen, written: TextIO) -> Iterator[str]:
    """Lines of a process that still writes them, until it has ended and all is read."""
    part = ""
    while True:
        ended = job.poll() is not None
        while line := written.readline():
            part += line
            if part.endswith("\n"):
                yield part.rstrip("\n")
                part = ""
        if ended:
            return
        time.sleep(0.2)


def _tell(lines: Iterator[str], show: Callable[[str], None]) -> list[str]:
    """Show the progress in a run's output; returns all of it."""
    progress, read = Progress(), []
    for line in lines:
        read.append(line)
        if told := progress.follow(line):
            show(told)
    return read


def _failure(lines: list[str], log: Path | str) -> str:
    """The lines that say what failed; stages print theirs while they run, so only Snakemake's own are left."""
    if any(line.startswith("headcap: error") for line in lines):
        return f"failed; the whole log is {log}"
    wanted = [index for index, line in enumerate(lines) if "Error" in line or "Exception" in line]
    told = lines[wanted[0] :][:20] if wanted else lines[-5:]
    return "\n".join([*told, f"failed; the whole log is {log}"])


def _snakefile() -> Path:
    return Path("Snakefile") if Path("Snakefile").is_file() else SNAKEFILE
