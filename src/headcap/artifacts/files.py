"""Atomic writes and strict loads of npz and JSON files that carry their kind and schema version inside."""

import glob
import io
import json
import os
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]*$")]
"""Of a person, take, camera or voice, as it stands in the paths of its files."""

# zip members carry a time stamp; a fixed one makes equal content give equal digests
_ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)


class ArtifactError(ValueError):
    """A file that is not the artifact it was taken for."""


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path in the same folder; on success fsync it and rename it over `path`.

    What a killed writer of the same file left behind is removed first.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    for leftover in path.parent.glob(f".{glob.escape(path.stem)}.*.tmp{path.suffix}"):
        leftover.unlink(missing_ok=True)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")
    try:
        yield temporary
        with open(temporary, "rb+") as handle:
            os.fsync(handle.fileno())
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def save_json(path: Path | str, kind: str, schema: int, content: dict[str, Any]) -> None:
    """Write `content` as JSON under `schema: headcap.<kind>/<schema>`."""
    document = {"schema": f"headcap.{kind}/{schema}", **content}
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n")


def load_json(path: Path | str, kind: str, schema: int) -> dict[str, Any]:
    """Read what `save_json` wrote; raises `ArtifactError` for another kind, version or a damaged file."""
    try:
        document = json.loads(Path(path).read_text())
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ArtifactError(f"{path} is no JSON ({error}); delete it and run its stage again") from error
    found = document.pop("schema", None) if isinstance(document, dict) else None
    _check(path, found, kind, schema)
    return document


def save_arrays(path: Path | str, kind: str, schema: int, arrays: dict[str, np.ndarray], meta: dict | None = None) -> None:
    """Write arrays and a JSON `meta` record as an uncompressed npz with fixed time stamps."""
    header = {"schema": f"headcap.{kind}/{schema}", "meta": meta or {}}
    members = {"__header__": np.array(json.dumps(header, sort_keys=True)), **arrays}
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
        for name, array in members.items():
            buffer = io.BytesIO()
            np.lib.format.write_array(buffer, np.asanyarray(array), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy", _ZIP_EPOCH), buffer.getvalue())


def load_arrays(path: Path | str, kind: str, schema: int) -> tuple[dict[str, np.ndarray], dict]:
    """Read what `save_arrays` wrote as (arrays, meta); raises `ArtifactError` for another kind or version."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (zipfile.BadZipFile, ValueError, EOFError) as error:
        raise ArtifactError(f"{path} is damaged ({error}); delete it and run its stage again") from error
    header = json.loads(str(arrays.pop("__header__"))) if "__header__" in arrays else {}
    _check(path, header.get("schema"), kind, schema)
    return arrays, header["meta"]


def _check(path: Path | str, found: str | None, kind: str, schema: int) -> None:
    wanted = f"headcap.{kind}/{schema}"
    if found != wanted:
        raise ArtifactError(
            f"{path} holds {found or 'no headcap artifact'}, expected {wanted}; run its stage again with this version"
        )
