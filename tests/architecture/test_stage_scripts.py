"""What a stage script and a module may import; each guard is shown to fail once."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
STAGES = sorted(path for path in (REPOSITORY / "pipeline").glob("*.py") if path.stem != "adapter")
# slow to import, so only where they are used
HEAVY = {"open3d"}
STANDARD = {"logging", "pathlib", "shutil", "statistics", "dataclasses"}


def imported(nodes: list[ast.stmt]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield (node.module or "").split(".")[0]


def foreign_imports(code: str) -> set[str]:
    """What a stage script imports beside the package, the adapter and the standard library's paths and logs."""
    nodes = [node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Import | ast.ImportFrom)]
    return set(imported(nodes)) - {"headcap", "adapter"} - STANDARD


def heavy_imports(code: str) -> set[str]:
    """Heavy packages that a module imports when it is itself imported."""
    return set(imported(ast.parse(code).body)) & HEAVY


@pytest.mark.parametrize("path", STAGES, ids=lambda path: path.stem)
def test_stage_scripts_call_the_package_and_nothing_else(path: Path) -> None:
    assert foreign_imports(path.read_text()) == set()


@pytest.mark.parametrize("path", STAGES, ids=lambda path: path.stem)
def test_stage_scripts_have_one_run_and_the_adapter(path: Path) -> None:
    tree = ast.parse(path.read_text())
    functions = [node.name for node in tree.body if isinstance(node, ast.FunctionDef)]
    assert "run" in functions
    assert ast.unparse(tree.body[-1]).startswith("if 'snakemake' in globals():")


def test_heavy_packages_are_imported_where_they_are_used() -> None:
    found = {path.name: heavy_imports(path.read_text()) for path in (REPOSITORY / "src").rglob("*.py")}
    assert {name: heavy for name, heavy in found.items() if heavy} == {}


def test_the_guards_can_fail() -> None:
    assert foreign_imports("import numpy as np\nfrom track import run\n") == {"numpy", "track"}
    assert heavy_imports("import open3d as o3d\n") == {"open3d"}
    assert heavy_imports("def read():\n    import open3d\n") == set()
