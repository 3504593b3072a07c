"""Clap detection, start times of the cameras on one clock, drift, confidence.

Start times are real numbers and are never rounded to frames. Frame k of a camera belongs to the common moment
`TimeOffsets.common_time(camera, frame_times_s)[k]`; images of different cameras are compared only after each has been
brought to one moment (`headcap.recordings.TakeFrames.at`), or with a model that moves between their moments.
"""

from headcap.sync.align import align_recordings
from headcap.sync.clapper import ClapperEstimate, refine_clapper
from headcap.sync.offsets import TimeOffsets
from headcap.sync.settings import SyncSettings
from headcap.sync.solve import SyncResult, synchronise

__all__ = [
    "ClapperEstimate",
    "SyncResult",
    "SyncSettings",
    "TimeOffsets",
    "align_recordings",
    "refine_clapper",
    "synchronise",
]
