"""Clap detection, start times of the cameras on one clock, drift, confidence."""

from headcap.sync.offsets import TimeOffsets

__all__ = ["TimeOffsets"]
