"""What a page and its environment were made of, for the foot of a report."""

from __future__ import annotations

import importlib.metadata
import platform
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from headcap.artifacts import Manifest, manifest_path
from headcap.evaluation.metrics import Figure

_PACKAGES = (
    "headcap",
    "numpy",
    "scipy",
    "numba",
    "opencv-contrib-python-headless",
    "pycolmap",
    "open3d",
    "trimesh",
    "libigl",
    "av",
    "cholespy",
    "pydantic",
    "snakemake",
)


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that results depend on, as far as they are installed."""
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def manifests_of(artifacts: Mapping[str, Path]) -> tuple[tuple[str, Manifest], ...]:
    """Manifests of artifacts by name; those that have none are passed over."""
    made = {name: manifest_path(path) for name, path in artifacts.items()}
    return tuple((name, Manifest.load(path)) for name, path in made.items() if path.is_file())


@dataclass(frozen=True)
class PageFoot:
    """What the foot of a page tells, as `write_page` takes it where a page needs nothing beside."""

    figures: tuple[Figure, ...]
    manifests: tuple[tuple[str, Manifest], ...]
    """By the name that a reader knows the artifact by."""
    versions: Mapping[str, str]
    settings: Mapping

    @classmethod
    def of(cls, figures: Iterable[Figure], artifacts: Mapping[str, Path], settings: Mapping) -> PageFoot:
        """Of artifacts by name (see `manifests_of`) and this environment."""
        return cls(tuple(figures), manifests_of(artifacts), versions(), settings)
