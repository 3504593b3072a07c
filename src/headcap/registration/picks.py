"""Named points on the scan that a user picked: the paper's manual correspondences."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.errors import InputError
from headcap.registration.scan import METRES_PER


def read_picks(path: Path | str, unit: str) -> dict[str, NDArray[np.float64]]:
    """Landmark name to place (3,) in metres, from JSON `{"chin": [x, y, z], ...}` in the scan's unit; raises `InputError`."""
    try:
        picks = {name: np.array(place, float) for name, place in json.loads(Path(path).read_text()).items()}
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: {error}", expected="JSON of names and points", remedy="Write it anew.") from error
    wrong = [name for name, place in picks.items() if place.shape != (3,) or not np.isfinite(place).all()]
    if wrong:
        raise InputError(f"{path}: {', '.join(wrong)}", expected="three numbers each", remedy="Correct them.")
    return {name: METRES_PER[unit] * place for name, place in picks.items()}
