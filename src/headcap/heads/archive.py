"""Model files of other makers that are npz archives of plain arrays."""

import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError


def read_npz(path: Path, *, expected: str, remedy: str) -> dict[str, NDArray]:
    """All arrays of an archive; raises `InputError` where it is damaged, no archive, or holds objects."""
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, TypeError, zipfile.BadZipFile) as error:
        # a bare npy file loads as an array, which is no archive: TypeError
        raise InputError(f"{path.name} cannot be read ({error})", expected=expected, remedy=remedy) from error
