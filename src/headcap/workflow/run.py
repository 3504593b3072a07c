"""Runs the workflow as a user wants to see it: progress instead of Snakemake's log, and what went wrong at the end."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

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
    progress, started = Progress(), time.monotonic()
    with open(log, "w") as record, subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as job:
        try:
            tail = _follow(job, record, progress, show)
        except KeyboardInterrupt:
            job.send_signal(signal.SIGINT)
            job.wait()
            show("stopped; the next run goes on from here")
            return 130
    if job.returncode:
        show(_failure(tail, log))
    else:
        show(f"done in {time.monotonic() - started:.0f} s")
    return job.returncode


def _follow(job: subprocess.Popen, record, progress: Progress, show: Callable[[str], None]) -> list[str]:
    lines: list[str] = []
    for line in job.stdout:
        record.write(line)
        lines.append(line.rstrip("\n"))
        told = progress.follow(line)
        if told:
            show(told)
    return lines


def _failure(lines: list[str], log: Path | str) -> str:
    """The lines that say what failed; stages print theirs while they run, so only Snakemake's own are left."""
    if any(line.startswith("headcap: error") for line in lines):
        return f"failed; the whole log is {log}"
    wanted = [index for index, line in enumerate(lines) if "Error" in line or "Exception" in line]
    told = lines[wanted[0] :][:20] if wanted else lines[-5:]
    return "\n".join([*told, f"failed; the whole log is {log}"])


def _snakefile() -> Path:
    return Path("Snakefile") if Path("Snakefile").is_file() else SNAKEFILE
