"""Marker recordings: read, cleaned of gaps and head motion, tied to the neutral mesh, interpolated over the face (section 5)."""

from headcap.expressions.markers.performances import marker_performance, mesh_performance
from headcap.expressions.markers.reading import read_markers
from headcap.expressions.markers.settings import MarkerSettings
from headcap.expressions.markers.take import MarkerTake

__all__ = ["MarkerSettings", "MarkerTake", "marker_performance", "mesh_performance", "read_markers"]
