from fractions import Fraction

import numpy as np
import pytest

from headcap.errors import InputError
from headcap.speech.framing import centres_at, frame_starts, visual_centres


def test_frames_of_a_visual_frame_span_520_ms_around_its_moment():
    starts = frame_starts(np.array([16000]))[0]
    assert len(starts) == 64
    assert starts[0] == 16000 - 4160
    assert starts[-1] + 256 == 16000 + 4160
    assert set(np.diff(starts)) == {128}


@pytest.mark.parametrize("fps", [Fraction(25), Fraction(30), Fraction(30000, 1001), Fraction(60)])
def test_centres_stay_within_half_a_sample_of_their_moments_for_hours(fps):
    centres = visual_centres(3, float(fps), first=1_000_000)
    exact = [Fraction(16000 * n) / fps for n in range(1_000_000, 1_000_003)]
    # half a sample by rounding, and what a double rate loses over ten hours
    assert all(abs(c - e) <= Fraction(1, 2) + Fraction(1, 1000) for c, e in zip(centres.tolist(), exact, strict=True))


def test_a_later_start_moves_every_centre_and_moments_give_the_same():
    np.testing.assert_array_equal(visual_centres(50, 25.0, start_s=0.5), visual_centres(50, 25.0) + 8000)
    np.testing.assert_array_equal(centres_at(np.arange(50) / 30), visual_centres(50, 30.0))


def test_neighbours_share_frames_where_the_rate_allows_it():
    assert len(np.unique(frame_starts(visual_centres(100, 25.0)))) == 99 * 5 + 64


def test_a_rate_that_is_none_is_refused():
    with pytest.raises(InputError, match="0 visual frames per second"):
        visual_centres(10, 0)
