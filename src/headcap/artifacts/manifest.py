"""The manifest beside each artifact: what it is, what it was made from, and the figures of its stage."""

import hashlib
import json
import math
import os
import subprocess
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import headcap
from headcap.artifacts.files import load_json, save_json

SCHEMA = 1


@dataclass(frozen=True)
class Manifest:
    """Provenance of one artifact."""

    artifact: str
    """File name of the artifact, beside the manifest."""
    kind: str
    stage: str
    digest: str
    settings_digest: str
    inputs: dict[str, str]
    """Path of each input, relative to the manifest's folder, to its digest."""
    figures: dict[str, float] = field(default_factory=dict)
    package_version: str = ""
    commit: str = ""

    @classmethod
    def load(cls, path: Path | str) -> "Manifest":
        """Read what `write_manifest` wrote; raises `ArtifactError`."""
        return cls(**load_json(path, "manifest", SCHEMA))


def manifest_path(artifact: Path | str) -> Path:
    """Where the manifest of an artifact lies."""
    return Path(f"{artifact}.manifest.json")


def digest_file(path: Path | str) -> str:
    """sha256 of a file's content."""
    with open(path, "rb") as handle:
        return hashlib.file_digest(handle, "sha256").hexdigest()


def digest_settings(**settings: Any) -> str:
    """sha256 of named settings: pydantic models, or plain values that JSON knows."""
    plain = {name: value.model_dump(mode="json") if hasattr(value, "model_dump") else value for name, value in settings.items()}
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


def write_manifest(
    artifact: Path | str, *, kind: str, stage: str, settings_digest: str, inputs: list[Path], figures: dict[str, float]
) -> Manifest:
    """Write the manifest beside `artifact` and return it."""
    artifact = Path(artifact)
    relative = {os.path.relpath(path, artifact.parent): digest_file(path) for path in map(Path, inputs)}
    manifest = Manifest(
        artifact=artifact.name,
        kind=kind,
        stage=stage,
        digest=digest_file(artifact),
        settings_digest=settings_digest,
        inputs=relative,
        # JSON has no NaN; a figure that could not be measured is left out
        figures={name: float(value) for name, value in figures.items() if math.isfinite(value)},
        package_version=headcap.__version__,
        commit=current_commit(),
    )
    save_json(manifest_path(artifact), "manifest", SCHEMA, asdict(manifest))
    return manifest


@cache
def current_commit() -> str:
    """Commit of the source tree the package is run from, or "" outside a checkout."""
    answer = subprocess.run(
        ["git", "-C", str(Path(headcap.__file__).parent), "rev-parse", "HEAD"], capture_output=True, text=True, check=False
    )
    return answer.stdout.strip()
