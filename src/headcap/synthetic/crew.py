"""Rendering pieces of a rehearsal side by side, in processes that are fresh and end with whoever called them.

Plain child processes with pipes, not `multiprocessing`: that would run the caller's main script again (spawn) or inherit
its threads' locks (fork). A worker whose caller is killed finds its input closed and ends.
"""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

Piece = tuple[str, ...]
"""Name of a function of `rehearsal` and its arguments between settings and folder."""


def carry_out(pieces: list[Piece], settings_json: str, folder: Path, workers: int) -> Iterator[str]:
    """Yield the file of each piece as it is finished; raises RuntimeError with the message of a piece that failed."""
    waiting: queue.SimpleQueue[Piece] = queue.SimpleQueue()
    for piece in pieces:
        waiting.put(piece)
    results: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
    processes = [_start(settings_json, folder) for _ in range(min(workers, len(pieces)))]
    try:
        for process in processes:
            threading.Thread(target=_feed, args=(process, waiting, results), daemon=True).start()
        for _ in pieces:
            result = results.get()
            if "error" in result:
                raise RuntimeError(f"rehearsal: {result['error']}")
            yield result["file"]
    finally:
        for process in processes:
            process.kill()
            process.wait()


def _start(settings_json: str, folder: Path) -> subprocess.Popen[str]:
    alone = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    process = subprocess.Popen(
        [sys.executable, "-m", "headcap.synthetic.crew"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | alone,
    )
    _tell(process, {"settings": settings_json, "folder": str(folder.absolute())})
    return process


def _tell(process: subprocess.Popen[str], message: Any) -> None:
    process.stdin.write(json.dumps(message) + "\n")
    process.stdin.flush()


def _feed(process: subprocess.Popen[str], waiting: queue.SimpleQueue, results: queue.SimpleQueue) -> None:
    """Hand one piece after another to a worker until none is left."""
    while True:
        try:
            piece = waiting.get_nowait()
        except queue.Empty:
            return
        try:
            _tell(process, piece)
            answer = process.stdout.readline()
        except OSError:
            answer = ""
        results.put(json.loads(answer) if answer else {"error": f"the worker for {' '.join(piece)} ended (out of memory?)"})
        if not answer:
            return


def _work() -> None:
    """A worker: settings and folder on the first line of the input, then a piece per line."""
    from headcap.synthetic import rehearsal
    from headcap.synthetic.settings import RehearsalSettings

    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # whatever a library prints goes to the log, not between the answers
    task = json.loads(sys.stdin.readline())
    settings = RehearsalSettings.model_validate_json(task["settings"])
    for line in sys.stdin:
        function, *arguments = json.loads(line)
        try:
            answer = {"file": str(getattr(rehearsal, function)(settings, *arguments, Path(task["folder"])))}
        except Exception as error:
            answer = {"error": f"{' '.join([function, *arguments])}: {type(error).__name__}: {error}"}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


if __name__ == "__main__":
    _work()
