"""A generic adult head as an implicit surface, from which the model's topology is cut.

Everything here is in millimetres, x to the subject's left (only |x| matters), y up, z out of the face, the origin
between the ears. The field is negative inside and nearly a distance close to the surface. Proportions follow textbook
adult means: 230 mm from chin to crown, 155 wide, 195 deep, pupils 63 apart, mouth 50 wide, neck 115 wide.
"""

import numpy as np
from numpy.typing import NDArray

Field = NDArray[np.float64]
PUPIL_MM, EYE_RADIUS_MM, LID_RADIUS_MM = np.array([31.5, 0.0, 70.0]), 12.0, 13.2
MOUTH_HALF_WIDTH_MM = 25.0
NECK_CUT_MM = -212.0


def head_field(points: NDArray) -> Field:
    """Signed field (k,) of points (k, 3): below zero inside the head."""
    p = np.array(points, float)
    p[:, 0] = np.abs(p[:, 0])
    field = _skull(p)
    field = _blend(field, _neck(p), 26.0)
    field = field - _relief(p)
    field = _blend(field, _nose(p), 9.0)
    field = _blend(field, _ball(p, PUPIL_MM, LID_RADIUS_MM), 5.0)
    field = _blend(field, _lips(p), 6.0)
    field = _blend(field, _ear(p), 5.0)
    return field - _dents(p)


def head_gradient(points: NDArray, step_mm: float = 0.2) -> NDArray:
    """Central differences of the field, (k, 3)."""
    steps = np.eye(3) * step_mm
    return np.stack([(head_field(points + s) - head_field(points - s)) / (2 * step_mm) for s in steps], axis=1)


def project(
    points: NDArray, iterations: int = 6, longest_mm: float = 2.0, axes: tuple[float, float, float] = (1.0, 1.0, 1.0)
) -> NDArray:
    """Points (k, 3) moved onto the surface along the field's gradient, or along chosen axes of it only."""
    points = np.array(points, float)
    for _ in range(iterations):
        gradient = head_gradient(points) * axes
        scale = head_field(points) / np.maximum((gradient**2).sum(1), 1e-3)
        step = scale[:, None] * gradient
        length = np.linalg.norm(step, axis=1, keepdims=True)
        points -= step * np.minimum(1.0, longest_mm / np.maximum(length, 1e-9))
    return points


def mouth_line(x: NDArray) -> NDArray:
    """Height y of the line where the lips meet, at |x|."""
    t = np.abs(x) / MOUTH_HALF_WIDTH_MM
    return -67.0 - 1.2 * np.exp(-((t / 0.22) ** 2)) - 1.0 * t**3


def _skull(p: NDArray) -> Field:
    cranium = _ellipsoid(p, (0, 28, -1), (77, 88, 98))
    face = _ellipsoid(p, (0, -30, 35), (58, 84, 56))
    jaw = _cone(p, (43, -62, 4), (13, -96, 72), 15, 16)
    chin = _ellipsoid(p, (0, -98, 79), (18, 15, 17))
    cheek = _ellipsoid(p, (41, -24, 46), (22, 20, 22))
    muzzle = _ellipsoid(p, (0, -64, 63), (35, 32, 37))
    field = _blend(cranium, face, 18.0)
    field = _blend(field, jaw, 30.0)
    field = _blend(field, _blend(chin, muzzle, 12.0), 14.0)
    return _blend(field, cheek, 20.0)


def _neck(p: NDArray) -> Field:
    along = np.clip((p[:, 1] + 60.0) / -160.0, 0.0, 1.3)
    centre = np.stack([np.zeros(len(p)), p[:, 1], -16.0 - 16.0 * along], axis=1)
    radii = np.stack([54.0 + 3.0 * along, np.ones(len(p)), 57.0 + 2.0 * along], axis=1)
    q = (p - centre) / radii
    round_distance = np.hypot(q[:, 0], q[:, 2])
    column = (round_distance - 1.0) * 56.0
    strap = _cone(p, (50, -62, -26), (13, -208, 23), 9, 7)
    shoulder = _cone(p, (25, -205, -52), (160, -262, -48), 38, 34)
    chest = _ellipsoid(p, (0, -292, -30), (150, 84, 72))
    column = -_blend(-column, -(p[:, 1] + 35.0), 40.0)
    field = _blend(column, strap, 14.0)
    return _blend(field, _blend(shoulder, chest, 30.0), 40.0)


def _relief(p: NDArray) -> Field:
    sockets = -12.0 * _bump(p, (31, 1, 84), (14, 10, 26)) - 4.0 * _bump(p, (17, 3, 86), (6, 8, 20))
    brow = 2.0 * _bump(p, (27, 20, 88), (15, 6, 18)) + 1.0 * _bump(p, (0, 19, 96), (9, 7, 12))
    bridge = -5.0 * _bump(p, (0, 4, 97), (9, 8, 12))
    temple = -3.5 * _bump(p, (66, 18, 45), (14, 20, 18))
    cheek_hollow = -1.0 * _bump(p, (48, -58, 50), (12, 16, 20))
    under_lip = -3.6 * _bump(p, (0, -83.5, 98), (17, 4.5, 12))
    larynx = 5.0 * _bump(p, (0, -152, 40), (9, 10, 14)) + 1.5 * _bump(p, (0, -166, 38), (11, 14, 14))
    notch = -4.0 * _bump(p, (0, -210, 24), (12, 10, 16))
    return sockets + brow + bridge + temple + cheek_hollow + under_lip + larynx + notch


