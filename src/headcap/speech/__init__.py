"""A voice as numbers, and what they say about throat and larynx (paper sections 6 and 7).

Sound at 16 kHz becomes 64 audio frames around each visual frame; each has an all-pole filter (the vocal tract) and a source
(gain, pitch, voiced or not). The paper's features stand beside a pooled set; a recording and a stream give the same.
"""

from headcap.speech.features import FeatureSet, SpeechFeatures, read_speech, speech_features
from headcap.speech.framing import RATE_HZ, centres_at, visual_centres
from headcap.speech.level import speech_level
from headcap.speech.pitch import PitchStream, PitchTrack, speaker_pitch, track_pitch
from headcap.speech.regressor import SpeechCoefficients, SpeechRegressor
from headcap.speech.settings import FeatureSettings, PitchSettings, RidgeSettings
from headcap.speech.stream import FeatureStream
from headcap.speech.training import SpeechErrors, SpeechTake, speech_errors, train_speech_regressor

__all__ = [
    "RATE_HZ",
    "FeatureSet",
    "FeatureSettings",
    "FeatureStream",
    "PitchSettings",
    "PitchStream",
    "PitchTrack",
    "RidgeSettings",
    "SpeechCoefficients",
    "SpeechErrors",
    "SpeechFeatures",
    "SpeechRegressor",
    "SpeechTake",
    "centres_at",
    "read_speech",
    "speaker_pitch",
    "speech_errors",
    "speech_features",
    "speech_level",
    "track_pitch",
    "train_speech_regressor",
    "visual_centres",
]
