"""Digests of the code a stage runs, so that an edit of the package makes the workflow run the stage again.

Snakemake sees changes of inputs, parameters and scripts but not of the modules a script imports. A rule therefore
carries the digest of its script and of every headcap module that the script imports, directly or not. Comments,
docstrings and layout do not count: the digest is taken of the syntax tree.
"""

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

PACKAGE = "headcap"
_PACKAGE_ROOT = Path(__file__).parents[1]
_BLOCKS = ("body", "orelse", "finalbody", "handlers", "cases")
"""Where a statement holds others."""


def source_digest(script: Path | str) -> str:
    """Hexadecimal digest of a script and of the package's modules it reaches; raises FileNotFoundError."""
    digest = hashlib.sha256(_code(Path(script)).digest.encode())
    for module in sorted(reached_modules(script)):
        digest.update(f"{module}:{_code(_module_file(module)).digest}".encode())
    return digest.hexdigest()[:16]


def reached_modules(script: Path | str) -> set[str]:
    """Names of the package's modules that a script imports, transitively, imports inside functions included."""
    waiting, reached = set(_modules(_code(Path(script)).imports)), set()
    while waiting:
        module = waiting.pop()
        if module not in reached:
            reached.add(module)
            waiting |= _modules(_code(_module_file(module)).imports) - reached
    return reached


class _Code(NamedTuple):
    digest: str
    imports: frozenset[str]
    """Names as imported, members among them."""


def _code(path: Path) -> _Code:
    return _read_code(path, path.stat().st_mtime_ns)


@cache
def _read_code(path: Path, _modified_ns: int) -> _Code:
    """Of a file as it was at a time. The tree is not kept: hundreds of them would slow down whatever comes after."""
    tree = ast.parse(path.read_text())
    imports: set[str] = set()
    for node in (tree, *_statements(tree)):
        if isinstance(node, ast.Import):
            imports.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            # `from headcap.cameras import rig` may name a module or a member: both are tried later
            imports.update([node.module, *(f"{node.module}.{alias.name}" for alias in node.names)])
        elif isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            node.body = [statement for statement in node.body if not _is_docstring(statement)] or [ast.Pass()]
    own = frozenset(name for name in imports if name.split(".")[0] == PACKAGE)
    return _Code(hashlib.sha256(ast.dump(tree).encode()).hexdigest(), own)


def _statements(node: ast.AST) -> Iterator[ast.AST]:
    """All below a module or statement; expressions, which are most of a tree, hold none."""
    for block in _BLOCKS:
        for child in getattr(node, block, ()):
            yield child
            yield from _statements(child)


@cache
def _modules(imports: frozenset[str]) -> frozenset[str]:
    """Those of imported names that are modules of the package, and the packages they lie in."""
    return frozenset(part for name in imports for part in _with_parents(name) if _module_file(part))


def _with_parents(name: str) -> list[str]:
    # importing a.b.c runs a/__init__ and a.b/__init__ too
    parts = name.split(".")
    return [".".join(parts[:count]) for count in range(1, len(parts) + 1)]


@cache
def _module_file(module: str) -> Path | None:
    path = _PACKAGE_ROOT.joinpath(*module.split(".")[1:])
    for candidate in (path.with_suffix(".py"), path / "__init__.py"):
        if candidate.is_file():
            return candidate
    return None


def _is_docstring(statement: ast.stmt) -> bool:
    return (
        isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant) and isinstance(statement.value.value, str)
    )
