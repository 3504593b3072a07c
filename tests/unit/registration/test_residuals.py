from pathlib import Path

import numpy as np
import pytest

from headcap.registration.residuals import TrackResiduals


def test_chunks_join_in_the_order_of_time_and_come_back_from_a_file(tmp_path: Path) -> None:
    late = TrackResiduals.of("smile", [0.2, 0.3], {"last_step_mm": [0.05, 0.01]})
    early = TrackResiduals.of("smile", [0.0, 0.1], {"last_step_mm": [0.02, 0.03]})
    joined = TrackResiduals.joined([late, early])
    assert len(joined) == 4
    assert joined.worst == {"track.last_step_mm": 0.05}
    joined.save(tmp_path / "residuals.json")
    back = TrackResiduals.load(tmp_path / "residuals.json")
    np.testing.assert_array_equal(back.time_s, [0.0, 0.1, 0.2, 0.3])
    np.testing.assert_array_equal(back.values["last_step_mm"], [0.02, 0.03, 0.05, 0.01])


def test_what_does_not_make_one_take_is_refused() -> None:
    first = TrackResiduals.of("smile", [0.0], {"last_step_mm": [0.02]})
    for other in (("frown", {"last_step_mm": [0.1]}), ("smile", {"other": [0.1]})):
        with pytest.raises(ValueError, match="one take"):
            TrackResiduals.joined([first, TrackResiduals.of(other[0], [0.1], other[1])])
    with pytest.raises(ValueError, match="last_step_mm"):
        TrackResiduals.of("smile", [0.0, 0.1], {"last_step_mm": [0.02]})
