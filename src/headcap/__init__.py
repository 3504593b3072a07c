"""headcap: from multi-camera recordings and a clap to a calibrated rig, a tracked head and trained head models."""

from importlib.metadata import version

__version__ = version("headcap")
