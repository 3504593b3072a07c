"""The tree of what an artifact was made from, read from the manifests beside it and beside its inputs."""

from __future__ import annotations

from pathlib import Path

from headcap.artifacts.files import ArtifactError
from headcap.artifacts.manifest import Manifest, digest_file, manifest_path

_SHOWN = 12


def provenance_tree(file: Path | str) -> list[str]:
    """Lines that tell an artifact, its stage, figures and inputs, inputs of inputs, down to the recordings.

    A file that is no longer the one an artifact was made from is marked CHANGED, one that is gone MISSING. Raises
    `ArtifactError` where there is no manifest at all.
    """
    file = Path(file)
    if file.name.endswith(".manifest.json"):
        file = file.with_name(file.name.removesuffix(".manifest.json"))
    if not manifest_path(file).is_file():
        raise ArtifactError(f"{file} has no manifest beside it; give a file that a stage wrote, under results/")
    return _told(file, digest=None, depth=0, told=set())


def _told(file: Path, digest: str | None, depth: int, told: set[Path]) -> list[str]:
    indent = "  " * depth
    state = _state(file, digest)
    path = manifest_path(file)
    if not path.is_file():
        return [f"{indent}{file}{state}"]
    manifest = Manifest.load(path)
    own = _state(file, manifest.digest)
    head = f"{indent}{file}  [{manifest.stage}, {manifest.kind}, settings {manifest.settings_digest[:_SHOWN]}]{state or own}"
    if file in told:
        return [f"{head} (as above)"]
    told.add(file)
    lines = [head, f"{indent}  headcap {manifest.package_version}, commit {manifest.commit[:_SHOWN] or 'unknown'}"]
    lines += [f"{indent}  {name} = {value:.6g}" for name, value in manifest.figures.items()]
    for relative, input_digest in manifest.inputs.items():
        lines += _told(_simplified(file.parent / relative), input_digest, depth + 1, told)
    return lines


def _simplified(path: Path) -> Path:
    resolved = path.resolve()
    return resolved.relative_to(Path.cwd()) if resolved.is_relative_to(Path.cwd()) else resolved


def _state(file: Path, digest: str | None) -> str:
    if not file.exists():
        return " MISSING"
    return " CHANGED" if digest and digest_file(file) != digest else ""
