"""The head model: identity, expression, pose, skinning; loaders; the procedural base head."""

from headcap.heads.procedural import base_head

__all__ = ["base_head"]
