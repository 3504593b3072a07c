"""Archives of other makers: plain arrays come out, all else is refused by name."""

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.heads.archive import read_npz


def test_plain_arrays_come_out(tmp_path):
    np.savez(tmp_path / "a.npz", x=np.arange(3))
    assert read_npz(tmp_path / "a.npz", expected="", remedy="")["x"].tolist() == [0, 1, 2]


@pytest.mark.parametrize("kind", ["cut off", "no archive", "text", "objects"])
def test_what_is_no_archive_of_plain_arrays_is_refused(tmp_path, kind):
    path = tmp_path / "model.npz"
    np.savez(path, x=np.array([{}], object) if kind == "objects" else np.arange(100))
    if kind == "cut off":
        path.write_bytes(path.read_bytes()[:200])
    elif kind == "no archive":
        with path.open("wb") as file:
            np.save(file, np.arange(3))
    elif kind == "text":
        path.write_text("not arrays")
    with pytest.raises(InputError, match=r"model\.npz cannot be read"):
        read_npz(path, expected="an npz", remedy="Copy it again.")
