"""The floors of the package, held by import-linter; each guard is shown to fail once, on a copy with a violation."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
LINT = Path(sys.executable).with_name("lint-imports")


def lint(folder: Path) -> subprocess.CompletedProcess:
    # the copy must be found before the installed package
    environment = {"PYTHONPATH": str(folder / "src"), "PATH": "/usr/bin:/bin"}
    command = [str(LINT), "--no-cache"]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def copied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("copy")
    skipped = shutil.ignore_patterns("__pycache__", "*.npz")
    shutil.copytree(REPOSITORY / "src", folder / "src", ignore=skipped)
    shutil.copytree(REPOSITORY / "pipeline", folder / "pipeline", ignore=skipped)
    shutil.copy(REPOSITORY / "pyproject.toml", folder)
    return folder


def test_the_package_keeps_its_floors(copied: Path) -> None:
    result = lint(copied)
    assert result.returncode == 0, result.stdout


@pytest.mark.parametrize(
    ("module", "violation"),
    [
        ("geometry/transforms.py", "import headcap.registration.template"),
        ("evaluation/metrics.py", "import headcap.synthetic.settings"),
        ("heads/model.py", "import headcap.neck.larynx"),
        ("recordings/probe.py", "import snakemake"),
        ("heads/sculpt.py", "import headcap.speech.lpc"),
    ],
)
def test_each_guard_can_fail(copied: Path, module: str, violation: str) -> None:
    path = copied / "src" / "headcap" / module
    before = path.read_text()
    path.write_text(f"{before}\n\n{violation}\n")
    try:
        result = lint(copied)
    finally:
        path.write_text(before)
    assert result.returncode == 1
    assert "BROKEN" in result.stdout
