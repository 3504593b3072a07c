"""Voices with known pitch."""

import numpy as np
import pytest

from headcap.speech.framing import RATE_HZ
from headcap.synthetic.articulation import speak
from headcap.synthetic.voice import synthesise


def _voice(seconds: float, pitch_hz: float, seed: int = 0):
    """Sound at 16 kHz, and the tracks that it was made from."""
    tracks = speak(np.random.default_rng(seed), seconds, pitch_hz=pitch_hz)
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    return synthesise(tracks, np.random.default_rng(seed + 1), time_s, RATE_HZ), tracks


@pytest.fixture(scope="session")
def voice():
    """A maker of voices: `voice(seconds, pitch_hz, seed)`."""
    return _voice


@pytest.fixture(scope="session")
def speech():
    """Four seconds of a voice around 120 Hz."""
    return _voice(4.0, 120.0)[0]
