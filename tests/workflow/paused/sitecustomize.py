"""Put on the path of a workflow under test: makes a stage stop while it writes, or finds the disk full.

HEADCAP_TEST_STOP names the file that is not renamed into place: its writer says so, with its process id, in
HEADCAP_TEST_STOPPED and waits to be killed. HEADCAP_TEST_FULL limits the size of files that a stage can write, bytes.
"""

import os
import resource
import sys
import time

_rename = os.replace


def _stop_before_rename(source, target, **options):
    if os.path.basename(target) == os.environ["HEADCAP_TEST_STOP"]:
        with open(os.environ["HEADCAP_TEST_STOPPED"] + ".part", "w") as handle:
            handle.write(str(os.getpid()))
        _rename(handle.name, os.environ["HEADCAP_TEST_STOPPED"])
        time.sleep(120)
    _rename(source, target, **options)


def _is_stage() -> bool:
    return any(".snakemake/scripts" in argument for argument in getattr(sys, "orig_argv", []))


if _is_stage() and "HEADCAP_TEST_STOP" in os.environ:
    os.replace = _stop_before_rename
if _is_stage() and "HEADCAP_TEST_FULL" in os.environ:
    size = int(os.environ["HEADCAP_TEST_FULL"])
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
