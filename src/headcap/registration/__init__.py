"""Scan to topology, flow correspondence, deformation graph, texture: the tracker."""

from headcap.registration.sequence import MeshSequence
from headcap.registration.template import Template

__all__ = ["MeshSequence", "Template"]