def _nose(p: NDArray) -> Field:
    bridge = _cone(p, (0, 6, 84), (0, -34, 108), 6.5, 8.0)
    tip = _ball(p, (0, -36.5, 110.5), 9.8)
    wing = _ellipsoid(p, (11.5, -39.5, 101), (6.5, 7.0, 10.5))
    columella = _cone(p, (0, -45, 98), (0, -41, 110), 4.2, 5.0)
    flank = _ellipsoid(p, (0, -26, 88), (15, 26, 17))
    field = _blend(_blend(bridge, tip, 9.0), _blend(wing, columella, 5.0), 7.5)
    return _blend(field, flank, 10.0)


def _lips(p: NDArray) -> Field:
    x, y = p[:, 0], p[:, 1] - (mouth_line(p[:, 0]) + 67.0)
    q = np.stack([x, y, p[:, 2]], axis=1)
    upper = _blend(_cone(q, (4, -62.5, 99.0), (23.5, -66.3, 87.5), 5.6, 2.6), _ball(q, (0, -63.2, 99.8), 4.9), 5.0)
    lower = _blend(_cone(q, (6, -72.2, 97.6), (22.5, -67.7, 87.5), 6.4, 2.6), _ball(q, (0, -72.4, 97.6), 6.3), 6.0)
    return _blend(upper, lower, 1.0)


def _ear(p: NDArray) -> Field:
    c, s = np.cos(0.50), np.sin(0.50)
    t, u = np.cos(0.22), np.sin(0.22)
    q = p - np.array([76.0, -8.0, -12.0])
    out, back = c * q[:, 0] + s * q[:, 2], -s * q[:, 0] + c * q[:, 2]
    up, back = t * q[:, 1] - u * back, u * q[:, 1] + t * back
    q = np.stack([out, up, back], axis=1)
    plate = _ellipsoid(q, (0, 1, 0), (5.0, 31.0, 17.5))
    rim_distance = np.hypot((np.hypot(q[:, 1] / 1.75, q[:, 2]) - 14.0) * 1.1, q[:, 0] - 2.5)
    rim = rim_distance - 3.2 / (1.0 + np.exp(-(q[:, 1] + 15.0) / 3.0))
    concha = 5.0 * _bump(q, (5.0, -3.0, 4.0), (4.5, 8.5, 6.0))
    root = _ellipsoid(q, (-8, -4, 3), (10, 20, 11))
    return _blend(_blend(plate, rim, 4.0) + concha, root, 5.0)


def _dents(p: NDArray) -> Field:
    nostril = -4.2 * _bump(p, (6.6, -46.0, 106.0), (3.0, 4.0, 4.6))
    philtrum = -1.0 * _bump(p, (0, -54.5, 103.5), (2.6, 6.5, 8.0))
    off = p[:, 1] - mouth_line(p[:, 0])
    span = 1.0 / (1.0 + np.exp((p[:, 0] - MOUTH_HALF_WIDTH_MM + 0.5) / 1.2))
    crease = -2.0 * np.exp(-((off / 1.3) ** 2)) * span * (p[:, 2] > 70.0)
    return nostril + philtrum + crease


def _ball(p: NDArray, centre: object, radius: float) -> Field:
    return np.linalg.norm(p - np.asarray(centre, float), axis=1) - radius


def _ellipsoid(p: NDArray, centre: object, radii: object) -> Field:
    q = (p - np.asarray(centre, float)) / np.asarray(radii, float)
    scaled = np.linalg.norm(q, axis=1)
    return scaled * (scaled - 1.0) / np.maximum(np.linalg.norm(q / np.asarray(radii, float), axis=1), 1e-9)


def _cone(p: NDArray, start: object, end: object, start_radius: float, end_radius: float) -> Field:
    start, end = np.asarray(start, float), np.asarray(end, float)
    axis = end - start
    along = np.clip((p - start) @ axis / (axis @ axis), 0.0, 1.0)
    radius = start_radius + (end_radius - start_radius) * along
    return np.linalg.norm(p - start - along[:, None] * axis, axis=1) - radius


def _bump(p: NDArray, centre: object, widths: object) -> Field:
    q = (p - np.asarray(centre, float)) / np.asarray(widths, float)
    return np.exp(-0.5 * np.einsum("nk,nk->n", q, q))


def _blend(a: Field, b: Field, width: float) -> Field:
    """Smooth minimum (union), rounded over `width` (quadratic polynomial)."""
    h = np.maximum(width - np.abs(a - b), 0.0) / width
    return np.minimum(a, b) - 0.25 * width * h * h
