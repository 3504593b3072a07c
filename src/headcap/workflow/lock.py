"""Stale locks of runs that were killed, told from the locks of runs that are alive.

Snakemake's lock is a set of files: whoever is killed leaves them behind, and the next run refuses. Every process that
reads the Snakefile therefore also holds a shared kernel lock until it dies. Who can take that lock alone knows that no
other run is alive, and that the files left behind may go; a live run keeps its files, and a second one refuses.
"""

import fcntl
import os
from pathlib import Path
from typing import IO

_held: list[IO] = []


def hold_run_lock(state_folder: Path | str) -> int:
    """Hold the shared lock of `.snakemake` until this process ends; returns how many stale lock files were removed."""
    state_folder = Path(state_folder)
    state_folder.mkdir(parents=True, exist_ok=True)
    handle = open(state_folder / "headcap.lock", "a")  # noqa: SIM115 - held open on purpose
    removed = _remove_stale(state_folder / "locks") if _alone(handle) else 0
    # between the two modes the kernel lets go for a moment: harmless, for this run has no lock files yet
    fcntl.flock(handle, fcntl.LOCK_SH)
    _held.append(handle)
    return removed


def run_is_alive(state_folder: Path | str) -> bool:
    """True while another process holds the lock."""
    path = Path(state_folder) / "headcap.lock"
    if not path.exists():
        return False
    with open(path, "a") as handle:
        return not _alone(handle)


def _alone(handle: IO) -> bool:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _remove_stale(folder: Path) -> int:
    files = list(folder.glob("*.lock")) if folder.is_dir() else []
    for file in files:
        os.unlink(file)
    return len(files)
