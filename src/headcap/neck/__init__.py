"""The neck: the larynx that slides under the skin, speech blendshapes, their training and fitting (paper, sections 3 and 5)."""

from headcap.neck.fitting.compensation import Compensation, FitSettings, SequenceFitter, compensate
from headcap.neck.fitting.pose import PoseEstimator, Poses, PoseSettings
from headcap.neck.fitting.speech import SpeechFit, SpeechFitter
from headcap.neck.larynx.chart import Distortion, NeckChart, build_chart
from headcap.neck.larynx.coefficients import SlideSettings
from headcap.neck.larynx.larynx_map import LarynxMap, LarynxSettings, larynx_map
from headcap.neck.model import NeckModel, NeckPerson
from headcap.neck.training.expression import ExpressionTraining, ExpressionTrainingSettings, train_expressions
from headcap.neck.training.pose import PoseTraining, PoseTrainingSettings, train_pose
from headcap.neck.training.pose_expression import PoseExpressionSettings, train_pose_expression
from headcap.neck.training.speech import SpeechSubject, SpeechTraining, SpeechTrainingSettings, train_speech
from headcap.neck.training_subject import TrainingSubject

__all__ = [
    "Compensation",
    "Distortion",
    "ExpressionTraining",
    "ExpressionTrainingSettings",
    "FitSettings",
    "LarynxMap",
    "LarynxSettings",
    "NeckChart",
    "NeckModel",
    "NeckPerson",
    "PoseEstimator",
    "PoseExpressionSettings",
    "PoseSettings",
    "PoseTraining",
    "PoseTrainingSettings",
    "Poses",
    "SequenceFitter",
    "SlideSettings",
    "SpeechFit",
    "SpeechFitter",
    "SpeechSubject",
    "SpeechTraining",
    "SpeechTrainingSettings",
    "TrainingSubject",
    "build_chart",
    "compensate",
    "larynx_map",
    "train_expressions",
    "train_pose",
    "train_pose_expression",
    "train_speech",
]
