"""The projection of many points in one pass: trackers project whole meshes into every view several times a frame."""

import numpy as np
from numba import njit

NEAREST_DEPTH_M = 1e-9
"""Points nearer than this to the camera plane, or behind it, have no pixel."""


@njit(cache=True, error_model="numpy")
def project_points(points, camera_from_world, matrix, distortion, pixels, depth):
    """Fill pixels (n, 2) and depth (n,) of world points (n, 3); NaN pixels at or behind the camera plane."""
    r, t = camera_from_world[:, :3], camera_from_world[:, 3]
    k1, k2, p1, p2, k3 = distortion[0], distortion[1], distortion[2], distortion[3], distortion[4]
    fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    for i in range(len(points)):
        a, b, c = points[i, 0], points[i, 1], points[i, 2]
        z = r[2, 0] * a + r[2, 1] * b + r[2, 2] * c + t[2]
        depth[i] = z
        if not z > NEAREST_DEPTH_M:
            pixels[i, 0] = pixels[i, 1] = np.nan
            continue
        x = (r[0, 0] * a + r[0, 1] * b + r[0, 2] * c + t[0]) / z
        y = (r[1, 0] * a + r[1, 1] * b + r[1, 2] * c + t[1]) / z
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        pixels[i, 0] = fx * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + cx
        pixels[i, 1] = fy * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + cy


@njit(cache=True, error_model="numpy")
def project_points_with_jacobian(points, camera_from_world, matrix, distortion, pixels, jacobian):
    """Fill pixels (n, 2) and their derivative (n, 2, 3) by the world points (n, 3), which lie before the camera."""
    r, t = camera_from_world[:, :3], camera_from_world[:, 3]
    k1, k2, p1, p2, k3 = distortion[0], distortion[1], distortion[2], distortion[3], distortion[4]
    fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    for i in range(len(points)):
        a, b, c = points[i, 0], points[i, 1], points[i, 2]
        inverse = 1.0 / (r[2, 0] * a + r[2, 1] * b + r[2, 2] * c + t[2])
        x = (r[0, 0] * a + r[0, 1] * b + r[0, 2] * c + t[0]) * inverse
        y = (r[1, 0] * a + r[1, 1] * b + r[1, 2] * c + t[1]) * inverse
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = k1 + r2 * (2 * k2 + 3 * r2 * k3)
        pixels[i, 0] = fx * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + cx
        pixels[i, 1] = fy * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + cy
        across = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
        xx = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
        yy = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
        for k in range(3):
            # derivative of the ideal image plane by the world point
            dx = (r[0, k] - x * r[2, k]) * inverse
            dy = (r[1, k] - y * r[2, k]) * inverse
            jacobian[i, 0, k] = fx * (xx * dx + across * dy)
            jacobian[i, 1, k] = fy * (across * dx + yy * dy)
