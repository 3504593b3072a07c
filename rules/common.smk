"""
Functions of the rules: inputs and parameters that depend on the session file.
There are no functions anywhere else in the workflow.
"""

import os
from pathlib import Path

from snakemake.exceptions import WorkflowError

from headcap.errors import InputError, InputErrors
from headcap.recordings.timeline import Timeline
from headcap.settings import CALIBRATION
from headcap.workflow.lock import hold_run_lock
from headcap.workflow.plan import load_plan
from headcap.workflow.source import source_digest

# one thread per job: the workflow runs jobs side by side instead, and results do not hang on the machine's cores
for name in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"


def read_plan(document):
    """The checked session or study; all that is wrong with it is told before any job."""
    try:
        return load_plan(document)
    except (InputError, InputErrors) as error:
        raise WorkflowError(f"the session or study cannot be used:\n{error}") from None


def source(stage):
    """Digest of the code that a stage's script runs."""
    return source_digest(Path(workflow.basedir) / "pipeline" / f"{stage}.py")


def session_of(wildcards):
    return PLAN.sessions[wildcards.session]


def setting(name):
    """One entry of the session, as plain values."""

    def entry(wildcards):
        return session_of(wildcards).model_dump(mode="json")[name]

    return entry
