from pathlib import Path

import pytest

from headcap.errors import InputError
from headcap.registration.picks import read_picks


def test_picks_come_in_metres(tmp_path: Path) -> None:
    path = tmp_path / "picks.json"
    path.write_text('{"chin": [10, -20, 300]}')
    assert read_picks(path, "mm")["chin"].tolist() == pytest.approx([0.01, -0.02, 0.3])


@pytest.mark.parametrize("content", ["{", '{"chin": [1, 2]}', '{"chin": "left"}', "[1, 2]", '{"chin": [1, 2, NaN]}'])
def test_anything_else_is_refused(tmp_path: Path, content: str) -> None:
    path = tmp_path / "picks.json"
    path.write_text(content)
    with pytest.raises(InputError, match=r"picks\.json"):
        read_picks(path, "mm")
