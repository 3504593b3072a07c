from pathlib import Path

import pytest

from headcap.workflow.source import reached_modules, source_digest

SCRIPT = "from headcap.sync import TimeOffsets\n\n\ndef run():\n    return TimeOffsets\n"


@pytest.fixture
def script(tmp_path: Path) -> Path:
    path = tmp_path / "stage.py"
    path.write_text(SCRIPT)
    return path


def test_modules_are_reached_through_others_and_their_packages(script: Path) -> None:
    reached = reached_modules(script)
    assert {"headcap", "headcap.sync", "headcap.sync.offsets", "headcap.artifacts", "headcap.artifacts.files"} <= reached
    assert "headcap.registration" not in reached


def test_imports_inside_functions_count(tmp_path: Path) -> None:
    path = tmp_path / "stage.py"
    path.write_text("def run():\n    from headcap.sync import offsets\n    return offsets\n")
    assert "headcap.sync.offsets" in reached_modules(path)


def test_comments_docstrings_and_layout_do_not_change_the_digest(script: Path) -> None:
    before = source_digest(script)
    script.write_text('"""Says what it does."""\n\n# a reason\n' + SCRIPT.replace("def run():", 'def run():\n    """Run."""'))
    assert source_digest(script) == before


def test_code_changes_the_digest(script: Path) -> None:
    before = source_digest(script)
    script.write_text(SCRIPT.replace("return TimeOffsets", "return TimeOffsets, 1"))
    assert source_digest(script) != before


def test_an_edit_of_a_module_reached_changes_the_digest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import headcap.workflow.source as source

    package = tmp_path / "headcap"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "deep.py").write_text("VALUE = 1\n")
    (package / "stage.py").write_text("from headcap.deep import VALUE\n")
    script = tmp_path / "script.py"
    script.write_text("import headcap.stage\n")
    monkeypatch.setattr(source, "_PACKAGE_ROOT", package)

    def digest() -> str:
        for cached in (source._module_file, source._modules, source._read_code):
            cached.cache_clear()
        return source_digest(script)

    try:
        before = digest()
        (package / "deep.py").write_text("VALUE = 2\n")
        assert digest() != before
    finally:
        for cached in (source._module_file, source._modules, source._read_code):
            cached.cache_clear()


@pytest.mark.parametrize(
    "around",
    [
        "if 1:\n    {}",
        "try:\n    pass\nexcept OSError:\n    {}",
        "for _ in ():\n    pass\nelse:\n    {}",
        "class A:\n    def run(self):\n        {}",
    ],
    ids=["if", "except", "else", "method"],
)
def test_imports_and_docstrings_are_found_wherever_they_stand(tmp_path: Path, around: str) -> None:
    path = tmp_path / "stage.py"
    path.write_text(around.format("from headcap.sync import offsets"))
    assert "headcap.sync.offsets" in reached_modules(path)
    inner = "class B:\n{0}    pass"
    digests = []
    for docstring in ("", '    """Says what it is."""\n'):
        block = inner.format(docstring)
        indent = around.split("\n")[-1].split("{")[0]
        path.write_text(around.format(block.replace("\n", f"\n{indent}")))
        digests.append(source_digest(path))
    assert digests[0] == digests[1]
