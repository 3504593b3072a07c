"""Nine numbers for the deformation of a triangle that may be interpolated linearly (lip paper, section 4.2).

G = Q S, Q a rotation and S symmetric (polar decomposition, Higham 1986); log Q (Alexa 2002) and S - I. No deformation is nine
zeros.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

PARAMETERS = 9
"""Rotation vector x, y, z (radians); S - I at xx, yy, zz, yz, xz, xy."""

_MOST_STEPS = 40
"""Of the scaled Newton iteration; six to nine are usual, a gradient of condition 1e16 needs about thirty."""


def triangle_parameters(gradients: NDArray) -> NDArray[np.float64]:
    """Nine numbers (..., 9) of deformation gradients (..., 3, 3) with positive determinant.

    The rotation vector is at most pi long; at pi itself, where v and -v are one rotation, either is given. What is singular,
    turned inside out or not finite becomes NaN.
    """
    gradients = np.asarray(gradients, np.float64)
    flat = np.ascontiguousarray(gradients.reshape(-1, 3, 3))
    out = np.empty((len(flat), PARAMETERS))
    decompose(flat, out)
    return out.reshape((*gradients.shape[:-2], PARAMETERS))


def triangle_gradients(parameters: NDArray) -> NDArray[np.float64]:
    """Deformation gradients (..., 3, 3) of nine numbers (..., 9): exp(v) S; the inverse of `triangle_parameters`."""
    parameters = np.asarray(parameters, np.float64)
    flat = np.ascontiguousarray(parameters.reshape(-1, PARAMETERS))
    out = np.empty((len(flat), 3, 3))
    compose(flat, out)
    return out.reshape((*parameters.shape[:-1], 3, 3))


@njit(cache=True)
def decompose(gradients, out):
    """Nine numbers into `out` (k, 9) of gradients (k, 3, 3)."""
    rotation, other = np.empty((3, 3)), np.empty((3, 3))
    for k in range(len(gradients)):
        gradient = gradients[k]
        if not _polar_rotation(gradient, rotation, other):
            out[k] = np.nan
            continue
        _rotation_vector(rotation, out[k])
        for entry in range(6):
            i, j = _row(entry), _column(entry)
            total = 0.0
            for a in range(3):
                total += rotation[a, i] * gradient[a, j] + rotation[a, j] * gradient[a, i]
            out[k, 3 + entry] = 0.5 * total - (1.0 if i == j else 0.0)


@njit(cache=True)
def compose(parameters, out):
    """Gradients into `out` (k, 3, 3) of nine numbers (k, 9)."""
    rotation, stretch = np.empty((3, 3)), np.empty((3, 3))
    for k in range(len(parameters)):
        _rotation(parameters[k], rotation)
        for entry in range(6):
            i, j = _row(entry), _column(entry)
            stretch[i, j] = stretch[j, i] = parameters[k, 3 + entry] + (1.0 if i == j else 0.0)
        for i in range(3):
            for j in range(3):
                out[k, i, j] = rotation[i, 0] * stretch[0, j] + rotation[i, 1] * stretch[1, j] + rotation[i, 2] * stretch[2, j]


@njit(cache=True)
def _row(entry):
    return entry if entry < 3 else (1 if entry == 3 else 0)


@njit(cache=True)
def _column(entry):
    return entry if entry < 3 else (1 if entry == 5 else 2)


@njit(cache=True)
def _polar_rotation(gradient, rotation, inverse):
    """Q of G = Q S by Newton's iteration Q <- (g Q + Q^-T / g) / 2 with Higham's scaling g in Frobenius norms."""
    rotation[:] = gradient
    for _ in range(_MOST_STEPS):
        determinant = _cofactors(rotation, inverse)
        if not determinant > 0.0:
            return False
        inverse /= determinant
        scale = np.sqrt(np.sqrt((inverse**2).sum() / (rotation**2).sum()))
        change = 0.0
        for i in range(3):
            for j in range(3):
                value = 0.5 * (scale * rotation[i, j] + inverse[i, j] / scale)
                change += (value - rotation[i, j]) ** 2
                rotation[i, j] = value
        # the iteration squares its error: after a change of 1e-9 nothing is left to gain
        if change < 1e-18:
            return True
    return False


@njit(cache=True)
def _cofactors(m, out):
    """Cofactors of m (3, 3) into `out`, its determinant as result: m^-T = cofactors / determinant."""
    for i in range(3):
        for j in range(3):
            a, b, c, d = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            out[i, j] = m[a, c] * m[b, d] - m[a, d] * m[b, c]
    return m[0, 0] * out[0, 0] + m[0, 1] * out[0, 1] + m[0, 2] * out[0, 2]


@njit(cache=True)
def _rotation_vector(r, out):
    """Log of a rotation into out[:3] by a quaternion from the largest of four pivots (Shepperd 1978): sound at any angle."""
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    pivot = 3
    largest = trace
    for i in range(3):
        if r[i, i] > largest:
            pivot, largest = i, r[i, i]
    if pivot == 3:
        w = 1.0 + trace
        x, y, z = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    elif pivot == 0:
        w = r[2, 1] - r[1, 2]
        x, y, z = 1.0 + r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]
    elif pivot == 1:
        w = r[0, 2] - r[2, 0]
        x, y, z = r[0, 1] + r[1, 0], 1.0 + r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1]
    else:
        w = r[1, 0] - r[0, 1]
        x, y, z = r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], 1.0 + r[2, 2] - r[0, 0] - r[1, 1]
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    sine = np.sqrt(x * x + y * y + z * z)
    # for small angles atan2(s, w) / s -> 1 / w
    factor = 2.0 * np.arctan2(sine, w) / sine if sine > 1e-12 * w else 2.0 / w
    out[0], out[1], out[2] = factor * x, factor * y, factor * z


@njit(cache=True)
def _rotation(vector, out):
    """exp of the cross-product matrix of vector[:3] (Rodrigues), with series where quotients cancel."""
    x, y, z = vector[0], vector[1], vector[2]
    squared = x * x + y * y + z * z
    if squared < 1e-6:
        sine, cosine = 1.0 - squared / 6.0, 0.5 - squared / 24.0
    else:
        angle = np.sqrt(squared)
        sine, cosine = np.sin(angle) / angle, (1.0 - np.cos(angle)) / squared
    out[0, 0], out[1, 1], out[2, 2] = 1 - cosine * (y * y + z * z), 1 - cosine * (x * x + z * z), 1 - cosine * (x * x + y * y)
    out[0, 1], out[1, 0] = cosine * x * y - sine * z, cosine * x * y + sine * z
    out[0, 2], out[2, 0] = cosine * x * z + sine * y, cosine * x * z - sine * y
    out[1, 2], out[2, 1] = cosine * y * z - sine * x, cosine * y * z + sine * x
