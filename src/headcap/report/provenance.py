"""What an environment consists of, for the foot of a report."""

import importlib.metadata
import platform

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
