"""The workflow's own files: lint-clean, a dry run of study and session, one stage per file."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]


def snakemake(folder: Path, *options: str) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(REPOSITORY / "Snakefile"), *options]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_snakemake_finds_nothing_to_criticise(tmp_path: Path) -> None:
    result = snakemake(tmp_path, "--lint", "--configfile", str(REPOSITORY / "config/demo.yaml"))
    assert "in a good condition" in result.stdout + result.stderr, result.stdout


def test_demo_is_planned_by_snakemake_alone(tmp_path: Path) -> None:
    (tmp_path / "config").symlink_to(REPOSITORY / "config")
    result = snakemake(tmp_path, "--dry-run")
    assert result.returncode == 0, result.stdout + result.stderr
    rules = ("rehearse", "ingest", "sync_board", "detect", "calibrate", "sync", "register", "inpaint_lips", "evaluate", "report")
    for rule in rules:
        assert f"rule {rule}:" in result.stdout or f"checkpoint {rule}:" in result.stdout


@pytest.mark.real
def test_session_is_planned_with_its_chunks_where_frames_are_given(tmp_path: Path, test_data: Path) -> None:
    session = (REPOSITORY / "config/sessions/ict_rig.yaml").read_text()
    for take in ("pose_01", "expression_01", "speech_01"):
        line = f"  - name: {take}\n"
        session = session.replace(line, f"{line}    frames: [10, 21]\n")
    (tmp_path / "session.yaml").write_text(f"{session}frames_per_job: {{reconstruct: 5, track: 8}}\n")
    result = snakemake(tmp_path, "--dry-run", "--configfile", "session.yaml", "--config", f"data_root={test_data / 'ict_rig'}")
    assert result.returncode == 0, result.stdout + result.stderr
    counts = dict(line.split() for line in result.stdout.split("Job stats:")[1].splitlines() if len(line.split()) == 2)
    # twelve frames of each of three takes: chunks of 5, 5, 2 and of 8, 4
    assert (counts["reconstruct"], counts["track"], counts["detect"]) == ("9", "6", "16")
    assert (counts["train_neck"], counts["train_speech"]) == ("1", "1")
    (tmp_path / "session.yaml").write_text(f"{session}train_speech: null\n")
    without = snakemake(tmp_path, "--dry-run", "--configfile", "session.yaml", "--config", f"data_root={test_data / 'ict_rig'}")
    assert without.returncode == 0, without.stdout + without.stderr
    assert "train_neck" in without.stdout
    assert "train_speech" not in without.stdout


def test_a_session_that_is_wrong_is_refused_before_any_job(tmp_path: Path) -> None:
    (tmp_path / "session.yaml").write_text("session: demo\nrehearse: {sead: 1}\ntaks: []\n")
    result = snakemake(tmp_path, "--configfile", "session.yaml")
    told = result.stdout + result.stderr
    assert result.returncode != 0
    assert "rehearse.sead: unknown key" in told
    assert "Did you mean takes?" in told
    assert not (tmp_path / "results").exists()


def test_results_do_not_depend_on_the_machines_cores() -> None:
    common = (REPOSITORY / "rules/common.smk").read_text()
    assert all(name in common for name in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"))


@pytest.mark.parametrize("path", sorted((REPOSITORY / "rules").glob("*.smk")), ids=lambda path: path.stem)
def test_rules_open_with_their_contract_and_keep_to_their_place(path: Path) -> None:
    text = path.read_text()
    assert text.startswith('"""\n')
    if path.stem == "common":
        return
    assert "INPUTS:" in text
    assert "OUTPUTS:" in text
    assert "lambda" not in text
    assert "def " not in text
    rules = text.count("\nrule ") + text.count("\ncheckpoint ")
    for part in ('    """', "    log:", "    benchmark:", "    script:", "source=source("):
        assert text.count(f"\n{part}" if part.startswith("    ") else part) >= rules, part


def test_run_refuses_a_wrong_study_by_name(tmp_path: Path) -> None:
    (tmp_path / "study.yaml").write_text("study: demo\nsesions: []\n")
    command = [sys.executable, "-m", "headcap.cli", "run", "study.yaml"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, env=os.environ)
    assert result.returncode == 1
    assert "Did you mean sessions?" in result.stderr


def blocks() -> list[tuple[str, str]]:
    """Each rule's script and text."""
    text = "\n".join(path.read_text() for path in (REPOSITORY / "rules").glob("*.smk") if path.stem != "common")
    rules = re.split(r"\n(?:rule|checkpoint) ", text)[1:]
    return [(re.search(r"pipeline/(\w+)\.py", rule)[1], rule) for rule in rules]


def given_names(rule: str) -> set[str]:
    """Names of a rule's inputs, outputs and params, but for the code's digest."""
    sections = re.findall(r"^    (?:input|output|params):\n((?:        .*\n)+)", rule, re.MULTILINE)
    names = set(re.findall(r"^        (\w+)=", "".join(sections), re.MULTILINE)) - {"source"}
    if "unpack(session_results)" in rule:
        common = (REPOSITORY / "rules/common.smk").read_text().split("def session_results")[1].split("\ndef ")[0]
        names |= set(re.findall(r'^        "(\w+)":', common, re.MULTILINE))
    return names


@pytest.mark.parametrize(("script", "rule"), blocks(), ids=lambda value: value if value.isidentifier() else "")
def test_rule_and_script_name_the_same_things(script: str, rule: str) -> None:
    tree = ast.parse((REPOSITORY / "pipeline" / f"{script}.py").read_text())
    run = next(node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "run")
    assert given_names(rule) == {argument.arg for argument in run.args.kwonlyargs} - {"threads"}
