import subprocess
import sys
import time
from pathlib import Path

from headcap.workflow.lock import hold_run_lock, run_is_alive

HOLDER = """
import sys, time
from headcap.workflow.lock import hold_run_lock
print(hold_run_lock(sys.argv[1]), flush=True)
time.sleep(60)
"""


def start_holder(folder: Path) -> tuple[subprocess.Popen, int]:
    process = subprocess.Popen([sys.executable, "-c", HOLDER, str(folder)], stdout=subprocess.PIPE, text=True)
    return process, int(process.stdout.readline())


def leave_lock_files(folder: Path) -> None:
    (folder / "locks").mkdir(parents=True, exist_ok=True)
    (folder / "locks" / "0.input.lock").write_text("a.mp4")


def test_locks_of_a_killed_run_are_removed_and_those_of_a_live_one_are_not(tmp_path: Path) -> None:
    first, removed = start_holder(tmp_path)
    assert removed == 0
    leave_lock_files(tmp_path)
    second, removed = start_holder(tmp_path)
    try:
        assert removed == 0
        assert (tmp_path / "locks" / "0.input.lock").exists()
        assert run_is_alive(tmp_path)
    finally:
        for process in (first, second):
            process.kill()
            process.wait()
    for _ in range(50):
        if not run_is_alive(tmp_path):
            break
        time.sleep(0.1)
    assert not run_is_alive(tmp_path)
    third, removed = start_holder(tmp_path)
    third.kill()
    third.wait()
    assert removed == 1


def test_no_folder_means_no_run(tmp_path: Path) -> None:
    assert not run_is_alive(tmp_path / "none")
    assert hold_run_lock(tmp_path / "none") == 0
