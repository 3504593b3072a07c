"""Readers and writers of other tools' calibrations, one module per format, all to and from `Rig`.

`Rig` holds integer pixel centres, camera axes x right, y down, z forward, metres. Each module names what its format does
differently.
"""

from collections.abc import Callable
from pathlib import Path

from headcap.cameras import Rig
from headcap.cameras.formats import aniposelib, caliscope, colmap, kalibr, opencv_yaml, transforms_json
from headcap.errors import InputError

READERS: dict[str, Callable[[Path], Rig]] = {
    "colmap": colmap.read,
    "opencv_yaml": opencv_yaml.read,
    "kalibr": kalibr.read,
    "aniposelib": aniposelib.read,
    "caliscope": caliscope.read,
    "transforms_json": transforms_json.read,
}
WRITERS: dict[str, Callable[[Rig, Path], None]] = {
    "colmap": colmap.write,
    "opencv_yaml": opencv_yaml.write,
    "kalibr": kalibr.write,
    "aniposelib": aniposelib.write,
    "caliscope": caliscope.write,
    "transforms_json": transforms_json.write,
}


def read_rig(path: Path | str, format: str | None = None) -> Rig:
    """Read a rig from a file (COLMAP: a folder); without `format` the content tells. Raises `InputError`."""
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path} does not exist", expected="a calibration", remedy="Check the path.")
    name = format or guess_format(path)
    _check_name(name)
    try:
        return READERS[name](path)
    except (KeyError, IndexError, AttributeError, TypeError, ValueError, OSError, RuntimeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{path} is no {name} calibration ({type(error).__name__}: {error})",
            expected=f"what {name} writes",
            remedy="Name the right format.",
        ) from error


def write_rig(rig: Rig, path: Path | str, format: str) -> None:
    """Write a rig to a file (COLMAP: a folder). Raises `InputError` for an unknown format or a lens it cannot hold."""
    _check_name(format)
    WRITERS[format](rig, Path(path))


def guess_format(path: Path) -> str:
    """Name of the format of a file or folder, from its ending and its keys; raises `InputError`."""
    if path.is_dir():
        return "colmap"
    text = path.read_text(errors="replace")
    if path.suffix == ".json":
        return "transforms_json"
    if path.suffix == ".toml":
        return "caliscope" if "[cameras." in text else "aniposelib"
    if path.suffix in (".yaml", ".yml", ".xml"):
        return "kalibr" if "camera_model" in text else "opencv_yaml"
    raise InputError(f"{path.name}", expected=f"a file of {', '.join(READERS)}", remedy="Name its format.")


def _check_name(name: str) -> None:
    if name not in READERS:
        raise InputError(f"calibration format {name!r}", expected=f"one of {', '.join(READERS)}", remedy="Correct the name.")
