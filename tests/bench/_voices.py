"""Recorded voices with what they were measured against, and the features that the field would take instead.

Used by the benchmark `speech` and by the tests on recordings; mel-frequency cepstra are here and not in the package, which
has no use for them.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.io import wavfile
from scipy.signal import resample_poly

from headcap.speech import RATE_HZ, SpeechFeatures, speech_features, visual_centres
from headcap.speech.framing import frame_starts
from headcap.speech.moments import Moments, moments_of

LARYNGOGRAPH_STEP = 240
"""Samples at 16 kHz between values of the laryngograph, 15 ms."""


def laryngograph(folder: Path) -> list[tuple[NDArray, NDArray]]:
    """Sentences at 16 kHz (n,) with the pitch that a laryngograph measured each 15 ms (m,), 0 unvoiced."""
    found = []
    for path in sorted((folder / "speech" / "fda_male").glob("*.wav")):
        rate, sound = wavfile.read(path)
        found.append((resample_poly(sound / 2**15, RATE_HZ, rate), np.loadtxt(path.with_suffix(".f0ref"))))
    return found


def pitch_figures(sentences: list[tuple[NDArray, NDArray]], pitch: Callable[[NDArray, NDArray], NDArray]) -> dict[str, float]:
    """Gross error (more than 20 %, share of frames that both call voiced) and agreement on what is voiced, in percent.

    `pitch` gives the pitch of sound (n,) at samples (m,).
    """
    truth = np.concatenate([reference for _, reference in sentences])
    found = np.concatenate([pitch(sound, np.arange(len(ref)) * LARYNGOGRAPH_STEP) for sound, ref in sentences])
    both = (truth > 0) & (found > 0)
    gross = np.abs(found[both] / truth[both] - 1) > 0.2
    return {
        "gross_error_pct": 100 * float(gross.mean()),
        "gross_error_of_reference_pct": 100 * float(gross.sum() / (truth > 0).sum()),
        "voicing_agreement_pct": 100 * float(((truth > 0) == (found > 0)).mean()),
    }


def animated_takes(folder: Path) -> list[tuple[NDArray, SpeechFeatures, NDArray]]:
    """Takes of one speaker: sound at 16 kHz, features at 30 frames per second, the weights (n, 15) that all takes share."""
    folder = folder / "speech" / "facegood"
    loaded = [np.load(path) for path in sorted(folder.glob("*.npz"))]
    shared = sorted(set.intersection(*(set(take["channel"].tolist()) for take in loaded)))
    found = []
    for take, path in zip(loaded, sorted(folder.glob("*.wav")), strict=True):
        _, sound = wavfile.read(path)
        columns = [take["channel"].tolist().index(channel) for channel in shared]
        weights = take["weights"][:, columns].astype(np.float64)
        sound = sound / 2**15
        found.append((sound, speech_features(sound, visual_centres(len(weights), float(take["fps"]))), weights))
    return found


def take_moments(windows: Callable[[SpeechFeatures], NDArray], features: SpeechFeatures, weights: NDArray) -> Moments:
    """Moments of a take from windows of its features, block by block."""
    return moments_of((windows(part), weights[part.first : part.first + len(part)]) for part in features.blocks())


def mfcc_moments(sound: NDArray, features: SpeechFeatures, weights: NDArray, fps: float = 30.0) -> Moments:
    """Moments of a take from `mfcc_windows` at the visual frames of its features."""
    windows = mfcc_windows(sound, visual_centres(len(weights), fps))
    return take_moments(lambda part: windows[part.first : part.first + len(part)], features, weights)


def mfcc_windows(sound: NDArray, centres: NDArray[np.int64]) -> NDArray[np.float64]:
    """13 mel-frequency cepstra of each of the 64 frames around each visual frame (n, 832).

    Davis and Mermelstein 1980 with the usual choices: Hann window, power spectrum, 26 mel bands, decibels floored 80 below
    the loudest, orthonormal DCT-II.
    """
    unique, windows = np.unique(frame_starts(centres), return_inverse=True)
    padded = np.pad(sound, (RATE_HZ, RATE_HZ))
    spectra = np.concatenate([_power(padded, part + RATE_HZ) for part in np.array_split(unique, len(unique) // 8192 + 1)])
    decibels = 10 * np.log10(np.maximum(spectra, 1e-10))
    cepstra = dct(np.maximum(decibels, decibels.max() - 80), axis=1, norm="ortho")[:, :13]
    return cepstra[windows.reshape(-1, 64)].reshape(len(centres), -1)


def _power(padded: NDArray, starts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Power in mel bands (n, 26)."""
    frames = padded[starts[:, None] + np.arange(256)] * np.hanning(257)[:256]
    edges = 700 * (10 ** (np.linspace(0, 2595 * np.log10(1 + RATE_HZ / 2 / 700), 28) / 2595) - 1)
    bins = np.linspace(0, RATE_HZ / 2, 129)
    rise = (bins - edges[:-2, None]) / (edges[1:-1] - edges[:-2])[:, None]
    fall = (edges[2:, None] - bins) / (edges[2:] - edges[1:-1])[:, None]
    return np.abs(np.fft.rfft(frames)) ** 2 @ np.clip(np.minimum(rise, fall), 0, None).T
