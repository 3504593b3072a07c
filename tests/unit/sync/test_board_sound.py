from pathlib import Path

import numpy as np

from headcap.sync.board_sound import load_clapper, place_clapper, save_clapper
from headcap.sync.clapper import ClapperEstimate


def test_clapper_reads_back_with_what_is_not_known(tmp_path: Path) -> None:
    estimate = ClapperEstimate(np.array([0.0, -0.05, 0.3]), np.full(3, np.inf), {"a": 0.0, "b": 0.002}, np.nan)
    save_clapper(estimate, tmp_path / "clapper.json")
    loaded = load_clapper(tmp_path / "clapper.json")
    np.testing.assert_array_equal(loaded.clapper_m, estimate.clapper_m)
    assert loaded.av_offset_s == {"a": 0.0, "b": 0.002}
    assert np.isnan(loaded.residual_rms_s)


def test_without_a_clap_or_a_moving_board_the_rough_place_stands() -> None:
    centres = {"a": np.zeros(3), "b": np.ones(3)}
    for clap, moved in ((False, {"a": 0.0, "b": 0.0}), (True, {})):
        found = place_clapper(None, None, moved, moved, centres, (0.0, -0.05, 0.3), clap=clap)
        assert found.clapper_m.tolist() == [0.0, -0.05, 0.3]
        assert found.av_offset_s == {"a": 0.0, "b": 0.0}
