"""Rehearse a shoot: a procedural subject, a described rig and the recordings it would make, with the truth beside them."""
