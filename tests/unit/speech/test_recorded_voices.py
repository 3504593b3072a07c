"""Figures on recordings of others."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from headcap.speech import FeatureSet, SpeechFeatures, track_pitch
from headcap.speech.moments import pooled
from headcap.speech.ridge import IMPROVED, RidgeForm, fold_errors, held_out

_SPEC = importlib.util.spec_from_file_location("_voices", Path(__file__).parents[2] / "bench" / "_voices.py")
voices = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(voices)
pytestmark = pytest.mark.real


def test_pitch_agrees_with_a_laryngograph(test_data):
    sentences = voices.laryngograph(test_data)
    assert len(sentences) == 50
    figures = voices.pitch_figures(sentences, lambda sound, samples: track_pitch(sound).at(samples))
    assert figures["gross_error_pct"] <= 2
    assert figures["voicing_agreement_pct"] >= 92


def _best_common(moments, penalties):
    """Mean and best R^2 (outputs) of the common penalty that turns out best on the held-out takes: more than it may know."""
    errors = fold_errors(moments, RidgeForm(bias=True, standardise=True, penalty="common"), penalties).sum(axis=0)
    r_squared = 1 - errors[:-1] / errors[-1]
    return r_squared.mean(axis=1).max(), r_squared.max()


def test_pooled_features_explain_more_of_a_face_than_the_papers_and_than_mel_cepstra(test_data):
    takes = voices.animated_takes(test_data)
    assert [weights.shape[1] for _, _, weights in takes] == [15] * 5
    moments = [
        voices.take_moments(lambda part: part.filter_windows(FeatureSet.POOLED), features, weights)
        for _, features, weights in takes
    ]
    ours = held_out(moments, IMPROVED).r_squared
    paper = [voices.take_moments(SpeechFeatures.filter_windows, features, weights) for _, features, weights in takes]
    paper_mean, paper_jaw = _best_common(paper, np.array([0.3, 1.0, 3.0]))
    del paper
    mel_mean, mel_jaw = _best_common([voices.mfcc_moments(*take) for take in takes], np.array([0.03, 0.1, 0.3, 1.0, 3.0]))
    assert pooled(moments).skipped == 0
    # one channel, the jaw, is well determined by sound; what others do with faces it has no say in
    assert ours.mean() > max(paper_mean, mel_mean, 0.10)
    assert ours.max() > max(paper_jaw, mel_jaw, 0.70)
    # the paper's features are sound as they are
    assert paper_mean > 0.07
    assert paper_jaw > 0.60
