"""The neck: the larynx that slides under the skin, speech blendshapes, their training and fitting (paper, sections 3 and 5)."""

from headcap.neck.chart import Distortion, NeckChart, build_chart
from headcap.neck.larynx import LarynxMap, LarynxSettings, larynx_map
from headcap.neck.larynx_coefficients import SlideSettings
from headcap.neck.model import NeckModel, NeckPerson
from headcap.neck.speech_fitting import SpeechFit, SpeechFitter
from headcap.neck.speech_training import SpeechSubject, SpeechTraining, SpeechTrainingSettings, train_speech

__all__ = [
    "Distortion",
    "LarynxMap",
    "LarynxSettings",
    "NeckChart",
    "NeckModel",
    "NeckPerson",
    "SlideSettings",
    "SpeechFit",
    "SpeechFitter",
    "SpeechSubject",
    "SpeechTraining",
    "SpeechTrainingSettings",
    "build_chart",
    "larynx_map",
    "train_speech",
]
