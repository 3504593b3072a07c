"""The monocular base tracker (lip correction paper, section 3.2): one camera's pictures explained by a head model."""

from headcap.lips.monocular.detections import load_detections
from headcap.lips.monocular.pictures import unknown_camera
from headcap.lips.monocular.sequence import MonocularTrack, track_video
from headcap.lips.monocular.settings import MonocularSettings
from headcap.lips.monocular.tracker import FrameResult, FrameState, MonocularTracker

__all__ = [
    "FrameResult",
    "FrameState",
    "MonocularSettings",
    "MonocularTrack",
    "MonocularTracker",
    "load_detections",
    "track_video",
    "unknown_camera",
]
