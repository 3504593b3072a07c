"""Video and audio files, takes, frames by time.

Every time is a presentation time (pts * time_base, edit lists honoured) or comes from one; a frame's index says nothing
about when it was taken, because cameras drop frames.
"""

from headcap.recordings.frames import TakeFrames, Timeline
from headcap.recordings.probe import Recording, probe
from headcap.recordings.takes import IngestedTake, ingest_take
from headcap.recordings.video import VideoFrames

__all__ = ["IngestedTake", "Recording", "TakeFrames", "Timeline", "VideoFrames", "ingest_take", "probe"]
