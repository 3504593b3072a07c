"""Digests of the code a stage runs, so that an edit of the package makes the workflow run the stage again.

Snakemake sees changes of inputs, parameters and scripts but not of the modules a script imports. A rule therefore
carries the digest of its script and of every headcap module that the script imports, directly or not. Comments,
docstrings and layout do not count: the digest is taken of the syntax tree.
"""

import ast
import hashlib
from functools import cache
from pathlib import Path

PACKAGE = "headcap"
_PACKAGE_ROOT = Path(__file__).parents[1]


def source_digest(script: Path | str) -> str:
    """Hexadecimal digest of a script and of the package's modules it reaches; raises FileNotFoundError."""
    script = Path(script)
    digest = hashlib.sha256(_code_digest(script, script.stat().st_mtime_ns).encode())
    for module in sorted(reached_modules(script)):
        digest.update(f"{module}:{_module_digest(module)}".encode())
    return digest.hexdigest()[:16]


def reached_modules(script: Path | str) -> set[str]:
    """Names of the package's modules that a script imports, transitively, imports inside functions included."""
    waiting, reached = _imports(Path(script)), set()
    while waiting:
        module = waiting.pop()
        if module not in reached:
            reached.add(module)
            waiting |= _module_imports(module) - reached
    return reached


@cache
def _module_file(module: str) -> Path | None:
    path = _PACKAGE_ROOT.joinpath(*module.split(".")[1:])
    for candidate in (path.with_suffix(".py"), path / "__init__.py"):
        if candidate.is_file():
            return candidate
    return None


@cache
def _module_imports(module: str) -> set[str]:
    return _imports(_module_file(module))


@cache
def _module_digest(module: str) -> str:
    file = _module_file(module)
    return _code_digest(file, file.stat().st_mtime_ns)


def _imports(path: Path) -> set[str]:
    found: set[str] = set()
    for node in ast.walk(_tree(path, path.stat().st_mtime_ns)):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            # `from headcap.cameras import rig` may name a module or a member: both are tried below
            found.update([node.module, *(f"{node.module}.{alias.name}" for alias in node.names)])
    return {part for name in found if name.split(".")[0] == PACKAGE for part in _with_parents(name) if _module_file(part)}


def _with_parents(name: str) -> list[str]:
    # importing a.b.c runs a/__init__ and a.b/__init__ too
    parts = name.split(".")
    return [".".join(parts[:count]) for count in range(1, len(parts) + 1)]


@cache
def _tree(path: Path, _modified_ns: int) -> ast.Module:
    return ast.parse(path.read_text())


@cache
def _code_digest(path: Path, _modified_ns: int) -> str:
    tree = _tree(path, _modified_ns)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = [statement for statement in node.body if not _is_docstring(statement)] or [ast.Pass()]
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest()


def _is_docstring(statement: ast.stmt) -> bool:
    return (
        isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant) and isinstance(statement.value.value, str)
    )
