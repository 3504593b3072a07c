"""Coefficients over time: curves, their editing, swallowing, and the meshes they make."""
