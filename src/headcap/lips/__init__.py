"""Lips: what a monocular tracker gets wrong about the mouth, learnt from a rig and corrected in any video."""
