"""What a report was made of and with, for its foot."""

import importlib.metadata
import platform
from collections.abc import Iterable
from pathlib import Path

from headcap.artifacts import Manifest
from headcap.artifacts.manifest import manifest_path

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


def manifests_of(files: Iterable[Path]) -> tuple[tuple[str, Manifest], ...]:
    """Manifests of those files that have one, by the file's last two names."""
    return tuple(
        (str(Path(*path.parts[-2:])), Manifest.load(manifest_path(path))) for path in files if manifest_path(path).is_file()
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
