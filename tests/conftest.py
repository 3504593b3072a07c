"""Fixtures shared by every test: where recordings of others lie, and the seeded random numbers."""

import os
from pathlib import Path

import numpy as np
import pytest


def _test_data_folder() -> Path | None:
    """The folder of recordings the project did not make, or None where there is none."""
    named = os.environ.get("HEADCAP_TEST_DATA")
    # The second place is for a working copy that lies beside the data in a sibling folder.
    folder = Path(named) if named else Path(__file__).resolve().parents[2] / "shared" / "data"
    return folder if folder.is_dir() else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what is marked `real` where the recordings are absent, and say why."""
    if _test_data_folder() is not None:
        return
    reason = "no recordings: set HEADCAP_TEST_DATA to their folder, or place them in ../shared/data"
    for item in items:
        if "real" in item.keywords:
            item.add_marker(pytest.mark.skip(reason=reason))


@pytest.fixture(scope="session")
def test_data() -> Path:
    """The folder of recordings the project did not make; only for tests marked `real`."""
    folder = _test_data_folder()
    if folder is None:
        pytest.skip("no recordings: set HEADCAP_TEST_DATA to their folder, or place them in ../shared/data")
    return folder


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers that are the same in every run and for every test."""
    return np.random.default_rng(20130)
