"""Turns Snakemake's view of a job into one call of a stage's `run`, with its log, progress and death handled.

`run`'s keyword parameters are named as the rule's inputs, outputs and params; paths come as `Path` (or a list of
them), and everything else is validated against the parameter's annotation.
"""

import inspect
import logging
import os
import sys
import threading
import time
import traceback
import typing
from collections.abc import Callable
from pathlib import Path

from pydantic import TypeAdapter

from headcap.errors import GateFailure, InputError, InputErrors

# params that are there to make the workflow run a stage again, and not for the stage
_TRIGGERS = {"source"}


def run_rule(run: Callable[..., None], snakemake) -> None:
    """Call `run` for one job; on failure log the traceback, print one message and exit with status 1."""
    _die_with_parent()
    _start_log(Path(snakemake.log[0]))
    started = time.monotonic()
    try:
        run(**arguments(run, snakemake))
    except (InputError, InputErrors, GateFailure) as error:
        _fail(snakemake, str(error))
    except Exception as error:
        _fail(snakemake, f"{type(error).__name__}: {error}")
    logging.getLogger("headcap").info("finished in %.1f s", time.monotonic() - started)


def arguments(run: Callable[..., None], snakemake) -> dict:
    """Keyword arguments of `run` from a job's named inputs, outputs and params."""
    hints = typing.get_type_hints(run)
    given = {**_paths(snakemake.input), **_paths(snakemake.output)}
    given |= {name: value for name, value in snakemake.params.items() if name not in _TRIGGERS}
    if "threads" in hints:
        given["threads"] = snakemake.threads
    missing = set(inspect.signature(run).parameters) ^ set(given)
    if missing:
        raise TypeError(f"{run.__module__}.run and its rule do not agree on {sorted(missing)}")
    return {name: TypeAdapter(hints[name]).validate_python(_plain(value)) for name, value in given.items()}


def _paths(named) -> dict:
    return {name: _plain(value) for name, value in named.items()}


def _plain(value):
    # Snakemake hands out its own subclasses of str, list and dict; one file is a str, several are a list
    if isinstance(value, str):
        return str(value)
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def _start_log(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    logger = logging.getLogger("headcap")
    logger.setLevel(logging.INFO)
    file = logging.FileHandler(path, mode="w")
    file.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    logger.addHandler(file)
    # the progress lines of `headcap run`: written to stderr, which Snakemake passes on
    progress = logging.StreamHandler(sys.stderr)
    progress.setFormatter(logging.Formatter("headcap: %(message)s"))
    progress.addFilter(logging.Filter("headcap.progress"))
    logger.addHandler(progress)


def _fail(snakemake, message: str) -> typing.NoReturn:
    logging.getLogger("headcap").error("%s", traceback.format_exc())
    wildcards = ", ".join(str(value) for value in snakemake.wildcards)
    print(f"headcap: error in {snakemake.rule} ({wildcards}): {message}", file=sys.stderr, flush=True)
    sys.exit(1)


def _die_with_parent() -> None:
    # A killed Snakemake leaves its jobs running. Their writes are atomic, but a job that works from old settings must
    # not put its file over that of the next run.
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(137)

    threading.Thread(target=watch, daemon=True).start()
