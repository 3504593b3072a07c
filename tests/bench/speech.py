"""Speech: features and regression against real time, animation weights regressed from sound, pitch against a laryngograph.

Ours is the time of features and regression of one take of 110 s at 30 visual frames per second, both feature sets; the peer is
the same with mel-frequency cepstra, which is features and regression alone, without pitch. Praat's pitch is measured beside
ours where the package `praat-parselmouth` is installed.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from _voices import animated_takes, laryngograph, mfcc_moments, mfcc_windows, pitch_figures, take_moments
from run import measure, write

from headcap.speech import RATE_HZ, FeatureSet, RidgeSettings, speech_features, track_pitch, visual_centres
from headcap.speech.ridge import IMPROVED, PAPER_SPEECH, RidgeForm, cross_validated, held_out

FPS = 30.0
COMMON = RidgeForm(bias=True, standardise=True, penalty="common")
# 2,048 inputs: five penalties around the best, each 15 Cholesky factors
FEW = RidgeSettings(least=0.1, most=10.0)


def run(out_path: Path) -> None:
    """Measure speed on one take, errors on all, pitch on all sentences."""
    takes = animated_takes(_data())
    moments = {
        "paper": [take_moments(lambda part: part.filter_windows(), features, weights) for _, features, weights in takes],
        "mfcc": [mfcc_moments(*take) for take in takes],
        "pooled": [
            take_moments(lambda part: part.filter_windows(FeatureSet.POOLED), features, weights) for _, features, weights in takes
        ],
    }
    trials = {
        "paper_exact": ("paper", PAPER_SPEECH, FEW),
        "paper_standardised": ("paper", COMMON, FEW),
        "mfcc": ("mfcc", COMMON, RidgeSettings()),
        "mfcc_penalty_per_output": ("mfcc", IMPROVED, RidgeSettings()),
        "pooled_common_penalty": ("pooled", COMMON, RidgeSettings()),
        "pooled": ("pooled", IMPROVED, RidgeSettings()),
    }
    regression = {name: _r_squared(moments[features], form, few) for name, (features, form, few) in trials.items()}
    maps = {name: cross_validated(moments[name], COMMON, FEW) for name in moments}
    sound, seconds = takes[0][0], len(takes[0][0]) / RATE_HZ
    centres = visual_centres(len(takes[0][2]), FPS)

    def ours():
        features = speech_features(sound, centres)
        for block in features.blocks():
            maps["paper"](block.filter_windows())
            maps["pooled"](block.filter_windows(FeatureSet.POOLED))

    took = measure(ours, repeats=3)
    peer = measure(lambda: maps["mfcc"](mfcc_windows(sound, centres)), repeats=3)
    drop_frame = visual_centres(int(seconds * 30000 / 1001), 30000 / 1001)  # no two visual frames share an audio frame
    worst = measure(lambda: speech_features(sound, drop_frame), repeats=2)
    write(
        out_path,
        ours=took | {"name": "features and regression", "times_real_time": seconds / took["cpu_seconds"]},
        peer=peer | {"name": "13 mel-frequency cepstra"},
        figures={
            "times_real_time_at_29_97_fps": seconds / worst["cpu_seconds"],
            "regression": regression,
            "pitch": _pitch(),
        },
    )


def _r_squared(moments, form: RidgeForm, settings: RidgeSettings) -> dict[str, float]:
    found = held_out(moments, form, settings).r_squared
    return {"mean_r_squared": float(found.mean()), "jaw_r_squared": float(found.max())}


def _pitch() -> dict[str, dict[str, float]]:
    sentences = laryngograph(_data())
    found = {"ours": pitch_figures(sentences, lambda sound, samples: track_pitch(sound).at(samples))}
    try:
        import parselmouth
    except ImportError:
        return found

    def praat(sound, samples):
        pitch = parselmouth.Sound(sound, RATE_HZ).to_pitch_ac(time_step=0.005, pitch_floor=80.0, pitch_ceiling=350.0)
        values, times = pitch.selected_array["frequency"], pitch.xs()
        nearest = np.abs(times[:, None] - samples / RATE_HZ).argmin(axis=0)
        return values[nearest]

    return found | {"praat": pitch_figures(sentences, praat)}


def _data() -> Path:
    named = os.environ.get("HEADCAP_TEST_DATA")
    return Path(named) if named else Path(__file__).resolve().parents[3] / "shared" / "data"
