"""Rigid transforms, rotations, robust fits and leading directions, on plain arrays.

Convention: a rigid transform is a (4, 4) float64 array named `target_from_source`, so that
`camera_from_world @ world_from_head` composes by eye. Units are metres and radians.
"""
