"""Tables of landmarks: what other programs make of CSV is read, what is no number is told by its line."""

import math
from pathlib import Path

import pytest

from headcap.errors import InputError
from headcap.heads.landmark_table import LandmarkTable, coordinate, landmark_file


def table(tmp_path: Path, content: bytes) -> LandmarkTable:
    (tmp_path / "a.csv").write_bytes(content)
    return LandmarkTable.read(tmp_path / "a.csv")


def test_marks_spaces_line_ends_and_short_rows_are_borne(tmp_path):
    found = table(tmp_path, b"\xef\xbb\xbfframe, x , name\r\n1, 2.5, nose\r\n\r\n2,,\r\n3\r\n")
    assert found.columns == ("frame", "x", "name")
    assert found.column("frame", int) == [1, 2, 3]
    assert found.column("name", str.strip) == ["nose", "", ""]
    first, *others = found.column("x", coordinate)
    assert first == 2.5
    assert all(math.isnan(other) for other in others)
    assert found.has("x", "frame")
    assert not found.has("x", "y")


def test_what_is_no_number_is_told_by_its_line(tmp_path):
    found = table(tmp_path, b"frame,x\n1,2\n\n2,far\n")
    with pytest.raises(InputError, match="line 4: could not convert string to float: 'far'"):
        found.column("x", coordinate)
    with pytest.raises(InputError, match="line 2: invalid literal"):
        table(tmp_path, b"frame\n1.5\n").column("frame", int)


def test_what_is_no_table_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        table(tmp_path, b"frame\n\xff\xfe\n")
    with pytest.raises(InputError, match="cannot be read"):
        LandmarkTable.read(tmp_path / "none.csv")
    with pytest.raises(InputError, match=r"ends in \.json or \.csv"):
        landmark_file("face.txt")
