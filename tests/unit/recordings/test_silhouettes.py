from pathlib import Path

import cv2
import numpy as np
import pytest

from headcap.errors import InputError
from headcap.recordings.silhouettes import read_silhouettes


def test_white_is_the_subject(tmp_path: Path) -> None:
    image = np.zeros((6, 4), np.uint8)
    image[2:4] = 255
    cv2.imwrite(str(tmp_path / "a_000012.png"), image)
    (mask,) = read_silhouettes(str(tmp_path / "{camera}_{frame:06d}.png"), 12, ["a"])
    np.testing.assert_array_equal(mask, image > 0)


@pytest.mark.parametrize(("pattern", "told"), [("{camera}.png", "no image"), ("{camra}.png", "a pattern with")])
def test_wrong_pattern_or_missing_file_is_told(tmp_path: Path, pattern: str, told: str) -> None:
    with pytest.raises(InputError, match=told):
        read_silhouettes(str(tmp_path / pattern), 0, ["a"])
